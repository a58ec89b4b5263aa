//! The two-stimulus estimate on recorded people: agreement of both estimates, and the variance of held-out trials
//! accounted for.
//!
//! Two people with 30 trials on each of the plants 1/s and 1/(s(s+1)), command and disturbance as sums of sinusoids.
//!
//! # Protocol
//! Lines at the excited multiples of 0.05 Hz, two periods of 20 s after 5 s of ramp, the person's steady state at the
//! lines, per trial `1 − var(x − x̂)/var(x)` over these 40 s, means over held-out trials. Four half-splits, of each
//! type of trial (r, d, r and d) apart: even against odd positions, and by waveform (phases 0, 2, 4 of r and 1, 3 of d
//! against the others; of the trials with both, waveforms a0, a6, a5 against a2, a4), each in both directions. Novel
//! are trials whose waveform, up to sign, is not in the training half. What is fitted or chosen is so from the training
//! half alone.

use crate::recordings::{folder, read};
use num_complex::Complex64;
use std::collections::BTreeMap;
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::response::stimuli::{StimulusLines, stimulus_lines};
use volition::response::{CheckedSettings, Detrend, FrequencySettings, LengthSegments, Segments};
use volition::trial::Trial;
use volition::two_stimulus::controllers::{Controllers, controllers};
use volition::two_stimulus::fit::{Channel, FitSettings, Fitted, fit};
use volition::two_stimulus::regularised::{Regularised, default_sizes};
use volition::two_stimulus::responses::responses;
use volition::two_stimulus::simulate::simulate;
use volition::two_stimulus::steady::{ceilings, groups_by_stimuli};
use volition::two_stimulus::structure::{FeedbackLaw, FeedforwardLaw, Muscles, Person, RationalLaw, Structure};

const START: usize = 300;
const PERIODS: usize = 2400;

struct Recorded {
    trial: Trial,
    /// 0: r alone, 1: d alone, 2: both.
    kind: usize,
    /// Equal for trials with the same waveforms up to sign.
    waveform: String,
    /// Of the first of the two halves by waveform.
    first_half: bool,
}

fn people() -> BTreeMap<(String, String), Vec<Recorded>> {
    let folder = folder();
    let mut people: BTreeMap<(String, String), Vec<Recorded>> = BTreeMap::new();
    let mut index = ::csv::Reader::from_path(folder.join("index.csv")).unwrap();
    for row in index.deserialize::<BTreeMap<String, String>>() {
        let row = row.unwrap();
        let trial = read(&folder.join(&row["file"])).trial;
        let kind = match (row["reference"].as_str(), row["disturbance"].as_str()) {
            (_, "d-zer") => 0,
            ("r-zer", _) => 1,
            _ => 2,
        };
        // s49_p2a3_+1: phases p, arrangement a.
        let phases = row["protocol"].split('_').nth(1).unwrap().as_bytes();
        let (p, a) = (phases[1] - b'0', phases[3] - b'0');
        let (waveform, first_half) = match kind {
            0 => (format!("r{p}"), [0, 2, 4].contains(&p)),
            1 => (format!("d{p}"), [1, 3].contains(&p)),
            _ => (format!("a{}", if a == 6 { 0 } else { a }), [0, 5, 6].contains(&a)),
        };
        let key = (row["plant"].clone(), row["subject"].clone());
        people.entry(key).or_default().push(Recorded { trial, kind, waveform, first_half });
    }
    people
}

/// The plants as the experiment stepped and recorded them: behind a hold, and with the output after the step in the row
/// of the control that it was made with, `z G(z)`. So 1/s is T z/(z − 1).
fn plant(name: &str) -> System {
    let time = Discrete::new(1.0 / 60.0).unwrap();
    let den: &[f64] = if name == "1/s" { &[1.0, 0.0] } else { &[1.0, 1.0, 0.0] };
    let continuous = TransferFunction::new(&[1.0], den, Continuous).unwrap();
    let held = volition::control::discretise::zero_order_hold(&continuous, time).unwrap();
    let num = [held.num().coefficients(), &[0.0]].concat();
    System::Discrete(TransferFunction::new(&num, held.den().coefficients(), time).unwrap())
}

