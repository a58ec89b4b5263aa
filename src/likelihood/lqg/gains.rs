//! K and L of every sample, with their derivatives.
//!
//! Without end and without noise that grows with the control they are those of [`stationary`](super::stationary). With
//! an end after N controls
//!
//! ```text
//! P_N = Q_N,  K_k = (R + BᵀP_{k+1}B)⁻¹BᵀP_{k+1}A,  P_k = Q + AᵀP_{k+1}(A − BK_k)
//! S_0 given,  L_k = S_kCᵀ(CS_kCᵀ + V_p)⁻¹,  S_{k+1} = A(S_k − L_kCS_k)Aᵀ + W_p
//! ```
//! (A L_k in the predictor's timing). Noise of the motor that grows with the control couples both (Todorov, Neural
//! Computation 17, 1084–1108, 2005, eqs. (4.2) and (5.2)): with `D(X) = C_u diag(BᵀXB) C_u` and `A_f = A − LC`,
//!
//! ```text
//! K = (R + BᵀXB + D(X + Y))⁻¹BᵀXA,  X⁻ = Q + AᵀX(A − BK),  Y⁻ = AᵀXBK + A_fᵀYA_f
//! L = ASCᵀ(CSCᵀ + V_p)⁻¹,  S⁺ = W_p + A_fSAᵀ + B C_u diag(KZKᵀ) C_u Bᵀ,  Z⁺ = LCSAᵀ + (A − BK)Z(A − BK)ᵀ
//! ```
//! for the second moment Z of the belief. They are gone through in turns until nothing moves.

use super::design::{Design, FilterStart, Horizon, Role, Timing};
use super::jet::Jet;
use super::stationary::{filter, regulator};
use nalgebra::{DMatrix, DVector};

/// Steps between two questions whether to go on.
const STEPS_BETWEEN_QUESTIONS: usize = 8;
/// Gains that a step moves by less than this share of their norm stand still.
const STILL: f64 = 1e-14;
/// For so many steps.
const STILL_STEPS: usize = 3;
/// The same of iterations that couple both gains, and their number at most.
const COUPLED: f64 = 1e-12;
const SWEEPS: usize = 300;
const ITERATIONS: usize = 20_000;

/// The gains of all samples.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Gains {
    k: Vec<Jet>,
    l: Vec<Jet>,
    /// Of every sample the places of its gains; of all later ones those of the last.
    places: Vec<[usize; 2]>,
}

impl Gains {
    /// The gains of a sample.
    pub(super) fn at(&self, sample: usize) -> [&Jet; 2] {
        let [k, l] = self.place(sample);
        [&self.k[k], &self.l[l]]
    }

    /// Which gains those of a sample are: equal ones are equal here.
    pub(super) fn place(&self, sample: usize) -> [usize; 2] {
        self.places[sample.min(self.places.len() - 1)]
    }

    /// Samples whose gains may be of their own.
    pub(super) fn len(&self) -> usize {
        self.places.len()
    }
}

/// Whether somebody asked to stop.
type IsStopped<'a> = &'a dyn Fn() -> bool;

/// What the gains are made of.
struct Parts {
    a: Jet,
    b: Jet,
    c: Jet,
    q: Jet,
    r: Jet,
    w: Jet,
    v: Jet,
    /// C_u: standard deviations of the motor's noise over the controls.
    u: Option<Jet>,
    timing: Timing,
}

/// What goes backward in time: X and Y.
struct Cost {
    x: Jet,
    y: Jet,
}

/// What goes forward in time: S and Z.
struct Belief {
    s: Jet,
    z: Jet,
}

impl Parts {
    fn zeros(&self) -> Jet {
        let order = self.a.shape().0;
        Jet::zeros(order, order, self.q.count())
    }

    /// `C_u diag(M) C_u`.
    fn grown(&self, m: &Jet) -> Option<Jet> {
        self.u.as_ref().map(|u| u.times(&m.diagonal()).times(u))
    }

    /// K of the sample before this cost.
    fn k(&self, cost: &Cost) -> Option<Jet> {
        let bx = self.b.transposed().times(&cost.x);
        let mut weight = self.r.clone().add(&bx.times(&self.b), 1.0);
        let with_error = cost.x.clone().add(&cost.y, 1.0);
        if let Some(grown) = self.grown(&self.b.transposed().times(&with_error).times(&self.b)) {
            weight = weight.add(&grown, 1.0);
        }
        Some(weight.symmetric().inverse()?.times(&bx.times(&self.a)))
    }

