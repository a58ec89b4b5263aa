//! Plant and belief as one linear system, with what was recorded of it.
//!
//! ```text
//! s⁺ = F s + Γ d + G_w w + G_v v + G_m m,    z = H s + Θ d + J_v v + J_m m + r
//! ```
//! With the person's A_a, B_a, C_a, E_a beside the true A, B, C, E, and `told` 1 for a person who knows d and 0
//! otherwise, in the predictor's timing `s = [x; x̂]`,
//!
//! ```text
//! F = [A −BK; LC A_a−B_aK−LC_a],  Γ = [E; told E_a + (1−told)LD],  G_w = [I; 0],  G_v = [0; L],  G_m = [B; 0],
//! ```
//! and the rows of H are `[C_r 0]` for y and `[0 −K]` for u. In the filter's timing `s = [x; x̂⁻]` with the belief
//! before y was sensed, so that v enters z and s⁺ at one moment: with `T = I − LC_a` and `A_c = A_a − B_aK`
//!
//! ```text
//! F = [A−BKLC −BKT; A_cLC A_cT],  Γ = [E − BKLD'; told E_a + A_cLD'],  G_v = [−BKL; A_cL],  D' = (1−told)D
//! ```
//! and u has the row `[−KLC −KT]`, with `Θ = −KLD'` and `J_v = −KL`. `J_v = I` for a y that is what the person sensed;
//! `J_m = I` for an applied control. Where what is sensed is delayed v enters the line instead, and L senses its end
//! alone.

use super::design::{Design, Plant, Role, Timing};
use super::gains::Gains;
use super::jet::Jet;
use nalgebra::DMatrix;

/// The joint system of plant and belief with as many outputs as were recorded, and its derivatives.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Joint {
    /// F.
    pub f: Jet,
    /// H, channels × states.
    pub h: Jet,
    /// Γ, states × q.
    pub drive: Jet,
    /// Θ, channels × q.
    pub through: Jet,
    /// Covariance of what drives s.
    pub q: Jet,
    /// Covariance of what is added to z.
    pub n: Jet,
    /// Cross-covariance of both, states × channels.
    pub x: Jet,
    /// Covariance of s at a start that is known: that of the noise that is on its way to the person.
    pub on_the_way: Option<Jet>,
    /// Noise of the motor that grows with the control.
    pub grown: Option<Grown>,
}

/// What makes noise of the control: its variances are those of `C_u diag(E u²) C_u`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grown {
    /// The rows of u in s, m × states.
    pub control: Jet,
    /// `G_m C_u`, states × m.
    pub entry: Jet,
}

/// True noises at θ.
struct Noises {
    w: Jet,
    v: Jet,
    m: Jet,
    u: Option<Jet>,
}

impl Design {
    /// Rows of z: y, then u where it was recorded.
    #[must_use]
    pub fn channels(&self) -> usize {
        let [_, m, ..] = self.sizes();
        self.outputs() + if self.recorded.control.is_some() { m } else { 0 }
    }

    /// States of plant and belief together.
    #[must_use]
    pub fn width(&self) -> usize {
        self.plant.a.nrows() + self.internal().a.nrows()
    }

    /// The systems of all gains, in the order in which samples need them, and of every sample its place.
    pub(super) fn joints(&self, theta: &[f64], gains: &Gains, slopes: bool) -> (Vec<Joint>, Vec<usize>) {
        let [n, m, p, _] = self.sizes();
        let zero = |order: usize| DMatrix::zeros(order, order);
        let noises = Noises {
            w: self.sum(theta, Role::ProcessNoise, &zero(n), slopes),
            v: self.sum(theta, Role::MeasurementNoise, &zero(p), slopes),
            m: self.sum(theta, Role::MotorNoise, &zero(m), slopes),
            u: self
                .has(Role::ControlDependentNoise)
                .then(|| self.sum(theta, Role::ControlDependentNoise, &zero(m), slopes)),
        };
        let mut found: Vec<Joint> = Vec::new();
        let mut places = Vec::new();
        let mut last = None;
        for sample in 0..gains.len() {
            let place = gains.place(sample);
            if last != Some(place) {
                found.push(self.joint(gains.at(sample), &noises));
                last = Some(place);
            }
            places.push(found.len() - 1);
        }
        (found, places)
    }