/// From rest u and d through the plant as recorded are y, to the digits of the files; without the shift they are not.
#[test]
fn the_plants_are_those_of_the_recordings() {
    for ((name, subject), trials) in &people() {
        let System::Discrete(shifted) = plant(name) else { panic!("a sampled plant") };
        let num = shifted.num().coefficients();
        let den = shifted.den().coefficients();
        let late = TransferFunction::new(&num[..num.len() - 1], den, shifted.time()).unwrap();
        let (mut best, mut without) = (0.0_f64, f64::INFINITY);
        for own in trials {
            let s = &own.trial.signals;
            let zeros = vec![0.0; s.control.len()];
            let d = s.disturbance.as_ref().unwrap_or(&zeros);
            let input: Vec<f64> = s.control.iter().zip(d).map(|(u, d)| u + d).collect();
            let missed = |plant: &TransferFunction<Discrete>| {
                let y = volition::control::simulate::filter(plant, &input).unwrap();
                let rest: Vec<f64> = y.iter().zip(&s.output).map(|(a, b)| a - b).collect();
                (variance(&rest) / variance(&s.output)).sqrt()
            };
            best = best.max(missed(&shifted));
            without = without.min(missed(&late));
        }
        eprintln!("{name:11} {subject} missed of y at most {best:.1e}, without the shift at least {without:.1e}");
        assert!(best < 0.02 && without > 2.0 * best, "{name} {subject}: {best} {without}");
    }
}

fn settings() -> CheckedSettings {
    let segments = Some(Segments::Length(LengthSegments { length_s: 20.0, start_s: 5.0 }));
    FrequencySettings { segments, detrend: Some(Detrend::Mean), ..FrequencySettings::default() }.check().unwrap()
}

fn lines(trials: &[&Recorded]) -> StimulusLines {
    let trials: Vec<&Trial> = trials.iter().map(|t| &t.trial).collect();
    stimulus_lines(&trials, &settings(), &Ctl::new()).unwrap()
}

/// Amplitudes of a trial, means of its two periods.
struct Steady {
    r: Vec<Complex64>,
    d: Vec<Complex64>,
    u: Vec<Complex64>,
    y: Vec<Complex64>,
}

fn steady(lines: &StimulusLines, trial: usize) -> Steady {
    let own: Vec<_> = lines.segments.iter().filter(|s| s.trial == trial).collect();
    assert_eq!(own.len(), 2);
    let mean = |a: &[Complex64], b: &[Complex64]| a.iter().zip(b).map(|(a, b)| (a + b) / 2.0).collect();
    Steady {
        r: mean(&own[0].command, &own[1].command),
        d: mean(&own[0].disturbance, &own[1].disturbance),
        u: mean(&own[0].control, &own[1].control),
        y: mean(&own[0].output, &own[1].output),
    }
}

fn variance(x: &[f64]) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / x.len() as f64
}

/// Shares of u and y that a steady state at the lines accounts for: the residual has the power off the lines, and that
/// of the misfit at them.
fn shares(trial: &Trial, measured: &Steady, plant: &[Complex64], control: &[Complex64]) -> [f64; 2] {
    let of = |x: &[f64], at_lines: &[Complex64], predicted: &[Complex64]| {
        let total = variance(&x[START..START + PERIODS]);
        let change: f64 = at_lines.iter().zip(predicted).map(|(a, p)| 0.5 * (a.norm_sqr() - (a - p).norm_sqr())).sum();
        change / total
    };
    let y: Vec<Complex64> = (0..plant.len()).map(|k| plant[k] * (control[k] + measured.d[k])).collect();
    [of(&trial.signals.control, &measured.u, control), of(&trial.signals.output, &measured.y, &y)]
}

fn fitted(train: &StimulusLines, plant: &System, structure: Structure, starts: usize) -> Fitted {
    let person = Person::new(plant, structure, [0.02, 1.0], 2.5).unwrap().with_feedforward_delay([-0.5, 1.0]);
    let how = FitSettings { channel: Channel::Control, starts, seed: 1 };
    fit(&responses(train), &person, &how, &Ctl::new()).unwrap()
}

type Predict = Box<dyn Fn(usize, usize, Complex64, Complex64) -> Complex64>;

fn parametric(fitted: Fitted, omega: &[f64]) -> Predict {
    let h: Vec<[Complex64; 4]> = omega.iter().map(|w| fitted.closed_loop(*w)).collect();
    Box::new(move |k, _, r, d| h[k][0] * r + h[k][2] * d)
}

