//! Virtual people as `tests/data/virtual_subjects/generate.py` makes them, with other remnants beside its own: delayed,
//! lagged feedback, a feedforward that moves from a plain gain to the inverse of the plant, outside every model class.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;
use std::f64::consts::PI;
use volition::control::discretise::{tustin, zero_order_hold};
use volition::control::{Continuous, Discrete, TransferFunction};
use volition::num::rng::{self, Stream};
use volition::trial::{Signals, Trial};

/// The plants of `generate.py`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Group {
    Msd2,
    Gm,
    Gn,
}

#[allow(dead_code, reason = "some are for the bench alone")]
/// What the person's control has beside what it does on purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remnant {
    /// First order with 0.15 s, as `generate.py` has it.
    Ar1,
    /// The same, its size with that of the command.
    SignalDependent,
    /// Second order, around 1.2 Hz.
    Ar2,
    /// White.
    White,
    /// The first, and half as much white.
    Ar1White,
    /// A slow drift of 5 s, and half as much white.
    Drift,
}

/// A person.
#[derive(Debug, Clone)]
pub struct Person {
    pub group: Group,
    pub learning_trials: f64,
    pub most_learned: f64,
    pub plain_gain: f64,
    pub gain: f64,
    pub gain_at_start: f64,
    pub zero: f64,
    pub pole: f64,
    pub delay_s: f64,
    pub remnant: f64,
    /// Multiplies the feedback: 0 for none.
    pub feedback_share: f64,
    /// Multiplies the feedforward.
    pub feedforward_share: f64,
}

fn poly(roots: &[f64]) -> Vec<f64> {
    roots.iter().fold(vec![1.0], |p, r| product(&p, &[1.0, -r]))
}

fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            out[i + j] += x * y;
        }
    }
    out
}

fn sum(a: &[f64], b: &[f64]) -> Vec<f64> {
    let n = a.len().max(b.len());
    let at = |p: &[f64], i: usize| (i + p.len()).checked_sub(n).map_or(0.0, |k| p[k]);
    (0..n).map(|i| at(a, i) + at(b, i)).collect()
}

fn scaled(a: &[f64], factor: f64) -> Vec<f64> {
    a.iter().map(|x| factor * x).collect()
}

fn value(p: &[f64], s: Complex64) -> Complex64 {
    p.iter().fold(Complex64::default(), |sum, c| sum * s + c)
}

impl Group {
    pub fn sample_time_s(self) -> f64 {
        if self == Self::Msd2 { 0.002 } else { 0.02 }
    }

    /// Numerator and denominator of the plant.
    pub fn plant(self) -> (Vec<f64>, Vec<f64>) {
        match self {
            Self::Gm => (vec![2.0, 4.4], vec![1.0, 3.6, 4.0]),
            Self::Gn => (vec![-2.0, 4.4], vec![1.0, 3.6, 4.0]),
            Self::Msd2 => {
                let (m1, m2, c1, c2) = (1.0, 0.5, 0.56 * PI, 0.5 * PI);
                let (k1, k2) = (0.16 * PI * PI, 0.5 * PI * PI);
                let num = vec![m1, c1 + c2, k1 + k2];
                let den = sum(&product(&[m1, c1, k1], &[m2, c2, k2]), &[m2 * c2, m2 * k2, 0.0, 0.0]);
                (num, den)
            }
        }
    }

    pub fn system(self) -> TransferFunction<Continuous> {
        let (num, den) = self.plant();
        TransferFunction::new(&num, &den, Continuous).unwrap()
    }

    pub fn command(self) -> Vec<f64> {
        let dt = self.sample_time_s();
        let length = if self == Self::Msd2 { 80.0 } else { 60.0 };
        let samples = (length / dt + 0.5) as usize + 1;
        (0..samples)
            .map(|i| {
                let t = i as f64 * dt;
                if self != Self::Msd2 {
                    2.0 * (PI / 120.0 * t * t).sin()
                } else if t <= 40.0 {
                    (2.0 - 0.035 * t) * (0.2 * PI * t + 0.015 * PI * t * t).sin()
                } else {
                    let s = 80.0 - t;
                    (0.8 - 0.035 * t) * (0.2 * PI * s + 0.015 * PI * s * s).sin()
                }
            })
            .collect()
    }

    /// The band of the norms in rad/s.
    pub fn band_rad_s(self) -> [f64; 2] {
        if self == Self::Msd2 { [2.0 * PI / 80.0, 1.3 * PI] } else { [2.0 * PI / 60.0, PI] }
    }

