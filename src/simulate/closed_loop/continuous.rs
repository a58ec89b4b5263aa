//! The loop in continuous time.
//!
//! Command, disturbance and noise go straight from sample to sample. Without a delay around the loop its states are
//! propagated exactly, by the matrix exponential of the whole loop. With one, what comes back is the output of a time
//! ago: the open chain from controllers to plant is propagated exactly between steps, the delayed output taken as
//! straight between them, with an error of the square of the step. Steps divide the sample time such that delays are
//! whole steps, where that takes no more than [`MOST_ALIGNED`] of them.
//!
//! A controller with more zeros than poles is its polynomial part, which goes through the plant (`N P/D`, proper), and
//! a proper rest; its control has no samples.

use super::closed::{ClosedLoop, Delays};
use super::simulator::{Drive, Simulated, SimulatorError, sample};
use crate::control::conversion;
use crate::control::discretise::Propagation;
use crate::control::simulate::SimulationError;
use crate::control::{self, Discrete, StateSpace, System, TransferFunction};
use crate::ctl::Ctl;
use crate::num::Polynomial;
use nalgebra::{DMatrix, DVector};

/// Steps within a sample at most to make delays whole steps.
const MOST_ALIGNED: usize = 64;

/// Steps within a sample where that does not do.
const UNALIGNED: usize = 8;

/// A delay this near to whole steps is taken for them, in steps.
const WHOLE: f64 = 1e-7;

/// Steps between two looks at whether to go on.
const CHECKED: usize = 4096;

/// Inputs of the chain: the feedforward's command, what the feedback sees, what is added at the plant.
const INPUTS: usize = 3;

/// A delay of signals that are sampled, in steps.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Shift {
    steps: f64,
    /// Where it is whole.
    whole: Option<i64>,
}

impl Shift {
    fn new(delay_s: f64, step_s: f64) -> Self {
        let steps = delay_s / step_s;
        let rounded = steps.round();
        let is_whole = (steps - rounded).abs() <= WHOLE * steps.abs().max(1.0);
        Self { steps, whole: is_whole.then_some(rounded as i64) }
    }

    /// The values just before and just after step `k` of a signal that is zero before its start and has a sample every
    /// `every` steps.
    fn around(self, signal: &[f64], k: usize, every: usize) -> [f64; 2] {
        if signal.is_empty() {
            return [0.0; 2];
        }
        match self.whole {
            Some(whole) => {
                let position = k as i64 - whole;
                let Ok(position) = usize::try_from(position) else { return [0.0; 2] };
                let (i, part) = (position / every, position % every);
                let value = between(signal, i, part as f64 / every as f64);
                [if position == 0 { 0.0 } else { value }, value]
            }
            None => {
                let position = (k as f64 - self.steps) / every as f64;
                if position < 0.0 {
                    return [0.0; 2];
                }
                [between(signal, position.floor() as usize, position.fract()); 2]
            }
        }
    }
}

fn between(signal: &[f64], i: usize, part: f64) -> f64 {
    let before = sample(signal, i);
    if part == 0.0 { before } else { before + part * (sample(signal, i + 1) - before) }
}

/// The chain from controllers to plant, or the loop that it makes, between two steps.
pub(super) struct Continuous {
    steps: usize,
    transition: DMatrix<f64>,
    held: DMatrix<f64>,
    slope: DMatrix<f64>,
    /// Rows: output, control.
    c: DMatrix<f64>,
    d: DMatrix<f64>,
    /// From the output and its derivatives at the start to the states.
    initial: DMatrix<f64>,
    command: Shift,
    plant: Shift,
    /// Around the loop; `None` where the loop is closed within the states.
    around: Option<Shift>,
    is_exact: bool,
    has_control: bool,
}

/// The proper part of a controller, and the polynomial without constant that is left.
fn split(system: &TransferFunction<control::Continuous>) -> Option<(StateSpace<control::Continuous>, Polynomial)> {
    let (quotient, rest) = system.num().divided_by(system.den());
    let constant = *quotient.coefficients().last()?;
    let mut polynomial = quotient.coefficients().to_vec();
    if let Some(last) = polynomial.last_mut() {
        *last = 0.0;
    }
    let num = rest.add(&system.den().scale(constant));
    let proper = TransferFunction::new(num.coefficients(), system.den().coefficients(), control::Continuous).ok()?;
    Some((conversion::to_state_space(&proper).ok()?, Polynomial::new(polynomial)))
}

