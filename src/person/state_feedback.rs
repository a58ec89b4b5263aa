//! A plant under a person: state feedback through a sensory delay and a muscle, as a function of parameters.
//!
//! ```text
//! ẋ = A x + B u + E w,   y = C x + D u + F w,   u = M(s) P(s) (−K x)
//! ```
//! P is the Padé approximation of `e^{−τs}` and M the lag `1/(T s + 1)`, one of each for every control; either may be
//! missing (Priess 2015, figure 5.5 and appendix B, whose print leaves the lag out).

use crate::control::pade::pade;
use crate::control::parametric::{Matrices, ParametricModel};
use crate::control::time_base::TimeBase;
use crate::num::dual::Real;
use nalgebra::DMatrix;

/// A plant with its two kinds of inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant<S: Real> {
    /// A, n×n.
    pub a: DMatrix<S>,
    /// B, n×m: what the person does.
    pub b: DMatrix<S>,
    /// E, n×q: what the experimenter does.
    pub e: DMatrix<S>,
    /// C, p×n.
    pub c: DMatrix<S>,
    /// D, p×m.
    pub d: DMatrix<S>,
    /// F, p×q.
    pub f: DMatrix<S>,
    /// x₀, n.
    pub initial: Vec<S>,
}

/// What lies between the person's intention and the control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Path<S> {
    /// Order of the Padé approximation and the delay τ in seconds, above 0.
    pub delay: Option<(usize, S)>,
    /// Time constant T of the lag in seconds, above 0.
    pub lag: Option<S>,
}

impl<S> Path<S> {
    /// Neither delay nor lag.
    #[must_use]
    pub fn direct() -> Self {
        Self { delay: None, lag: None }
    }
}

/// The loop from w to y. The states are those of the plant, then for every control those of its delay and of its lag;
/// these start at rest.
#[must_use]
pub fn close<S: Real>(plant: &Plant<S>, k: &DMatrix<S>, path: &Path<S>) -> Matrices<S> {
    let (n, m, q, p) = (plant.a.nrows(), plant.b.ncols(), plant.e.ncols(), plant.c.nrows());
    let delay_states = path.delay.map_or(0, |(order, _)| order);
    let lag_states = usize::from(path.lag.is_some());
    let each = delay_states + lag_states;
    let states = n + m * each;
    let zero = S::from(0.0);
    let mut closed = Matrices::zeros(states, q, p);
    closed.a.view_mut((0, 0), (n, n)).copy_from(&plant.a);
    closed.b.view_mut((0, 0), (n, q)).copy_from(&plant.e);
    closed.c.view_mut((0, 0), (p, n)).copy_from(&plant.c);
    closed.d.copy_from(&plant.f);
    for (i, x) in plant.initial.iter().enumerate() {
        closed.initial[i] = *x;
    }
    for control in 0..m {
        let first = n + control * each;
        // The signal on its way from −Kx to u, as a row over the states.
        let mut row: Vec<S> = (0..states).map(|j| if j < n { -k[(control, j)] } else { zero }).collect();
        if let Some((order, tau)) = path.delay {
            let (a, b, c, d) = pade(order);
            let mut behind: Vec<S> = row.iter().map(|v| *v * S::from(d)).collect();
            for i in 0..order {
                for (j, v) in row.iter().enumerate().take(n) {
                    closed.a[(first + i, j)] = *v * S::from(b[i]) / tau;
                }
                for j in 0..order {
                    closed.a[(first + i, first + j)] = S::from(a[(i, j)]) / tau;
                }
                behind[first + i] = S::from(c[i]);
            }
            row = behind;
        }
        if let Some(lag) = path.lag {
            let muscle = first + delay_states;
            for (j, v) in row.iter().enumerate() {
                closed.a[(muscle, j)] = *v / lag;
            }
            closed.a[(muscle, muscle)] = closed.a[(muscle, muscle)] - S::from(1.0) / lag;
            row = vec![zero; states];
            row[muscle] = S::from(1.0);
        }
        for (j, v) in row.iter().enumerate() {
            for i in 0..n {
                closed.a[(i, j)] = closed.a[(i, j)] + plant.b[(i, control)] * *v;
            }
            for i in 0..p {
                closed.c[(i, j)] = closed.c[(i, j)] + plant.d[(i, control)] * *v;
            }
        }
    }
    closed
}

/// A plant whose matrices depend on named parameters.
pub trait PlantModel: Sync {
    /// The names of the parameters.
    fn names(&self) -> Vec<String>;

    /// For each parameter the least and the largest value for which the plant is defined.
    fn limits(&self) -> Vec<[f64; 2]>;

    /// For each parameter the value that is assumed where nothing is known.
    fn nominal(&self) -> Vec<f64>;

    /// The plant at these parameters.
    fn plant<S: Real>(&self, theta: &[S]) -> Plant<S>;

    /// n, m, q and p: states, controls, inputs of the experimenter, outputs.
    fn sizes(&self) -> [usize; 4] {
        let plant = self.plant::<f64>(&self.nominal());
        [plant.a.nrows(), plant.b.ncols(), plant.e.ncols(), plant.c.nrows()]
    }
}

/// A plant that is affine in its parameters: `A(θ) = A₀ + Σ θᵢ Aᵢ`, and so on for the other matrices.
#[derive(Debug, Clone, PartialEq)]
pub struct AffinePlant {
    /// The plant at θ = 0.
    pub base: Plant<f64>,
    /// What every parameter adds.
    pub terms: Vec<Term>,
}

