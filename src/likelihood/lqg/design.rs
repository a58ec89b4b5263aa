//! What is known of the person beforehand.

use super::jet::Jet;
use nalgebra::DMatrix;

/// A plant in sampled time, `x⁺ = Ax + B(u + m) + Ed + w`, `y = Cx + Dd + v`, or what a person takes it for.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant {
    /// A, n×n.
    pub a: DMatrix<f64>,
    /// B, n×m: what the person does.
    pub b: DMatrix<f64>,
    /// C, p×n: what the person senses.
    pub c: DMatrix<f64>,
    /// E, n×q: what the experimenter does.
    pub e: DMatrix<f64>,
    /// D, p×q: what the person senses of it at once, such as a target.
    pub d: DMatrix<f64>,
}

/// Which matrix a term is part of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Q, n×n: what the person weighs of the states.
    StateWeight,
    /// Q_N, n×n: what the person weighs of the states at the end of a finite horizon.
    TerminalWeight,
    /// R, m×m: what the person weighs of the controls.
    ControlWeight,
    /// W_p, n×n: the process noise that the person's filter is made for.
    PerceivedProcessNoise,
    /// V_p, p×p: the noise of the senses that the person's filter is made for.
    PerceivedMeasurementNoise,
    /// S_0, n×n: how uncertain the person is of the first state, before anything is sensed.
    InitialCovariance,
    /// W, n×n: the true process noise.
    ProcessNoise,
    /// V, p×p: the true noise of the senses.
    MeasurementNoise,
    /// M, m×m: the true noise of the motor, added to the control.
    MotorNoise,
    /// c: the standard deviation of a noise of the motor over the control that it comes with, known to the person.
    ControlDependentNoise,
}

/// A term `e^θ · shape` of one of the matrices.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// Its name.
    pub name: String,
    /// The matrix that it is part of.
    pub role: Role,
    /// Symmetric and positive semidefinite; of c the 1×1 identity.
    pub shape: DMatrix<f64>,
    /// The coefficient where it is known and not estimated; it may be zero then.
    pub held: Option<f64>,
    /// Where the user starts it.
    pub start: Option<f64>,
    /// Another term, by its place, whose coefficient it has; that one has a coefficient of its own.
    pub same_as: Option<usize>,
}

/// When the person's belief takes in what is sensed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Timing {
    /// `u_k` rests on y up to k − 1: `x̂⁺ = Ax̂ + Bu + L(y − Cx̂)`.
    Predictor,
    /// `u_k` rests on y up to k: `x̂ = x̂⁻ + L(y − Cx̂⁻)`, `x̂⁻⁺ = Ax̂ + Bu`, with `L = S Cᵀ(CSCᵀ + V_p)⁻¹`.
    Filter,
}

/// What was recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// Rows `[C_r D_r]` of what was recorded of states and disturbance; `None` where that is what the person senses.
    pub rows: Option<[DMatrix<f64>; 2]>,
    /// The covariance of the instrument that recorded the outputs apart from the senses, zero where it is exact; `None`
    /// where what was recorded is what the person sensed, noise included.
    pub instrument: Option<DMatrix<f64>>,
    /// The control, with the covariance, m×m, of what recorded it (zero where it is exact); `None` where it was not
    /// recorded.
    pub control: Option<DMatrix<f64>>,
    /// Whether the recorded control is `u + m`, what reached the plant, instead of the command u.
    pub is_applied: bool,
}

/// What the trials start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// x and the belief are what the record says, zero where it says nothing, exactly.
    Rest,
    /// Anywhere where the loop's own noise takes it: mean zero, and the covariance of the loop's steady state.
    Settled,
}

/// A horizon that ends: gains that change from sample to sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Horizon {
    /// N: controls `u_0 … u_{N−1}`, and the terminal cost is of `x_N`.
    pub steps: usize,
    /// What the filter starts from.
    pub filter: FilterStart,
}

/// What the filter starts from where the horizon ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilterStart {
    /// The steady state, whatever S_0.
    Settled,
    /// S_0, before the first sample.
    BeforeFirst,
    /// S_0, before the second sample; the first one is taken in with the second one's gain, as the package `lqg` does.
    BeforeSecond,
}

/// Everything that is known beforehand. Its parameters θ are the logarithms of the coefficients of the terms that are
/// neither held nor those of another term, in the order of the terms.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// The plant.
    pub plant: Plant,
    /// What the person takes it for, where that is something else: of as many inputs and sensed outputs. Costs and
    /// perceived noises are of its states.
    pub internal: Option<Plant>,
    /// The terms of all matrices.
    pub terms: Vec<Term>,
    /// What R has beside its terms, m×m: the scale of the costs where it has none.
    pub control_weight: DMatrix<f64>,
    /// What V_p has beside its terms, p×p: the scale of the perceived noises where it has none.
    pub perceived_measurement_noise: DMatrix<f64>,
    /// Whether the person knows d.
    pub is_told: bool,
    /// When the belief takes in what is sensed.
    pub timing: Timing,
    /// What was recorded.
    pub recorded: Recorded,
    /// What the trials start from.
    pub start: Start,
    /// A horizon that ends; `None` where it does not.
    pub horizon: Option<Horizon>,
    /// Where v enters the state on its way to the person, n×p, where what is sensed is delayed; it arrives without
    /// further noise then. See [`delayed`](Self::delayed).
    pub on_the_way: Option<DMatrix<f64>>,
}