    /// The system of a sample's gains.
    fn joint(&self, [k, l]: [&Jet; 2], noises: &Noises) -> Joint {
        let count = noises.w.count();
        let [n, m, p, q] = self.sizes();
        let (outputs, channels, width) = (self.outputs(), self.channels(), self.width());
        let own = width - n;
        let fixed = |matrix: &DMatrix<f64>| Jet::fixed(matrix, count);
        let zeros = |rows, columns| Jet::zeros(rows, columns, count);
        let Plant { a, b, c, e, d } = &self.plant;
        let internal = self.internal();
        let (a, b, c) = (fixed(a), fixed(b), fixed(c));
        let told = f64::from(u8::from(self.is_told));
        let seen = fixed(&(d * (1.0 - told)));
        let [rows, _] = self.recorded_rows();
        let has_control = self.recorded.control.is_some();
        let lc = l.times(&c);
        let closed = fixed(&internal.a).add(&fixed(&internal.b).times(k), -1.0);
        let (bottom, of_control, left) = match self.timing {
            Timing::Predictor => {
                let rest = closed.add(&l.times(&fixed(&internal.c)), -1.0);
                (zeros(own, own).add(&rest, 1.0), zeros(m, width).put((0, n), k, -1.0), None)
            }
            Timing::Filter => {
                let t = fixed(&DMatrix::identity(own, own)).add(&l.times(&fixed(&internal.c)), -1.0);
                let control = zeros(m, width).put((0, 0), &k.times(&lc), -1.0).put((0, n), &k.times(&t), -1.0);
                (closed.times(&t), control, Some(closed))
            }
        };
        // What of the senses reaches x and the belief: by the control at once, and by the belief.
        let (at_once, by_belief) = match &left {
            None => (None, l.clone()),
            Some(closed) => (Some(k.times(l)), closed.times(l)),
        };
        let mut f = zeros(width, width).put((0, 0), &a, 1.0).put((n, n), &bottom, 1.0);
        f = f.put((n, 0), &by_belief.times(&c), 1.0);
        f = f.put((0, 0), &b.times(&of_control), 1.0);
        let mut h = zeros(channels, width).put((0, 0), &fixed(rows), 1.0);
        let mut drive = zeros(width, q).put((0, 0), &fixed(e), 1.0).put((n, 0), &fixed(&internal.e), told);
        drive = drive.put((n, 0), &by_belief.times(&seen), 1.0);
        let mut through = zeros(channels, q).put((0, 0), &fixed(self.recorded_rows()[1]), 1.0);
        let mut gv = zeros(width, p).put((n, 0), &by_belief, 1.0);
        let mut jv = zeros(channels, p);
        if let Some(at_once) = &at_once {
            let of_seen = at_once.times(&seen);
            drive = drive.put((0, 0), &b.times(&of_seen), -1.0);
            gv = gv.put((0, 0), &b.times(at_once), -1.0);
            if has_control {
                through = through.put((outputs, 0), &of_seen, -1.0);
                jv = jv.put((outputs, 0), at_once, -1.0);
            }
        }
        if let Some(entry) = &self.on_the_way {
            // What arrives has its noise with it.
            gv = zeros(width, p).put((0, 0), &fixed(entry), 1.0);
            jv = zeros(channels, p);
        }
        if self.recorded.instrument.is_none() {
            jv = jv.put((0, 0), &fixed(&DMatrix::identity(p, p)), 1.0);
        }
        if has_control {
            h = h.put((outputs, 0), &of_control, 1.0);
        }
        let gm = zeros(width, m).put((0, 0), &b, 1.0);
        let applied = has_control && self.recorded.is_applied;
        let jm = zeros(channels, m);
        let jm = if applied { jm.put((outputs, 0), &fixed(&DMatrix::identity(m, m)), 1.0) } else { jm };
        let on_the_way = self.on_the_way.as_ref().map(|entry| {
            let first = (0..n).find(|i| entry.row(*i).amax() > 0.0).unwrap_or(n);
            (first..n).step_by(p).fold(zeros(width, width), |sum, at| sum.put((at, at), &noises.v, 1.0))
        });
        let (gv_v, gm_m) = (gv.times(&noises.v), gm.times(&noises.m));
        let mut noise = jv.times(&noises.v).times_transposed(&jv);
        noise = noise.add(&jm.times(&noises.m).times_transposed(&jm), 1.0);
        if let Some(instrument) = &self.recorded.instrument {
            noise = noise.put((0, 0), &fixed(instrument), 1.0);
        }
        if let Some(recorder) = &self.recorded.control {
            noise = noise.put((outputs, outputs), &fixed(recorder), 1.0);
        }
        Joint {
            q: gv_v.times_transposed(&gv).add(&gm_m.times_transposed(&gm), 1.0).put((0, 0), &noises.w, 1.0),
            x: gv_v.times_transposed(&jv).add(&gm_m.times_transposed(&jm), 1.0),
            n: noise,
            on_the_way,
            grown: noises.u.as_ref().map(|u| Grown { control: of_control.clone(), entry: gm.times(u) }),
            f,
            h,
            drive,
            through,
        }
    }
}
