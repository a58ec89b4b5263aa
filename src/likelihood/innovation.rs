//! K and L together, from what the person's own filter would predict.
//!
//! A person who controls `x⁺ = Ax + Bu + Ew + noise`, `y = Cx + Du + Fw + noise` by a steady-state filter and its
//! estimate,
//!
//! ```text
//! x̂⁺ = A x̂ + B u + E w + L ε,   u = −K x̂,   y = C x̂ + D u + F w + ε,
//! ```
//! makes ε, the innovation, white where L is the filter of the true noise and w is known to the person. Solved for ε
//! the same equations predict y from its own past,
//!
//! ```text
//! x̂⁺ = (A − BK − LC + LDK) x̂ + (E − LF) w + L y,   ŷ = (C − DK) x̂ + F w
//! ```
//! and K and L are found as parameters of this predictor, whose input y is. It must be stable. Where the control is
//! recorded too, its own past takes the place of −Kx̂ in the filter, `x̂⁺ = (A − LC) x̂ + (B − LD) u + (E − LF) w + L
//! y`, and `û = −K x̂` is predicted beside y: this separates K from L, which the output alone may not (Priess 2015,
//! §6.3).
//!
//! The control alone may be predicted so as well. That asks nothing of ε: it holds whatever noise the person expects
//! and whatever moves the plant, since the person's filter is driven by what was recorded. Without being told w the
//! person's filter is the same with E = 0 and F = 0.

use super::model::{LoopModel, put};
use super::starts;
use crate::control::lyapunov::Clock;
use crate::control::parametric::{Differentiated, Matrices, ParametricModel, Realisation, Slope};
use crate::control::{Continuous, Discrete, StateSpace};
use crate::num::dual::{Dual, Real};
use crate::num::rng::Stream;
use crate::person::state_feedback::{PlantModel, gain_names};
use nalgebra::{DMatrix, DVector};

/// The predictor of a person's outputs; θ holds K row by row, L row by row, and the parameters of the plant.
#[derive(Debug, Clone, PartialEq)]
pub struct Innovation<P> {
    /// The plant.
    pub plant: P,
    /// Whether the plant is in continuous time; its controls and inputs are then held between samples.
    pub continuous: bool,
    /// What is predicted.
    pub predicted: Predicted,
    /// Whether the person knows the plant's input w.
    pub is_told: bool,
}

/// What a person's filter predicts, from the past of all that it names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Predicted {
    /// The outputs, from the outputs.
    Output,
    /// The outputs and the control, from both.
    OutputAndControl,
    /// The control, from both.
    Control,
}

/// The plant alone, of inputs `[u, w]`.
struct Open<'a, P> {
    plant: &'a P,
}

impl<P: PlantModel> ParametricModel for Open<'_, P> {
    type Time = Continuous;

    fn time(&self) -> Continuous {
        Continuous
    }

    fn names(&self) -> Vec<String> {
        self.plant.names()
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        self.plant.limits()
    }

    fn matrices<S: Real>(&self, theta: &[S]) -> Matrices<S> {
        let plant = self.plant.plant(theta);
        Matrices {
            b: beside(&plant.b, &plant.e),
            d: beside(&plant.d, &plant.f),
            a: plant.a,
            c: plant.c,
            initial: DVector::from_vec(plant.initial),
        }
    }
}

fn beside<S: Real>(left: &DMatrix<S>, right: &DMatrix<S>) -> DMatrix<S> {
    let columns = left.ncols();
    DMatrix::from_fn(left.nrows(), columns + right.ncols(), |i, j| {
        if j < columns { left[(i, j)] } else { right[(i, j - columns)] }
    })
}

/// `x + sign · l r`.
fn plus<S: Real>(x: DMatrix<S>, sign: f64, l: &DMatrix<S>, r: &DMatrix<S>) -> DMatrix<S> {
    DMatrix::from_fn(x.nrows(), x.ncols(), |i, j| {
        let sum = (0..l.ncols()).fold(S::from(0.0), |sum, k| sum + l[(i, k)] * r[(k, j)]);
        x[(i, j)] + S::from(sign) * sum
    })
}