/// The estimate without structure of each type of trial apart: least squares per line; where the type's training trials
/// do not excite a line, log magnitude and phase between (or the nearest of) those that they do.
fn by_type(train: &StimulusLines, kinds: &[usize]) -> Predict {
    let omega = train.omega_rad_s.clone();
    let mut table: Vec<[Vec<Complex64>; 2]> = Vec::new();
    for kind in 0..3 {
        table.push(std::array::from_fn(|stimulus| {
            let mut known: Vec<Option<Complex64>> = Vec::new();
            for k in 0..omega.len() {
                let (mut cross, mut power) = (Complex64::default(), 0.0);
                for s in train.segments.iter().filter(|s| kinds[s.trial] == kind) {
                    let x = if stimulus == 0 { s.command[k] } else { s.disturbance[k] };
                    cross += x.conj() * s.control[k];
                    power += x.norm_sqr();
                }
                known.push((power > 0.0).then(|| cross / power));
            }
            let mut filled: Vec<Complex64> = Vec::new();
            for k in 0..omega.len() {
                let below = (0..=k).rev().find_map(|i| Some((i, known[i]?)));
                let above = (k..omega.len()).find_map(|i| Some((i, known[i]?)));
                filled.push(match (below, above) {
                    (Some((i, a)), Some((j, b))) if i < j => {
                        let t = (omega[k] / omega[i]).ln() / (omega[j] / omega[i]).ln();
                        let turn = (b / a).arg();
                        Complex64::from_polar(a.norm().powf(1.0 - t) * b.norm().powf(t), a.arg() + t * turn)
                    }
                    (Some((_, a)), _) | (_, Some((_, a))) => a,
                    _ => Complex64::default(),
                });
            }
            filled
        }));
    }
    Box::new(move |k, kind, r, d| table[kind][0][k] * r + table[kind][1][k] * d)
}

const MODELS: [&str; 8] = [
    "error feedback with lead, lag, delay",
    "+ feedforward K_ff G^-1 lag delay",
    "+ neuromuscular lag",
    "without structure, by type",
    "regularised towards + neuromuscular lag",
    "+ neuromuscular system of second order",
    "regularised towards that",
    "at the lines, all of it (ceiling)",
];

/// The place of the ceiling.
const CEILING: usize = MODELS.len() - 1;

/// `[u, y, novel u, novel y]` per model, with the smallest and largest of the splits for u and y.
fn table(plant_name: &str, all: &[Recorded]) -> Vec<[f64; 4]> {
    let plant = plant(plant_name);
    let whole = lines(&all.iter().collect::<Vec<_>>());
    let measured: Vec<Steady> = (0..all.len()).map(|i| steady(&whole, i)).collect();
    let g: Vec<Complex64> = whole.omega_rad_s.iter().map(|w| plant.response(*w)).collect();
    let mut position = [0; 3];
    let is_even: Vec<bool> = all
        .iter()
        .map(|t| {
            position[t.kind] += 1;
            position[t.kind] % 2 == 1
        })
        .collect();
    let by_waveform: Vec<bool> = all.iter().map(|t| t.first_half).collect();
    let mut sums = vec![[0.0; 4]; MODELS.len()];
    let mut novel_count = 0.0;
    for (halves, direct) in [(&is_even, true), (&is_even, false), (&by_waveform, true), (&by_waveform, false)] {
        let train: Vec<&Recorded> = all.iter().zip(halves).filter(|(_, h)| **h == direct).map(|(t, _)| t).collect();
        let held: Vec<usize> = (0..all.len()).filter(|i| halves[*i] != direct).collect();
        let data = lines(&train);
        assert_eq!(data.omega_rad_s, whole.omega_rad_s, "every line is in every half");
        let kinds: Vec<usize> = train.iter().map(|t| t.kind).collect();
        let omega = &whole.omega_rad_s;
        let law = fitted(&data, &plant, Structure::mcruer(true, Muscles::Lag), 4);
        let shrunk = Regularised::new(&data, &kinds, &law, &default_sizes(), &Ctl::new()).unwrap();
        let second = fitted(&data, &plant, Structure::mcruer(true, Muscles::SecondOrder), 4);
        let shrunk_to_second = Regularised::new(&data, &kinds, &second, &default_sizes(), &Ctl::new()).unwrap();
        let (known, also_known) = (omega.clone(), omega.clone());
        let predictions: Vec<Predict> = vec![
            parametric(fitted(&data, &plant, Structure::mcruer(false, Muscles::None), 4), omega),
            parametric(fitted(&data, &plant, Structure::mcruer(true, Muscles::None), 4), omega),
            parametric(law, omega),
            by_type(&data, &kinds),
            Box::new(move |k, kind, r, d| shrunk.control(known[k], kind, r, d)),
            parametric(second, omega),
            Box::new(move |k, kind, r, d| shrunk_to_second.control(also_known[k], kind, r, d)),
        ];
        for &i in &held {
            let own = &measured[i];
            let is_novel = !train.iter().any(|t| t.waveform == all[i].waveform);
            novel_count += f64::from(u8::from(is_novel));
            for (m, sum) in sums.iter_mut().enumerate() {
                let control: Vec<Complex64> = match predictions.get(m) {
                    Some(predict) => (0..omega.len()).map(|k| predict(k, all[i].kind, own.r[k], own.d[k])).collect(),
                    None => (0..omega.len())
                        .map(|k| if own.r[k] + own.d[k] == Complex64::default() { 0.0.into() } else { own.u[k] })
                        .collect(),
                };
                let [u, y] = shares(&all[i].trial, own, &g, &control);
                sum[0] += u / (4.0 * held.len() as f64);
                sum[1] += y / (4.0 * held.len() as f64);
                if is_novel {
                    sum[2] += u;
                    sum[3] += y;
                }
            }
        }
    }
    for sum in &mut sums {
        sum[2] /= novel_count;
        sum[3] /= novel_count;
    }
    sums
}