    fn closed(&self, k: &Jet) -> Jet {
        self.a.clone().add(&self.b.times(k), -1.0)
    }

    /// The cost a sample earlier.
    fn before(&self, cost: &Cost, [k, l]: [&Jet; 2]) -> Cost {
        let ax = self.a.transposed().times(&cost.x);
        let x = self.q.clone().add(&ax.times(&self.closed(k)), 1.0).symmetric();
        let y = if self.u.is_some() {
            let error = self.a.clone().add(&l.times(&self.c), -1.0);
            let rest = error.transposed().times(&cost.y).times(&error);
            ax.times(&self.b.times(k)).add(&rest, 1.0).symmetric()
        } else {
            cost.y.clone()
        };
        Cost { x, y }
    }

    /// L of the filter, not yet times A.
    fn update(&self, belief: &Belief) -> Option<Jet> {
        let cs = self.c.times(&belief.s);
        let innovation = self.v.clone().add(&cs.times_transposed(&self.c), 1.0).symmetric();
        Some(cs.transposed().times(&innovation.inverse()?))
    }

    /// The belief's moments a sample later.
    fn after(&self, belief: &Belief, update: &Jet, k: &Jet) -> Belief {
        let seen = update.times(&self.c.times(&belief.s));
        let left = belief.s.clone().add(&seen, -1.0);
        let mut s = self.w.clone().add(&self.a.times(&left).times_transposed(&self.a), 1.0);
        let mut z = belief.z.clone();
        if let Some(grown) = self.grown(&k.times(&belief.z).times_transposed(k)) {
            s = s.add(&self.b.times(&grown).times_transposed(&self.b), 1.0);
            let closed = self.closed(k);
            z = self.a.times(&seen).times_transposed(&self.a);
            z = z.add(&closed.times(&belief.z).times_transposed(&closed), 1.0).symmetric();
        }
        Belief { s: s.symmetric(), z }
    }

    fn timed(&self, update: Jet) -> Jet {
        if self.timing == Timing::Predictor { self.a.times(&update) } else { update }
    }
}

/// Counts steps that move nothing.
struct Still {
    share: f64,
    steps: usize,
}

impl Still {
    fn is_reached(&mut self, now: &Jet, before: &Jet) -> bool {
        self.steps = if now.is_near(before, self.share) { self.steps + 1 } else { 0 };
        self.steps >= STILL_STEPS
    }
}

/// The gains of every control up to an end, from the last to the first one gone through; fewer where they stand still.
fn backward(
    parts: &Parts,
    terminal: &Jet,
    l: &dyn Fn(usize) -> Jet,
    steps: usize,
    is_stopped: IsStopped<'_>,
) -> Option<Vec<Jet>> {
    let mut cost = Cost { x: terminal.clone(), y: parts.zeros() };
    let mut found: Vec<Jet> = Vec::new();
    let mut still = Still { share: STILL, steps: 0 };
    for at in (0..steps).rev() {
        if at % STEPS_BETWEEN_QUESTIONS == 0 && is_stopped() {
            return None;
        }
        let k = parts.k(&cost)?;
        if !k.is_finite() {
            return None;
        }
        cost = parts.before(&cost, [&k, &l(at)]);
        let is_still = parts.u.is_none() && found.last().is_some_and(|last| still.is_reached(&k, last));
        found.push(k);
        if is_still {
            break;
        }
    }
    Some(found)
}

/// The filter's gains of every sample; fewer where they stand still.
fn forward(
    parts: &Parts,
    first: Belief,
    k: &dyn Fn(usize) -> Jet,
    samples: usize,
    is_stopped: IsStopped<'_>,
) -> Option<Vec<Jet>> {
    let mut belief = first;
    let mut found: Vec<Jet> = Vec::new();
    let mut still = Still { share: STILL, steps: 0 };
    for at in 0..samples {
        if at % STEPS_BETWEEN_QUESTIONS == 0 && is_stopped() {
            return None;
        }
        let update = parts.update(&belief)?;
        if !update.is_finite() {
            return None;
        }
        belief = parts.after(&belief, &update, &k(at));
        let l = parts.timed(update);
        let is_still = parts.u.is_none() && found.last().is_some_and(|last| still.is_reached(&l, last));
        found.push(l);
        if is_still {
            break;
        }
    }
    Some(found)
}

/// Whether all gains are near those of before.
fn are_near(now: &[Jet], before: &[Jet]) -> bool {
    now.len() == before.len() && now.iter().zip(before).all(|(x, y)| x.is_near(y, COUPLED))
}