    /// Numerator and denominator of the stable inverse, or of what comes near it in the band.
    fn inverse(self) -> (Vec<f64>, Vec<f64>) {
        let (num, den) = self.plant();
        if self == Self::Gn {
            let inverse_den = poly(&[-40.0; 4]);
            let rows: Vec<Complex64> =
                (0..60).map(|k| Complex64::new(0.0, 0.05 + (PI - 0.05) * f64::from(k) / 59.0)).collect();
            let entry = |i: usize, j: usize| rows[i].powu(4 - j as u32) / value(&inverse_den, rows[i]);
            let target = |i: usize| value(&den, rows[i]) / value(&num, rows[i]);
            let part = |z: Complex64, i: usize| if i < 60 { z.re } else { z.im };
            let a = DMatrix::from_fn(120, 5, |i, j| part(entry(i % 60, j), i));
            let b = DVector::from_fn(120, |i, _| part(target(i % 60), i));
            let scale: Vec<f64> = a.column_iter().map(|c| c.norm()).collect();
            let unit = DMatrix::from_fn(120, 5, |i, j| a[(i, j)] / scale[j]);
            let x = unit.svd(true, true).solve(&b, 1e-15).unwrap();
            return ((0..5).map(|j| x[j] / scale[j]).collect(), inverse_den);
        }
        let order = den.len() - num.len();
        let w = if self == Self::Msd2 { 30.0 } else { 12.0_f64 };
        (den, scaled(&product(&num, &poly(&vec![-w; order])), w.powi(-(order as i32))))
    }
}

/// One sample at a time, transposed direct form II.
struct Filter {
    b: Vec<f64>,
    a: Vec<f64>,
    z: Vec<f64>,
}

impl Filter {
    fn new(system: &TransferFunction<Discrete>) -> Self {
        let a: Vec<f64> = scaled(system.den().coefficients(), 1.0 / system.den().leading());
        let mut b = vec![0.0; a.len() - system.num().coefficients().len()];
        b.extend(scaled(system.num().coefficients(), 1.0 / system.den().leading()));
        Self { z: vec![0.0; a.len()], a, b }
    }

    fn step(&mut self, x: f64) -> f64 {
        let y = self.b[0] * x + self.z[0];
        for i in 0..self.a.len() - 1 {
            self.z[i] = self.z[i + 1] + self.b[i + 1] * x - self.a[i + 1] * y;
        }
        y
    }

    /// The output before the input is known, of a filter without direct gain.
    fn pending(&self) -> f64 {
        self.z[0]
    }
}

impl Person {
    /// The person of a seed.
    pub fn draw(group: Group, seed: u64) -> Self {
        let mut stream = rng::stream(seed, "person");
        let mut within = |a: f64, b: f64| a + (b - a) * stream.random::<f64>();
        let (num, den) = group.plant();
        let ratio = den[den.len() - 1] / num[num.len() - 1];
        let scale = if group == Group::Gn { 0.35 } else { 1.0 } * ratio;
        Self {
            group,
            learning_trials: within(6.0, 14.0),
            most_learned: within(0.85, 0.98),
            plain_gain: within(0.3, 0.8) * scale,
            gain: within(0.4, 1.2) * scale,
            gain_at_start: within(0.0, 2.0),
            zero: within(0.5, 2.0),
            pole: within(1.0, 4.0),
            delay_s: within(0.12, 0.22),
            remnant: within(0.05, 0.2),
            feedback_share: 1.0,
            feedforward_share: 1.0,
        }
    }

    fn time(&self) -> Discrete {
        Discrete::new(self.group.sample_time_s()).unwrap()
    }

    fn feedforward(&self, trial: f64) -> (Vec<f64>, Vec<f64>) {
        let (inverse_num, inverse_den) = self.group.inverse();
        let learned = self.most_learned * (1.0 - (-trial / self.learning_trials).exp());
        let num = sum(&scaled(&inverse_num, learned), &scaled(&inverse_den, (1.0 - learned) * self.plain_gain));
        (scaled(&num, self.feedforward_share), inverse_den)
    }

    fn feedback(&self, trial: f64) -> (Vec<f64>, Vec<f64>) {
        let gain = self.gain * (1.0 + 0.3 * (-trial / 5.0).exp() * self.gain_at_start) * self.feedback_share;
        (vec![gain, gain * self.zero], product(&[1.0, self.pole], &[0.1, 1.0]))
    }

    /// G, Gff and Gfb at ω in rad/s, as sampled.
    pub fn laws(&self, trial: f64, omega_rad_s: f64) -> [Complex64; 3] {
        let dt = self.group.sample_time_s();
        let z = Complex64::from_polar(1.0, omega_rad_s * dt);
        let s = 2.0 / dt * (z - 1.0) / (z + 1.0);
        let at = |(num, den): (Vec<f64>, Vec<f64>)| value(&num, s) / value(&den, s);
        let plant = zero_order_hold(&self.group.system(), self.time()).unwrap().response(omega_rad_s);
        [plant, at(self.feedforward(trial)), at(self.feedback(trial)) * z.powi(-(self.delay_samples() as i32))]
    }