impl<P: PlantModel> Innovation<P> {
    fn gains(&self) -> (usize, usize) {
        let [n, m, _, p] = self.plant.sizes();
        (m * n, n * p)
    }

    /// The sampled plant, `[B E]` in the place of B.
    fn open(&self, theta: &[f64], time: Discrete, slopes: bool) -> Option<Differentiated<Discrete>> {
        let open = Open { plant: &self.plant };
        let found = if slopes {
            open.differentiate(theta).ok()?
        } else {
            Differentiated { value: open.realise(theta).ok()?, slopes: Vec::new() }
        };
        if self.continuous {
            return found.sampled(time).ok();
        }
        let model = &found.value.model;
        let copy = [model.a(), model.b(), model.c(), model.d()].map(Clone::clone);
        let [a, b, c, d] = copy;
        let model = StateSpace::new(a, b, c, d, time).ok()?;
        Some(Differentiated { value: Realisation { model, initial: found.value.initial }, slopes: found.slopes })
    }

    /// The predictor of the sampled plant (a, [b e], c, [d f]) with the gains K and L.
    fn predictor<S: Real>(&self, open: &Matrices<S>, k: &DMatrix<S>, l: &DMatrix<S>) -> Matrices<S> {
        let [n, m, q, p] = self.plant.sizes();
        let b = open.b.columns(0, m).into_owned();
        let e = open.b.columns(m, q).into_owned();
        let d = open.d.columns(0, m).into_owned();
        let f = open.d.columns(m, q).into_owned();
        // A − LC, B − LD, E − LF.
        let a = plus(open.a.clone(), -1.0, l, &open.c);
        let b = plus(b, -1.0, l, &d);
        let zero = |rows, columns| DMatrix::from_element(rows, columns, S::from(0.0));
        let (e, f) = if self.is_told { (plus(e, -1.0, l, &f), f) } else { (zero(n, q), zero(p, q)) };
        if self.predicted != Predicted::Output {
            // Outputs and inputs [w, y, u].
            let outputs = if self.predicted == Predicted::Control { 0 } else { p };
            let mut c = zero(outputs + m, n);
            let mut through = zero(outputs + m, q + p + m);
            if outputs > 0 {
                c.rows_mut(0, p).copy_from(&open.c);
                through.view_mut((0, 0), (p, q)).copy_from(&f);
                through.view_mut((0, q + p), (p, m)).copy_from(&d);
            }
            for i in 0..m {
                for j in 0..n {
                    c[(outputs + i, j)] = -k[(i, j)];
                }
            }
            let b = beside(&beside(&e, l), &b);
            return Matrices { a, b, c, d: through, initial: open.initial.clone() };
        }
        let a = plus(a, -1.0, &b, k);
        let c = plus(open.c.clone(), -1.0, &d, k);
        Matrices { a, b: beside(&e, l), c, d: beside(&f, &zero(p, p)), initial: open.initial.clone() }
    }
}

/// Values and one slope as dual numbers.
fn dual(value: &DMatrix<f64>, slope: Option<&DMatrix<f64>>) -> DMatrix<Dual> {
    DMatrix::from_fn(value.nrows(), value.ncols(), |i, j| Dual {
        value: value[(i, j)],
        slope: slope.map_or(0.0, |s| s[(i, j)]),
    })
}

fn slope_of(m: &DMatrix<Dual>) -> DMatrix<f64> {
    m.map(|v| v.slope)
}

