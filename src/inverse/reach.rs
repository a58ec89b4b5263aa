//! The question in balanced units, on the states that inputs reach: what a verdict is about.

use super::balance::{Balanced, balanced};
use super::rounding::{Rounding, stability};
use super::staircase::Staircase;
use crate::control::lyapunov::Clock;
use crate::num::linalg::{NoConvergence, symmetric};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Beyond the boundary of stability by this share of the loop's size an eigenvalue is unstable, simple or not.
const CLEARLY: f64 = 1e-6;

/// A controllable plant with a gain that stabilises it, in balanced units, and the box around it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Core {
    pub a: DMatrix<f64>,
    pub b: DMatrix<f64>,
    pub k: DMatrix<f64>,
    pub clock: Clock,
    pub rounding: Rounding,
}

impl Core {
    pub(super) fn states(&self) -> usize {
        self.a.nrows()
    }

    pub(super) fn ports(&self) -> usize {
        self.b.ncols()
    }

    pub(super) fn closed_loop(&self) -> DMatrix<f64> {
        &self.a - &self.b * &self.k
    }

    /// A box of K with equal entries.
    pub(super) fn uniform(&self, entry: f64) -> DMatrix<f64> {
        DMatrix::from_element(self.k.nrows(), self.k.ncols(), entry)
    }
}

/// Set points: targets or references in the state that no input reaches and that do not decay.
#[derive(Debug, Clone, PartialEq)]
pub struct Targets {
    /// The eigenvalues of these modes.
    pub modes: Vec<Complex64>,
    /// V, n×k, in the units of the plant: the states that the loop holds against the modes, one column for each.
    pub set_points: DMatrix<f64>,
    /// `(e, δ) = Mx`: the errors of the states that inputs reach, and what decays by itself.
    pub(super) map: DMatrix<f64>,
    /// The plant and gain of e and δ.
    pub(super) errors: [DMatrix<f64>; 3],
}

impl Targets {
    /// A weight on the errors as one on the states: `MᵀQM`.
    pub(super) fn lift(&self, weight: &DMatrix<f64>) -> DMatrix<f64> {
        symmetric(&self.map.tr_mul(&(weight * &self.map)))
    }
}

/// What the inputs of a plant reach, and what a gain makes of the rest.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reach {
    pub core: Core,
    balanced: Balanced,
    /// The box around it.
    rounding: Rounding,
    staircase: Staircase,
    pub targets: Option<Targets>,
    /// Modes that no input reaches and that decay by themselves.
    pub decaying: Vec<Complex64>,
}

/// Why there is no question.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ReachError {
    /// No input reaches anything.
    Nothing,
    /// The loop has this eigenvalue.
    Unstable(Complex64),
    /// The loop is stable only within rounding.
    Marginal {
        pole: Complex64,
        shift: f64,
    },
    /// A set point costs for ever.
    EndlessCost {
        mode: Complex64,
        cost: f64,
    },
    NoConvergence(NoConvergence),
}

impl From<NoConvergence> for ReachError {
    fn from(error: NoConvergence) -> Self {
        Self::NoConvergence(error)
    }
}

impl Reach {
    pub(super) fn new(
        a: &DMatrix<f64>,
        b: &DMatrix<f64>,
        k: &DMatrix<f64>,
        clock: Clock,
        gain_rounding: Option<&DMatrix<f64>>,
    ) -> Result<Self, ReachError> {
        let scaled = balanced(a, b, k);
        let gain = gain_rounding
            .map(|r| DMatrix::from_fn(r.nrows(), r.ncols(), |i, j| r[(i, j)] / scaled.inputs[i] * scaled.states[j]));
        let staircase = Staircase::new(&scaled)?;
        if staircase.reached == 0 {
            return Err(ReachError::Nothing);
        }
        let [a, b, k] = staircase.controllable();
        let whole = Rounding::around(&scaled.a, &scaled.b, &scaled.k, gain.as_ref());
        let is_whole = staircase.reached == scaled.a.nrows();
        let gain = gain.map(|g| if is_whole { g } else { (g * staircase.basis.abs()).columns(0, a.ncols()).into() });
        let core = Core { rounding: Rounding::around(&a, &b, &k, gain.as_ref()), a, b, k, clock };
        check_stable(&core)?;
        let rotated = &whole.k * staircase.basis.abs();
        let points = staircase.set_points(clock, &rotated)?;
        let unreached = staircase.unreached()?;
        let lasting = points.as_ref().map_or(&[][..], |points| &points.modes[..]);
        let decaying = unreached.iter().map(|pole| pole.value).filter(|v| !lasting.contains(v)).collect();
        let targets = match points {
            None => None,
            Some(points) if !points.is_held => {
                let mode = points.modes[0];
                return Err(ReachError::EndlessCost { mode, cost: points.cost });
            }
            Some(points) => {
                let errors = points.errors(&staircase);
                // Back to the units of the plant: x = D U x', u = E u'.
                let n = scaled.a.nrows();
                let to_plant = DMatrix::from_diagonal(&scaled.states) * &staircase.basis;
                let from_plant = DMatrix::from_fn(n, n, |i, j| staircase.basis[(j, i)] / scaled.states[j]);
                let mut points_there = DMatrix::zeros(n, points.modes.len());
                points_there.rows_mut(0, staircase.reached).copy_from(&points.states);
                points_there.rows_mut(staircase.reached, n - staircase.reached).copy_from(&points.unreached);
                let (b, k) = (
                    DMatrix::from_fn(errors.b.nrows(), errors.b.ncols(), |i, j| errors.b[(i, j)] / scaled.inputs[j]),
                    DMatrix::from_fn(errors.k.nrows(), errors.k.ncols(), |i, j| errors.k[(i, j)] * scaled.inputs[i]),
                );
                Some(Targets {
                    modes: points.modes,
                    set_points: to_plant * points_there,
                    map: errors.map * from_plant,
                    errors: [errors.a, b, k],
                })
            }
        };
        Ok(Self { core, balanced: scaled, rounding: whole, staircase, targets, decaying })
    }