impl Design {
    /// K and L of every sample at θ, up to the end of the horizon, or the one pair of all samples where there is no
    /// end; `None` where there are none. `belief` is where the person's belief starts, zero where nothing is said.
    #[must_use]
    pub fn gains_by_sample(&self, theta: &[f64], belief: Option<&DVector<f64>>) -> Option<Vec<[DMatrix<f64>; 2]>> {
        let gains = self.gains(theta, false, belief, &|| false)?;
        Some((0..gains.len()).map(|sample| gains.at(sample).map(Jet::matrix)).collect())
    }

    /// The gains at θ, with derivatives if asked; `None` where there are none, or somebody asked to stop. `belief` is
    /// where the person's belief starts: with noise that grows with the control the filter depends on it.
    ///
    /// # Panics
    /// If θ has another length than there are free terms, which is a mistake of the caller.
    pub(super) fn gains(
        &self,
        theta: &[f64],
        slopes: bool,
        belief: Option<&DVector<f64>>,
        is_stopped: IsStopped<'_>,
    ) -> Option<Gains> {
        assert_eq!(theta.len(), self.free().count(), "parameters of an LQG person");
        let plant = self.internal();
        let parts = self.parts(theta, slopes);
        let is_grown = parts.u.is_some();
        match self.horizon {
            None if is_grown => self.coupled_without_end(theta, slopes, is_stopped),
            None => {
                let k = regulator(&plant.a, &plant.b, &parts.q, &parts.r)?;
                let l = filter(&plant.a, &plant.c, &parts.w, &parts.v, self.timing)?;
                Some(Gains { k: vec![k], l: vec![l], places: vec![[0, 0]] })
            }
            Some(horizon) if is_grown => self.coupled(theta, slopes, horizon, belief, is_stopped),
            Some(horizon) => {
                let zero = |_: usize| parts.zeros();
                let terminal = self.square(theta, Role::TerminalWeight, slopes);
                let k = backward(&parts, &terminal, &zero, horizon.steps, is_stopped)?;
                let l = if horizon.filter == FilterStart::Settled {
                    vec![filter(&plant.a, &plant.c, &parts.w, &parts.v, self.timing)?]
                } else {
                    let first = Belief { s: self.square(theta, Role::InitialCovariance, slopes), z: parts.zeros() };
                    forward(&parts, first, &zero, horizon.steps + 1, is_stopped)?
                };
                Some(timed(k, l, horizon))
            }
        }
    }

    /// The sum of a role's terms, in the person's states.
    fn square(&self, theta: &[f64], role: Role, slopes: bool) -> Jet {
        let order = self.internal().a.nrows();
        self.sum(theta, role, &DMatrix::zeros(order, order), slopes)
    }

    fn parts(&self, theta: &[f64], slopes: bool) -> Parts {
        let plant = self.internal();
        let count = if slopes { theta.len() } else { 0 };
        let [_, m, ..] = self.sizes();
        Parts {
            a: Jet::fixed(&plant.a, count),
            b: Jet::fixed(&plant.b, count),
            c: Jet::fixed(&plant.c, count),
            q: self.square(theta, Role::StateWeight, slopes),
            r: self.sum(theta, Role::ControlWeight, &self.control_weight, slopes),
            w: self.square(theta, Role::PerceivedProcessNoise, slopes),
            v: self.sum(theta, Role::PerceivedMeasurementNoise, &self.perceived_measurement_noise, slopes),
            u: self
                .has(Role::ControlDependentNoise)
                .then(|| self.sum(theta, Role::ControlDependentNoise, &DMatrix::zeros(m, m), slopes)),
            timing: self.timing,
        }
    }