    fn delay_samples(&self) -> usize {
        (self.delay_s / self.group.sample_time_s()).round().max(1.0) as usize
    }

    /// ‖Gff G − 1‖ and ‖Gfb‖ over the band.
    pub fn norms(&self, trial: f64) -> [f64; 2] {
        let [from, to] = self.group.band_rad_s();
        let lines = 60;
        let (mut distance, mut size) = (0.0, 0.0);
        for k in 0..lines {
            let [g, ff, fb] = self.laws(trial, from + (to - from) * (f64::from(k) + 0.5) / f64::from(lines));
            distance += (ff * g - 1.0).norm() / f64::from(lines);
            size += fb.norm() / f64::from(lines);
        }
        [distance, size]
    }

    /// A trial of this number, with noise of a seed.
    pub fn trial(&self, trial: f64, remnant: Remnant, seed: u64) -> Trial {
        let dt = self.group.sample_time_s();
        let command = self.group.command();
        let mut stream = rng::stream(seed, "remnant");
        let noise = self.noise(trial, remnant, &command, &mut stream);
        let discrete = |(num, den): (Vec<f64>, Vec<f64>)| {
            // A law that is zero has no transfer function.
            (num.iter().any(|c| *c != 0.0)).then(|| {
                Filter::new(&tustin(&TransferFunction::new(&num, &den, Continuous).unwrap(), self.time()).unwrap())
            })
        };
        let mut plant = Filter::new(&zero_order_hold(&self.group.system(), self.time()).unwrap());
        let (mut ff, mut fb) = (discrete(self.feedforward(trial)), discrete(self.feedback(trial)));
        let delay = self.delay_samples();
        let (mut u, mut y, mut e) = (Vec::new(), Vec::new(), Vec::new());
        for (k, r) in command.iter().enumerate() {
            let output = plant.pending();
            e.push(r - output);
            y.push(output);
            let delayed = if k >= delay { e[k - delay] } else { 0.0 };
            let control =
                ff.as_mut().map_or(0.0, |f| f.step(*r)) + fb.as_mut().map_or(0.0, |f| f.step(delayed)) + noise[k];
            plant.step(control);
            u.push(control);
        }
        // Recorded to five digits, as the files are.
        let digits = |x: Vec<f64>| x.into_iter().map(|v| (v * 1e5).round() / 1e5).collect();
        let signals = Signals {
            time_s: None,
            command: digits(command),
            control: digits(u),
            output: digits(y),
            disturbance: None,
        };
        Trial::new(dt, signals).unwrap()
    }

    fn noise(&self, trial: f64, remnant: Remnant, command: &[f64], stream: &mut Stream) -> Vec<f64> {
        let dt = self.group.sample_time_s();
        let size = self.remnant * (0.5 + 0.5 * (-trial / 10.0).exp());
        let mut white = |n: usize| -> Vec<f64> { (0..n).map(|_| stream.sample(StandardNormal)).collect() };
        let first_order = |w: &[f64], tau: f64| {
            let a = (-dt / tau).exp();
            let mut x = 0.0;
            w.iter()
                .map(|w| {
                    x = a * x + (1.0 - a * a).sqrt() * w;
                    x
                })
                .collect::<Vec<f64>>()
        };
        let n = command.len();
        let w = white(n);
        let unit = match remnant {
            Remnant::Ar1 => first_order(&w, 0.15),
            Remnant::SignalDependent => {
                let largest = command.iter().fold(0.0_f64, |a, r| a.max(r.abs()));
                first_order(&w, 0.15).iter().zip(command).map(|(x, r)| x * (0.3 + 1.4 * r.abs() / largest)).collect()
            }
            Remnant::Ar2 => {
                let (radius, turn) = ((-dt / 0.3).exp(), (2.0 * PI * 1.2 * dt).cos());
                let (mut x1, mut x2) = (0.0, 0.0);
                let x: Vec<f64> = w
                    .iter()
                    .map(|w| {
                        let x = 2.0 * radius * turn * x1 - radius * radius * x2 + w;
                        (x2, x1) = (x1, x);
                        x
                    })
                    .collect();
                let power = (x.iter().map(|x| x * x).sum::<f64>() / n as f64).sqrt();
                scaled(&x, 1.0 / power)
            }
            Remnant::White => w,
            Remnant::Ar1White => first_order(&w, 0.15).iter().zip(white(n)).map(|(x, v)| x + 0.5 * v).collect(),
            Remnant::Drift => first_order(&w, 5.0).iter().zip(white(n)).map(|(x, v)| x + 0.5 * v).collect(),
        };
        scaled(&unit, size)
    }
}