    /// The same for the errors from the set points.
    pub(super) fn without_targets(&self) -> Self {
        Self { targets: None, ..self.clone() }
    }

    /// Whether the inputs reach every state, so that the core is the plant itself in other units.
    pub(super) fn is_whole(&self) -> bool {
        self.staircase.reached == self.staircase.a.nrows()
    }

    /// The plant itself in balanced units, where the inputs reach every state.
    pub(super) fn whole(&self) -> Option<(&Balanced, &Core)> {
        self.is_whole().then_some((&self.balanced, &self.core))
    }

    /// The whole plant in balanced units, with the states that inputs do not reach.
    pub(super) fn plant(&self) -> Core {
        let Balanced { a, b, k, .. } = &self.balanced;
        Core { a: a.clone(), b: b.clone(), k: k.clone(), clock: self.core.clock, rounding: self.rounding.clone() }
    }

    /// A dual weight of Q in the units of the plant, in balanced ones.
    pub(super) fn dual_of_states(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let states = &self.balanced.states;
        DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] / (states[i] * states[j]))
    }

    /// A dual weight of R in the units of the plant, in balanced ones.
    pub(super) fn dual_of_inputs(&self, t: &DMatrix<f64>) -> DMatrix<f64> {
        let inputs = &self.balanced.inputs;
        DMatrix::from_fn(t.nrows(), t.ncols(), |i, j| t[(i, j)] / (inputs[i] * inputs[j]))
    }

    /// R in the units of the plant, in balanced ones.
    pub(super) fn balanced_input_weight(&self, r: &DMatrix<f64>) -> DMatrix<f64> {
        let inputs = &self.balanced.inputs;
        DMatrix::from_fn(r.nrows(), r.ncols(), |i, j| r[(i, j)] * inputs[i] * inputs[j])
    }

    /// N of a dual certificate of the whole plant in balanced units (m×n, in the units of K times those of X), in the
    /// units of the plant.
    pub(super) fn multiplier_of_plant(&self, n: &DMatrix<f64>) -> DMatrix<f64> {
        let Balanced { states, inputs, .. } = &self.balanced;
        DMatrix::from_fn(n.nrows(), n.ncols(), |i, j| n[(i, j)] * inputs[i] * states[j])
    }

    /// P or Q of the core in the units of the plant, where that is whole.
    pub(super) fn state_weight(&self, weight: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        self.is_whole().then(|| self.balanced.state_weight(weight))
    }

    /// R of the core in the units of the plant.
    pub(super) fn input_weight(&self, weight: &DMatrix<f64>) -> DMatrix<f64> {
        self.balanced.input_weight(weight)
    }

    /// N of a dual certificate of the core in the units of the plant, where that is whole.
    pub(super) fn multiplier(&self, n: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        self.is_whole().then(|| self.multiplier_of_plant(n))
    }

    /// Ω of a coupling (in products of the units of two inputs) in the units of the plant.
    pub(super) fn coupling(&self, omega: &DMatrix<f64>) -> DMatrix<f64> {
        let inputs = &self.balanced.inputs;
        DMatrix::from_fn(omega.nrows(), omega.ncols(), |i, j| omega[(i, j)] * inputs[i] * inputs[j])
    }

    /// The bounds of K's entries in the units of the plant, where that is whole.
    pub(super) fn gain_box(&self) -> Option<DMatrix<f64>> {
        let (Balanced { states, inputs, .. }, k) = (&self.balanced, &self.core.rounding.k);
        self.is_whole().then(|| DMatrix::from_fn(k.nrows(), k.ncols(), |i, j| k[(i, j)] * inputs[i] / states[j]))
    }
}

fn check_stable(core: &Core) -> Result<(), ReachError> {
    let (closed, change) = (core.closed_loop(), stability::change(&core.a, &core.b, &core.k));
    let margin = |pole: &stability::Pole| core.clock.margin(pole.value);
    let poles = stability::poles(&closed, &change)?;
    let worst = poles.iter().min_by(|x, y| (margin(x) - x.shift).total_cmp(&(margin(y) - y.shift)));
    let Some(worst) = worst.filter(|pole| margin(pole) <= pole.shift) else { return Ok(()) };
    let clearly = |pole: &stability::Pole| margin(pole) < -pole.shift.min(CLEARLY * closed.norm());
    if let Some(unstable) = poles.iter().find(|pole| clearly(pole)) {
        return Err(ReachError::Unstable(unstable.value));
    }
    if stability::is_robust(&closed, &change, core.clock) {
        return Ok(());
    }
    Err(ReachError::Marginal { pole: worst.value, shift: worst.shift })
}