    /// Values first: derivatives are gone through from where those have arrived.
    fn passes(slopes: bool) -> &'static [bool] {
        if slopes { &[false, true] } else { &[false] }
    }

    fn coupled_without_end(&self, theta: &[f64], slopes: bool, is_stopped: IsStopped<'_>) -> Option<Gains> {
        let mut cost: Option<Cost> = None;
        let mut belief: Option<Belief> = None;
        let mut found = None;
        for with_slopes in Self::passes(slopes) {
            let parts = self.parts(theta, *with_slopes);
            let count = parts.q.count();
            let lift = |jet: &Jet| Jet::fixed(&jet.matrix(), count);
            let mut c = cost.take().map_or_else(
                || Cost { x: parts.q.clone(), y: parts.zeros() },
                |c| Cost { x: lift(&c.x), y: lift(&c.y) },
            );
            let mut b = belief.take().map_or_else(
                || Belief { s: parts.w.clone(), z: parts.zeros() },
                |b| Belief { s: lift(&b.s), z: lift(&b.z) },
            );
            let mut last: Option<[Jet; 2]> = None;
            let mut still = [0.1, 0.1].map(|share| Still { share: COUPLED * share, steps: 0 });
            for iteration in 0..ITERATIONS {
                if iteration % STEPS_BETWEEN_QUESTIONS == 0 && is_stopped() {
                    return None;
                }
                let k = parts.k(&c)?;
                let update = parts.update(&b)?;
                let l = parts.timed(update.clone());
                if !(k.is_finite() && l.is_finite()) {
                    return None;
                }
                c = parts.before(&c, [&k, &l]);
                b = parts.after(&b, &update, &k);
                let is_still = last.as_ref().is_some_and(|[before_k, before_l]| {
                    let [of_k, of_l] = &mut still;
                    // Both are asked, so that both count.
                    let (k_still, l_still) = (of_k.is_reached(&k, before_k), of_l.is_reached(&l, before_l));
                    k_still && l_still
                });
                last = Some([k, l]);
                if is_still {
                    found.clone_from(&last);
                    break;
                }
                found = None;
            }
            found.as_ref()?;
            (cost, belief) = (Some(c), Some(b));
        }
        let [k, l] = found?;
        Some(Gains { k: vec![k], l: vec![l], places: vec![[0, 0]] })
    }

    /// Of a filter that starts from S_0 before the first sample.
    fn coupled(
        &self,
        theta: &[f64],
        slopes: bool,
        horizon: Horizon,
        start: Option<&DVector<f64>>,
        is_stopped: IsStopped<'_>,
    ) -> Option<Gains> {
        let order = self.internal().a.nrows();
        let start = start.cloned().unwrap_or_else(|| DVector::zeros(order));
        let moment = &start * start.transpose();
        let mut known: Option<[Vec<Jet>; 2]> = None;
        for with_slopes in Self::passes(slopes) {
            let parts = self.parts(theta, *with_slopes);
            let count = parts.q.count();
            let terminal = self.square(theta, Role::TerminalWeight, *with_slopes);
            let first = || Belief {
                s: self.square(theta, Role::InitialCovariance, *with_slopes),
                z: Jet::fixed(&moment, count),
            };
            let [_, m, p, _] = self.sizes();
            let lift = |jets: &[Jet]| jets.iter().map(|jet| Jet::fixed(&jet.matrix(), count)).collect::<Vec<_>>();
            let [mut k, mut l] = known.take().map_or_else(
                || {
                    let none =
                        |rows: usize, columns: usize, times: usize| vec![Jet::zeros(rows, columns, count); times];
                    [none(m, order, horizon.steps), none(order, p, horizon.steps + 1)]
                },
                |[k, l]| [lift(&k), lift(&l)],
            );
            let mut has_arrived = false;
            for _ in 0..SWEEPS {
                let mut next_k = backward(&parts, &terminal, &|at| l[at].clone(), horizon.steps, is_stopped)?;
                next_k.reverse();
                let last = next_k.len() - 1;
                let control = |at: usize| next_k[at.min(last)].clone();
                let next_l = forward(&parts, first(), &control, horizon.steps + 1, is_stopped)?;
                has_arrived = are_near(&next_k, &k) && are_near(&next_l, &l);
                (k, l) = (next_k, next_l);
                if has_arrived {
                    break;
                }
            }
            if !has_arrived {
                return None;
            }
            known = Some([k, l]);
        }
        let [k, l] = known?;
        let places = (0..=horizon.steps).map(|at| [at.min(k.len() - 1), at]).collect();
        Some(Gains { k, l, places })
    }
}

/// Gains by sample, of controls from the last one on and of the filter from the first one on; what stands still is
/// written once.
fn timed(backward: Vec<Jet>, l: Vec<Jet>, Horizon { steps, filter }: Horizon) -> Gains {
    let repeated = usize::from(filter == FilterStart::BeforeSecond);
    // The last sample's control moves nothing that is recorded.
    let place = |at: usize| {
        let to_end = steps - 1 - at.min(steps - 1);
        [to_end.min(backward.len() - 1), at.saturating_sub(repeated).min(l.len() - 1)]
    };
    let places = (0..=steps).map(place).collect();
    Gains { k: backward, l, places }
}