/// A parameter of an [`AffinePlant`]: its matrices have the sizes of the plant's.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// The name of the parameter.
    pub name: String,
    /// The value that is assumed where nothing is known.
    pub nominal: f64,
    /// Its slope of A, B, E, C, D and F; the initial state does not depend on it.
    pub slope: Plant<f64>,
}

impl PlantModel for AffinePlant {
    fn names(&self) -> Vec<String> {
        self.terms.iter().map(|term| term.name.clone()).collect()
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        vec![[f64::NEG_INFINITY, f64::INFINITY]; self.terms.len()]
    }

    fn nominal(&self) -> Vec<f64> {
        self.terms.iter().map(|term| term.nominal).collect()
    }

    fn plant<S: Real>(&self, theta: &[S]) -> Plant<S> {
        let sum = |part: fn(&Plant<f64>) -> &DMatrix<f64>| {
            let mut total = part(&self.base).map(S::from);
            for (term, value) in self.terms.iter().zip(theta) {
                for (entry, slope) in total.iter_mut().zip(part(&term.slope)) {
                    if *slope != 0.0 {
                        *entry = *entry + *value * S::from(*slope);
                    }
                }
            }
            total
        };
        Plant {
            a: sum(|p| &p.a),
            b: sum(|p| &p.b),
            e: sum(|p| &p.e),
            c: sum(|p| &p.c),
            d: sum(|p| &p.d),
            f: sum(|p| &p.f),
            initial: self.base.initial.iter().map(|v| S::from(*v)).collect(),
        }
    }
}

/// A time constant or delay of the person, in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Timing {
    /// It is known.
    Known(f64),
    /// It is a parameter, assumed to be this where nothing is known.
    Free(f64),
}

/// The loop of a plant and a person with unknown gains; θ holds K row by row, the parameters of the plant, and `tau`
/// and `t_w` where free.
#[derive(Debug, Clone, PartialEq)]
pub struct StateFeedback<P, T> {
    /// The plant.
    pub plant: P,
    /// The time base of plant and loop.
    pub time: T,
    /// Order of the Padé approximation and delay.
    pub delay: Option<(usize, Timing)>,
    /// Lag of the muscle.
    pub lag: Option<Timing>,
}

/// Delays and lags for which the approximations are defined, s.
const TIMING_LIMITS: [f64; 2] = [1e-6, 1e3];

impl<P: PlantModel, T: TimeBase> StateFeedback<P, T> {
    /// The values that are assumed where nothing is known; 0 for the gains.
    #[must_use]
    pub fn nominal(&self) -> Vec<f64> {
        let [n, m, ..] = self.plant.sizes();
        let mut nominal = vec![0.0; n * m];
        nominal.extend(self.plant.nominal());
        nominal.extend(self.timings().into_iter().filter_map(|(_, timing)| match timing {
            Timing::Known(_) => None,
            Timing::Free(value) => Some(value),
        }));
        nominal
    }

    fn timings(&self) -> Vec<(&'static str, Timing)> {
        let delay = self.delay.map(|(_, timing)| ("tau", timing));
        delay.into_iter().chain(self.lag.map(|timing| ("t_w", timing))).collect()
    }
}

/// The names of the entries of a gain, row by row: `k1`, `k2` for a single row, `k1_2` for row 1, column 2 otherwise.
#[must_use]
pub fn gain_names(rows: usize, columns: usize) -> Vec<String> {
    let name = |i: usize, j: usize| if rows == 1 { format!("k{}", j + 1) } else { format!("k{}_{}", i + 1, j + 1) };
    (0..rows).flat_map(|i| (0..columns).map(move |j| name(i, j))).collect()
}

impl<P: PlantModel, T: TimeBase> ParametricModel for StateFeedback<P, T> {
    type Time = T;

    fn time(&self) -> T {
        self.time
    }

    fn names(&self) -> Vec<String> {
        let [n, m, ..] = self.plant.sizes();
        let mut names = gain_names(m, n);
        names.extend(self.plant.names());
        let free = |timing: &(&'static str, Timing)| matches!(timing.1, Timing::Free(_));
        names.extend(self.timings().into_iter().filter(free).map(|(name, _)| name.to_owned()));
        names
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        let [n, m, ..] = self.plant.sizes();
        let mut limits = vec![[f64::NEG_INFINITY, f64::INFINITY]; n * m];
        limits.extend(self.plant.limits());
        let free = self.timings().into_iter().filter(|(_, timing)| matches!(timing, Timing::Free(_))).count();
        limits.extend(vec![TIMING_LIMITS; free]);
        limits
    }

    fn matrices<S: Real>(&self, theta: &[S]) -> Matrices<S> {
        let [n, m, ..] = self.plant.sizes();
        let gains = n * m;
        let plants = self.plant.names().len();
        let plant = self.plant.plant(&theta[gains..gains + plants]);
        let mut rest = theta[gains + plants..].iter().copied();
        let mut value = |timing: Timing| match timing {
            Timing::Known(value) => S::from(value),
            // As many values follow as there are free timings.
            Timing::Free(nominal) => rest.next().unwrap_or_else(|| S::from(nominal)),
        };
        let delay = self.delay.map(|(order, timing)| (order, value(timing)));
        let lag = self.lag.map(&mut value);
        let k = DMatrix::from_fn(m, n, |i, j| theta[i * n + j]);
        close(&plant, &k, &Path { delay, lag })
    }
}