#[test]
fn held_out_variance_accounted_for() {
    let people = people();
    let mut medians: BTreeMap<&str, Vec<[f64; 4]>> = BTreeMap::new();
    // At the lines, one response by type known without error, the same from the other trials of the type.
    let mut limits: BTreeMap<&str, [[f64; 2]; 3]> = BTreeMap::new();
    for ((plant, subject), trials) in &people {
        assert_eq!(trials.len(), 30);
        let whole = lines(&trials.iter().collect::<Vec<_>>());
        let kinds: Vec<usize> = trials.iter().map(|t| t.kind).collect();
        assert_eq!(groups_by_stimuli(&whole), kinds);
        let found = ceilings(&whole, &kinds);
        eprintln!("{plant:11} {subject} {found:.3?}");
        let sums = limits.entry(if plant == "1/s" { "1/s" } else { "1/(s(s+1))" }).or_default();
        for (sum, share) in sums.iter_mut().zip([found.at_lines, found.by_group, found.left_out]) {
            (0..2).for_each(|i| sum[i] += 0.5 * share[i].unwrap());
        }
        let rows = table(plant, trials);
        for (name, row) in MODELS.iter().zip(&rows) {
            eprintln!(
                "{plant:11} {subject} {name:42} u {:.3} y {:.3} novel u {:.3} y {:.3}",
                row[0], row[1], row[2], row[3]
            );
        }
        // The median of two is their mean.
        let plant = if plant == "1/s" { "1/s" } else { "1/(s(s+1))" };
        let sums = medians.entry(plant).or_insert_with(|| vec![[0.0; 4]; MODELS.len()]);
        for (sum, row) in sums.iter_mut().zip(&rows) {
            (0..4).for_each(|i| sum[i] += 0.5 * row[i]);
        }
    }
    for (plant, rows) in &medians {
        for (name, row) in MODELS.iter().zip(rows) {
            eprintln!(
                "{plant:11} median {name:42} u {:.3} y {:.3} novel u {:.3} y {:.3}",
                row[0], row[1], row[2], row[3]
            );
        }
        let ours = rows[4];
        for (i, baseline) in rows[..4].iter().enumerate() {
            assert!((0..4).all(|j| ours[j] > baseline[j]), "{plant}: {} is as good", MODELS[i]);
        }
        assert!((0..4).all(|j| ours[j] < rows[CEILING][j]), "nothing passes the ceiling");
        // How much there is to gain: a response of each type known without error, and one from the nine other trials of
        // the type, twice as many as the halves have.
        let [at_lines, known, left_out] = limits[plant];
        eprintln!(
            "{plant:11} ceilings: at the lines {at_lines:.3?}, by type {known:.3?}, by type from the others \
             {left_out:.3?}"
        );
        assert!((0..2).all(|j| ours[j] < known[j] && left_out[j] < known[j] && known[j] < at_lines[j]));
        assert!((0..2).all(|j| ours[j] > known[j] - 0.05));
        // What the table over seven people has for u is passed; its .83 and .55 for y are not reached, nor are they by
        // any of its own models on these two people.
        let floor = if *plant == "1/s" { [0.745, 0.822, 0.735, 0.835] } else { [0.435, 0.51, 0.425, 0.495] };
        assert!((0..4).all(|j| ours[j] > floor[j]), "{plant}: {ours:?}");
    }
}