/// A plant with several inputs in observer form: `y = x₁ + Σ bⱼ₀ uⱼ`, `xᵢ' = xᵢ₊₁ − aᵢ y + Σ bⱼᵢ uⱼ`.
struct ObserverForm {
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    d: [f64; INPUTS],
    /// From `y, y', y'', …` without input to the states: `xᵢ = Σⱼ aᵢ₋₁₋ⱼ y⁽ʲ⁾`.
    initial: DMatrix<f64>,
}

impl ObserverForm {
    fn new(den: &Polynomial, nums: &[Polynomial; INPUTS]) -> Option<Self> {
        let n = den.degree();
        let a: Vec<f64> = den.coefficients().iter().map(|c| c / den.leading()).collect();
        let mut padded = Vec::with_capacity(INPUTS);
        for num in nums {
            let missing = (n + 1).checked_sub(num.coefficients().len())?;
            let mut b = vec![0.0; missing];
            b.extend(num.coefficients().iter().map(|c| c / den.leading()));
            padded.push(b);
        }
        Some(Self {
            a: DMatrix::from_fn(n, n, |i, j| if j == 0 { -a[i + 1] } else { 0.0 } + f64::from(u8::from(j == i + 1))),
            b: DMatrix::from_fn(n, INPUTS, |i, j| padded[j][i + 1] - a[i + 1] * padded[j][0]),
            d: [padded[0][0], padded[1][0], padded[2][0]],
            initial: DMatrix::from_fn(n, n, |i, j| if j <= i { a[i - j] } else { 0.0 }),
        })
    }
}

/// Samples of the output of a plant without input, `count` of them from the start on, where the output and its first
/// derivatives are `derivatives` (further ones zero) at the start; `None` where they overflow.
#[must_use]
pub fn free_motion(
    plant: &TransferFunction<control::Continuous>,
    derivatives: &[f64],
    time: Discrete,
    count: usize,
) -> Option<Vec<f64>> {
    let nothing = Polynomial::new(vec![0.0]);
    let ObserverForm { a, b, initial, .. } =
        ObserverForm::new(plant.den(), &[nothing.clone(), nothing.clone(), nothing])?;
    let states = a.nrows();
    let c = DMatrix::from_fn(1, states, |_, j| f64::from(u8::from(j == 0)));
    let model = StateSpace::new(a, b, c, DMatrix::zeros(1, INPUTS), control::Continuous).ok()?;
    let (model, scales) = model.balancing();
    let Propagation { transition, .. } = Propagation::new(&model, time)?;
    let given = DVector::from_fn(states, |j, _| derivatives.get(j).copied().unwrap_or(0.0));
    let mut state = initial * given;
    state.iter_mut().zip(&scales).for_each(|(x, scale)| *x /= scale);
    let motion: Vec<f64> = (0..count)
        .map(|_| {
            let y = (model.c() * &state).iter().sum();
            state = &transition * &state;
            y
        })
        .collect();
    motion.iter().all(|y: &f64| y.is_finite()).then_some(motion)
}

impl Continuous {
    /// The least steps within a sample that make delays whole steps, or that resolve them; `None` where a delay is too
    /// short for either.
    pub(super) fn least_steps(delays: Delays, period_s: f64) -> Option<usize> {
        let all = [delays.around_s(), delays.plant_s, delays.feedforward_s - delays.preview_s];
        let aligned = (1..=MOST_ALIGNED)
            .find(|steps| all.iter().all(|delay| Shift::new(*delay, period_s / *steps as f64).whole.is_some()));
        let resolves = |steps: &usize| delays.around_s() == 0.0 || delays.around_s() >= period_s / *steps as f64;
        aligned.filter(resolves).or_else(|| (UNALIGNED..=8 * UNALIGNED).find(resolves))
    }