impl<P: PlantModel> LoopModel for Innovation<P> {
    fn names(&self) -> Vec<String> {
        let [n, m, _, p] = self.plant.sizes();
        let mut names = gain_names(m, n);
        names.extend((0..n).flat_map(|i| (0..p).map(move |j| format!("l{}_{}", i + 1, j + 1))));
        names.extend(self.plant.names());
        names
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        let (k, l) = self.gains();
        let mut limits = vec![[f64::NEG_INFINITY, f64::INFINITY]; k + l];
        limits.extend(self.plant.limits());
        limits
    }

    fn sampled(&self, theta: &[f64], time: Discrete, slopes: bool) -> Option<Differentiated<Discrete>> {
        let [n, m, _, p] = self.plant.sizes();
        let (gains, filters) = self.gains();
        let open = self.open(theta.get(gains + filters..)?, time, slopes)?;
        let model = &open.value.model;
        let k = DMatrix::from_row_slice(m, n, &theta[..gains]);
        let l = DMatrix::from_row_slice(n, p, &theta[gains..gains + filters]);
        let plain = Matrices {
            a: model.a().clone(),
            b: model.b().clone(),
            c: model.c().clone(),
            d: model.d().clone(),
            initial: open.value.initial.clone(),
        };
        let Matrices { a, b, c, d, initial } = self.predictor(&plain, &k, &l);
        let value = Realisation { model: StateSpace::new(a, b, c, d, time).ok()?, initial };
        let mut all = Vec::new();
        for i in 0..if slopes { theta.len() } else { 0 } {
            let of_plant = i.checked_sub(gains + filters).and_then(|at| open.slopes.get(at));
            let mut moved = Matrices {
                a: dual(&plain.a, of_plant.map(|s| &s.a)),
                b: dual(&plain.b, of_plant.map(|s| &s.b)),
                c: dual(&plain.c, of_plant.map(|s| &s.c)),
                d: dual(&plain.d, of_plant.map(|s| &s.d)),
                initial: plain.initial.map(Dual::from),
            };
            if let Some(slope) = of_plant {
                for (entry, value) in moved.initial.iter_mut().zip(&slope.initial) {
                    entry.slope = *value;
                }
            }
            let (mut k, mut l) = (dual(&k, None), dual(&l, None));
            if i < gains {
                k[(i / n, i % n)].slope = 1.0;
            } else if i < gains + filters {
                l[((i - gains) / p, (i - gains) % p)].slope = 1.0;
            }
            let found = self.predictor(&moved, &k, &l);
            all.push(Slope {
                a: slope_of(&found.a),
                b: slope_of(&found.b),
                c: slope_of(&found.c),
                d: slope_of(&found.d),
                initial: found.initial.map(|v| v.slope),
            });
        }
        Some(Differentiated { value, slopes: all })
    }

    fn draw(&self, stream: &mut Stream, index: usize, time: Discrete, bounds: &[[f64; 2]]) -> Option<Vec<f64>> {
        let [_, m, ..] = self.plant.sizes();
        let (gains, filters) = self.gains();
        let mut nominal = vec![0.0; gains + filters];
        nominal.extend(self.plant.nominal());
        let mut theta = starts::around(&nominal, bounds, stream, index);
        let open = self.open(&theta[gains + filters..], time, false)?.value.model;
        let k = starts::regulator(open.a(), &open.b().columns(0, m).into_owned(), Clock::Sampled, stream, index)?;
        // The filter's weights are drawn apart from the regulator's.
        let dual = starts::regulator(&open.a().transpose(), &open.c().transpose(), Clock::Sampled, stream, index)?;
        put(&k, &mut theta[..gains], &bounds[..gains]);
        put(&dual.transpose(), &mut theta[gains..gains + filters], &bounds[gains..gains + filters]);
        Some(theta)
    }

    fn ports(&self) -> (usize, usize) {
        let [_, m, q, p] = self.plant.sizes();
        match self.predicted {
            Predicted::Output => (q + p, p),
            Predicted::OutputAndControl => (q + p + m, p + m),
            Predicted::Control => (q + p + m, m),
        }
    }
}