/// A person: what the parameters come to.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// K, m×n; that of the first sample where the horizon ends.
    pub k: DMatrix<f64>,
    /// L, n×p: the gain of the predictor, or of the filter, by [`Timing`]; that of the first sample where it changes.
    pub l: DMatrix<f64>,
    /// Q, n×n.
    pub q: DMatrix<f64>,
    /// W_p, n×n.
    pub perceived: DMatrix<f64>,
    /// Derivatives of K by θ, `None` where it does not move; empty where none were asked for.
    pub k_slopes: Vec<Option<DMatrix<f64>>>,
    /// Derivatives of L.
    pub l_slopes: Vec<Option<DMatrix<f64>>>,
}

impl Design {
    /// n, m, p, q: states, controls, sensed outputs, inputs of the experimenter.
    #[must_use]
    pub fn sizes(&self) -> [usize; 4] {
        let Plant { a, b, c, e, .. } = &self.plant;
        [a.nrows(), b.ncols(), c.nrows(), e.ncols()]
    }

    /// What the person takes the plant for.
    #[must_use]
    pub fn internal(&self) -> &Plant {
        self.internal.as_ref().unwrap_or(&self.plant)
    }

    /// What was recorded of states and disturbance, `[C_r D_r]`.
    #[must_use]
    pub fn recorded_rows(&self) -> [&DMatrix<f64>; 2] {
        self.recorded.rows.as_ref().map_or([&self.plant.c, &self.plant.d], |[c, d]| [c, d])
    }

    /// Recorded outputs.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.recorded_rows()[0].nrows()
    }

    /// The terms that are estimated, in the order of θ.
    pub fn free(&self) -> impl Iterator<Item = &Term> + Clone {
        self.terms.iter().filter(|term| term.held.is_none() && term.same_as.is_none())
    }

    /// Of every term the parameter that its coefficient is the exponential of; `None` where it is held.
    #[must_use]
    pub fn parameter(&self, at: usize) -> Option<usize> {
        let own = |at: usize| {
            let is_free = |term: &&Term| term.held.is_none() && term.same_as.is_none();
            self.terms[at].held.is_none().then(|| self.terms[..at].iter().filter(is_free).count())
        };
        self.terms[at].same_as.map_or_else(|| own(at), own)
    }

    /// The coefficient of a term at θ.
    #[must_use]
    pub fn coefficient(&self, at: usize, theta: &[f64]) -> f64 {
        let held = |at: usize| self.terms[at].held;
        let value = self.parameter(at).and_then(|i| theta.get(i)).map(|v| v.exp());
        value.or_else(|| held(self.terms[at].same_as.unwrap_or(at))).unwrap_or(f64::NAN)
    }

    /// The sum of a role's terms at θ on top of `base`, with derivatives by θ if asked: that of a term by its logarithm
    /// is the term itself.
    pub(super) fn sum(&self, theta: &[f64], role: Role, base: &DMatrix<f64>, slopes: bool) -> Jet {
        let count = if slopes { theta.len() } else { 0 };
        let mut value = base.clone();
        let mut moved: Vec<Option<DMatrix<f64>>> = vec![None; count];
        for (at, term) in self.terms.iter().enumerate().filter(|(_, term)| term.role == role) {
            let part = &term.shape * self.coefficient(at, theta);
            value += &part;
            if let Some(slot) = self.parameter(at).and_then(|i| moved.get_mut(i)) {
                *slot = Some(slot.take().map_or(part.clone(), |sum| sum + part));
            }
        }
        Jet::new(&value, moved.iter().map(Option::as_ref))
    }

    /// Whether a role has a term that is not held at zero.
    #[must_use]
    pub fn has(&self, role: Role) -> bool {
        self.terms.iter().any(|term| term.role == role && term.held != Some(0.0))
    }

    /// Whether gains are those of the plant itself, undelayed, without end: what twins and free fits are about.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        self.internal.is_none()
            && self.horizon.is_none()
            && self.on_the_way.is_none()
            && self.recorded.rows.is_none()
            && !self.has(Role::ControlDependentNoise)
            && self.plant.d.amax() == 0.0
            && self.terms.iter().all(|term| term.same_as.is_none())
            && !self.has(Role::ControlWeight)
            && !self.has(Role::PerceivedMeasurementNoise)
    }
}