    pub(super) fn new(closed: &ClosedLoop, time: Discrete, steps: usize) -> Result<Self, SimulatorError> {
        let overflow = || SimulationError::Overflow { sample: 0 };
        let (System::Continuous(plant), System::Continuous(feedforward), System::Continuous(feedback)) =
            (&closed.plant, &closed.feedforward, &closed.feedback)
        else {
            return Err(overflow().into());
        };
        let step_s = time.period_s() / steps as f64;
        let delays = closed.delays;
        let (ff, ff_polynomial) = split(feedforward).ok_or_else(overflow)?;
        let (fb, fb_polynomial) = split(feedback).ok_or_else(overflow)?;
        let nums = [plant.num().mul(&ff_polynomial), plant.num().mul(&fb_polynomial), plant.num().clone()];
        let plant = ObserverForm::new(plant.den(), &nums).ok_or_else(overflow)?;
        let is_delayed = delays.around_s() > 0.0;
        let (model, scales) = chain(&plant, &ff, &fb, !is_delayed).ok_or_else(overflow)?.balancing();
        let step = Discrete::new(step_s).map_err(SimulationError::from)?;
        let Propagation { transition, held, slope } = Propagation::new(&model, step).ok_or_else(overflow)?;
        let states = plant.initial.nrows();
        let initial =
            DMatrix::from_fn(
                model.states(),
                states,
                |i, j| {
                    if i < states { plant.initial[(i, j)] / scales[i] } else { 0.0 }
                },
            );
        let command = Shift::new(delays.plant_s + delays.feedforward_s - delays.preview_s, step_s);
        Ok(Self {
            steps,
            transition,
            held,
            slope,
            c: model.c().clone(),
            d: model.d().clone(),
            initial,
            command,
            plant: Shift::new(delays.plant_s, step_s),
            around: is_delayed.then(|| Shift::new(delays.around_s(), step_s)),
            is_exact: !is_delayed && command.whole.is_some(),
            has_control: closed.has_control(),
        })
    }

    /// Steps within a sample.
    pub(super) fn steps(&self) -> usize {
        self.steps
    }

    /// Whether steps do not matter.
    pub(super) fn is_exact(&self) -> bool {
        self.is_exact
    }

    /// Runs the loop for `samples` samples. Time is that of the plant's input behind its delay; the control is read as
    /// much later.
    pub(super) fn run(&self, drive: &Drive, samples: usize, ctl: &Ctl) -> Result<Simulated, SimulatorError> {
        let every = self.steps;
        let ahead = self.plant.steps.ceil() as usize;
        let last = (samples - 1) * every + ahead;
        let states = self.transition.nrows();
        let mut state = DVector::zeros(states);
        for (j, y) in drive.initial.iter().enumerate().take(self.initial.ncols()) {
            state.axpy(*y, &self.initial.column(j), 1.0);
        }
        let mut next = state.clone();
        let (mut output, mut control) = (Vec::with_capacity(last + 1), Vec::with_capacity(last + 1));
        // What the loop sees of the command: as late as its output.
        let seen = self.around.unwrap_or(Shift { steps: 0.0, whole: Some(0) });
        let outside = |k: usize| -> [[f64; 2]; INPUTS] {
            let both = |a: [f64; 2], b: [f64; 2], sign: f64| [a[0] + sign * b[0], a[1] + sign * b[1]];
            let forward = self.command.around(drive.command, k, every);
            let error = both(seen.around(drive.command, k, every), seen.around(drive.perception, k, every), -1.0);
            let (w, d) = (self.plant.around(drive.remnant, k, every), self.plant.around(drive.disturbance, k, every));
            [forward, error, both(w, d, 1.0)]
        };
        let mut now = outside(0);
        for k in 0..=last {
            if k % CHECKED == 0 {
                ctl.check()?;
            }
            // Of the output of a time ago only what is known already: the delay is a step at least.
            let fed_back = |k: usize, output: &[f64]| self.around.map_or([0.0; 2], |shift| shift.around(output, k, 1));
            let back = fed_back(k, &output);
            let start = [now[0][1], now[1][1] - back[1], now[2][1]];
            let y = self.row(0, &state, &start);
            let u = self.row(1, &state, &start);
            if !(y.is_finite() && u.is_finite()) {
                return Err(SimulationError::Overflow { sample: k / every }.into());
            }
            output.push(y);
            control.push(u);
            if k == last {
                break;
            }
            now = outside(k + 1);
            let back = fed_back(k + 1, &output);
            let end = [now[0][0], now[1][0] - back[0], now[2][0]];
            next.gemv(1.0, &self.transition, &state, 0.0);
            for (j, (before, after)) in start.iter().zip(&end).enumerate() {
                next.axpy(*before, &self.held.column(j), 1.0);
                next.axpy(after - before, &self.slope.column(j), 1.0);
            }
            std::mem::swap(&mut state, &mut next);
        }
        let later = Shift { steps: -self.plant.steps, whole: self.plant.whole.map(|whole| -whole) };
        let control = (0..samples).map(|k| later.around(&control, k * every, 1)[1] + sample(drive.remnant, k));
        Ok(Simulated {
            control: self.has_control.then(|| control.collect()),
            output: (0..samples).map(|k| output[k * every]).collect(),
        })
    }