/// How many magnitudes and phases lie within both 95 % bands, of how many.
fn report(plant: &str, subject: &str, what: &str, law: &Fitted, free: &Controllers) -> (usize, usize) {
    let (mut within, mut compared) = (0, 0);
    for line in &free.lines {
        let bands = law.bands(line.response.omega_rad_s);
        for (estimate, band) in [(line.feedback.unwrap(), bands[0]), (line.feedforward.unwrap(), bands[1])] {
            let Some([size, phase]) = band.deviation else { continue };
            let width = estimate.half_width(0.95).unwrap();
            let ratio = (estimate.value / band.value).ln();
            compared += 2;
            within += usize::from(ratio.re.abs() <= width.hypot(law.quantile(0.95) * size));
            within += usize::from(ratio.im.abs() <= width.hypot(law.quantile(0.95) * phase));
        }
    }
    eprintln!(
        "{plant:11} {subject} {what}: {within} of {compared} within both bands, reduced chi-square {:.2}, Akaike {:.0}",
        law.reduced_chi_square.unwrap(),
        law.akaike.unwrap()
    );
    (within, compared)
}

#[test]
fn both_estimates_agree_within_their_bands_at_the_excited_lines() {
    let people = people();
    for ((name, subject), trials) in &people {
        let plant = plant(name);
        let data = lines(&trials.iter().collect::<Vec<_>>());
        let found = responses(&data);
        let free = controllers(&found);
        let ladder = fitted(&data, &plant, Structure::mcruer(true, Muscles::Lag), 4);
        report(name, subject, "ladder", &ladder, &free);
        // McRuer's ladder is too stiff for responses this precise. Of seven pairs of rational laws with delays these
        // were taken after looking: the smallest that agree on all lines.
        let law =
            |numerator_degree, denominator_degree| RationalLaw { numerator_degree, denominator_degree, delay: true };
        let structure = Structure {
            feedback: FeedbackLaw::Rational(if name == "1/s" { law(3, 3) } else { law(2, 3) }),
            feedforward: FeedforwardLaw::Rational(law(3, 4)),
            neuromuscular_lag: false,
            neuromuscular_second_order: false,
        };
        let flexible = fitted(&data, &plant, structure, 6);
        let (within, compared) = report(name, subject, "rational", &flexible, &free);
        assert_eq!(compared, 4 * free.lines.len(), "magnitude and phase of both controllers at every line");
        assert!(within as f64 >= 0.95 * compared as f64, "{name} {subject}: {within} of {compared}");
        assert!(flexible.akaike.unwrap() < ladder.akaike.unwrap());
        let distance: f64 = free
            .lines
            .iter()
            .map(|l| (l.feedforward.unwrap().value * plant.response(l.response.omega_rad_s) - 1.0).norm())
            .sum::<f64>()
            / free.lines.len() as f64;
        eprintln!("{name:11} {subject} mean |Gff G − 1| {distance:.2}");
    }
}

#[test]
fn the_steady_state_is_what_a_simulation_from_rest_comes_to() {
    let people = people();
    for ((name, subject), trials) in &people {
        let plant = plant(name);
        let data = lines(&trials.iter().collect::<Vec<_>>());
        let law = fitted(&data, &plant, Structure::mcruer(true, Muscles::Lag), 4);
        let g: Vec<Complex64> = data.omega_rad_s.iter().map(|w| plant.response(*w)).collect();
        let (mut steady_sum, mut simulated_sum) = ([0.0; 2], [0.0; 2]);
        for (i, own) in trials.iter().enumerate() {
            let measured = steady(&data, i);
            let control: Vec<Complex64> = data
                .omega_rad_s
                .iter()
                .enumerate()
                .map(|(k, w)| {
                    let h = law.closed_loop(*w);
                    h[0] * measured.r[k] + h[2] * measured.d[k]
                })
                .collect();
            let a = shares(&own.trial, &measured, &g, &control);
            let signals = &own.trial.signals;
            let run = simulate(
                |w| law.closed_loop(w),
                &signals.command,
                signals.disturbance.as_deref(),
                own.trial.sample_time_s,
                4.0 * data.omega_rad_s[data.omega_rad_s.len() - 1],
            )
            .unwrap();
            for (j, (recorded, simulated)) in
                [(&signals.control, &run.control), (&signals.output, &run.output)].into_iter().enumerate()
            {
                let window = START..START + PERIODS;
                let missed: Vec<f64> = window.clone().map(|k| recorded[k] - simulated[k]).collect();
                simulated_sum[j] += (1.0 - variance(&missed) / variance(&recorded[window])) / trials.len() as f64;
                steady_sum[j] += a[j] / trials.len() as f64;
            }
        }
        eprintln!("{name:11} {subject} steady {steady_sum:.3?} simulated {simulated_sum:.3?}");
        assert!((0..2).all(|j| (steady_sum[j] - simulated_sum[j]).abs() < 0.02));
    }
}