    fn row(&self, row: usize, state: &DVector<f64>, inputs: &[f64; INPUTS]) -> f64 {
        let direct: f64 = (0..INPUTS).map(|j| self.d[(row, j)] * inputs[j]).sum();
        self.c.row(row).tr_dot(state) + direct
    }
}

/// The chain `y = G (Gff r + Gfb e + v)` with the outputs y and `Gff r + Gfb e` in the states of plant, feedback and
/// feedforward; or, closed, with `e = input − y` put in.
fn chain(
    plant: &ObserverForm,
    ff: &StateSpace<control::Continuous>,
    fb: &StateSpace<control::Continuous>,
    is_closed: bool,
) -> Option<StateSpace<control::Continuous>> {
    let (p, b, f) = (plant.a.nrows(), fb.states(), ff.states());
    let n = p + b + f;
    let (dff, dfb) = (ff.d()[(0, 0)], fb.d()[(0, 0)]);
    let mut a = DMatrix::zeros(n, n);
    let mut input = DMatrix::zeros(n, INPUTS);
    let (mut c, mut d) = (DMatrix::zeros(2, n), DMatrix::zeros(2, INPUTS));
    // The control in terms of states and inputs.
    c.view_mut((1, p), (1, b)).copy_from(fb.c());
    c.view_mut((1, p + b), (1, f)).copy_from(ff.c());
    (d[(1, 0)], d[(1, 1)]) = (dff, dfb);
    // The control and v reach the plant by its third input.
    let direct = plant.b.column(2).into_owned();
    a.view_mut((0, 0), (p, p)).copy_from(&plant.a);
    a.view_mut((p, p), (b, b)).copy_from(fb.a());
    a.view_mut((p + b, p + b), (f, f)).copy_from(ff.a());
    for j in p..n {
        for i in 0..p {
            a[(i, j)] = direct[i] * c[(1, j)];
        }
        c[(0, j)] = plant.d[2] * c[(1, j)];
    }
    if p > 0 {
        c[(0, 0)] = 1.0;
    }
    for j in 0..INPUTS {
        let through = if j == 2 { 1.0 } else { d[(1, j)] };
        let own = if j == 2 { 0.0 } else { 1.0 };
        for i in 0..p {
            input[(i, j)] = own * plant.b[(i, j)] + direct[i] * through;
        }
        d[(0, j)] = own * plant.d[j] + plant.d[2] * through;
    }
    input.view_mut((p, 1), (b, 1)).copy_from(fb.b());
    input.view_mut((p + b, 0), (f, 1)).copy_from(ff.b());
    if is_closed {
        // e = input − y, y = C x + D₁ e + …, so that y (1 + D₁) = C x + D₁ input + ….
        let ratio = 1.0 / (1.0 + d[(0, 1)]);
        if !ratio.is_finite() {
            return None;
        }
        let (c_y, d_y) = (c.rows(0, 1).into_owned() * ratio, d.rows(0, 1).into_owned() * ratio);
        let (d_u, e_column) = (d[(1, 1)], input.columns(1, 1).into_owned());
        a -= &e_column * &c_y;
        input -= &e_column * &d_y;
        let (c_u, d_u) = (c.rows(1, 1) - &c_y * d_u, d.rows(1, 1) - &d_y * d_u);
        c.rows_mut(1, 1).copy_from(&c_u);
        d.rows_mut(1, 1).copy_from(&d_u);
        c.rows_mut(0, 1).copy_from(&c_y);
        d.rows_mut(0, 1).copy_from(&d_y);
    }
    StateSpace::new(a, input, c, d, control::Continuous).ok()
}
