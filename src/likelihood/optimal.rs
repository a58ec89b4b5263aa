//! A person whose gain is held to be optimal: the same loop, with the weights of a cost in the place of K.
//!
//! ```text
//! K = K(w, φ),  Q = Σ_j w_j E_j,  R fixed;      θ = (ln w, φ)
//! ```
//! φ are the parameters of the plant, the delay and the lag. With `A_c = A − BK` and P of the regulator's Riccati
//! equation its derivative solves, in continuous time,
//!
//! ```text
//! A_cᵀ ∂P + ∂P A_c + ∂Q + (∂A − ∂B K)ᵀP + P(∂A − ∂B K) = 0,   ∂K = R⁻¹(Bᵀ∂P + ∂BᵀP)
//! ```
//! and in sampled time, with `S = R + BᵀPB`,
//!
//! ```text
//! ∂P = A_cᵀ ∂P A_c + ∂Q + (∂A − ∂B K)ᵀP A_c + A_cᵀP(∂A − ∂B K),
//! ∂K = S⁻¹(Bᵀ∂P A_c + ∂BᵀP A_c + BᵀP(∂A − ∂B K)).
//! ```
//! The ratio of the likelihoods with K free and with K optimal tests whether the person is optimal ([`ratio_test`]).

use super::model::LoopModel;
use super::starts;
use crate::control::Discrete;
use crate::control::lqg::lqr;
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::control::parametric::{Differentiated, Slope};
use crate::num::distributions::chi_square_cdf;
use crate::num::dual::Dual;
use crate::num::linalg::symmetric;
use crate::num::nonnegative;
use crate::num::rng::{self, Stream};
use crate::person::state_feedback::{Plant, PlantModel};
use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use rand_distr::StandardNormal;

/// Half the range of a weight's logarithm about its start: a factor of 1e10 either way.
const HALF_RANGE: f64 = 23.0;
/// Half the range of the logarithms that are drawn about the start: a factor of a thousand.
const DRAWN: f64 = 6.9;
/// A weight whose doubling moves the answer by less than this many standard errors is at zero, where K's cone ends.
const ACTIVE: f64 = 1e-2;
/// Draws for the null distribution where the answer lies on the cone's boundary.
const NULL_DRAWS: usize = 20_000;

/// A loop whose gain is the regulator of some weights.
pub struct OptimalPerson<'a, P> {
    /// The loop with a free gain, whose parameters are K row by row and then φ.
    pub free: &'a dyn LoopModel,
    /// Its plant; the plant's parameters are the first of φ.
    pub plant: &'a P,
    /// The time base of K.
    pub clock: Clock,
    /// The states that Q weighs, each by a weight of its own.
    pub weighed: Vec<usize>,
    /// The name of each weight.
    pub names: Vec<String>,
    /// R, m×m, held: the scale of the cost.
    pub control_weight: DMatrix<f64>,
    /// Where the logarithms of the weights start.
    pub start: Vec<f64>,
}

/// K with the derivatives by every parameter.
struct Gain {
    k: DMatrix<f64>,
    slopes: Vec<DMatrix<f64>>,
}

impl<P: PlantModel> OptimalPerson<'_, P> {
    fn weights(&self) -> usize {
        self.weighed.len()
    }

    fn sizes(&self) -> [usize; 2] {
        let [n, m, ..] = self.plant.sizes();
        [n, m]
    }

    /// Q at these parameters.
    #[must_use]
    pub fn state_weight(&self, theta: &[f64]) -> DMatrix<f64> {
        let [n, _] = self.sizes();
        let mut q = DMatrix::zeros(n, n);
        for (state, log) in self.weighed.iter().zip(theta) {
            q[(*state, *state)] = log.exp();
        }
        q
    }

    /// K at these parameters; `None` where the regulator has none.
    #[must_use]
    pub fn gain(&self, theta: &[f64]) -> Option<DMatrix<f64>> {
        self.solve(theta, false).map(|found| found.k)
    }

    /// ∂K by every parameter, as rows of K row by row: mn × parameters. `None` where the regulator has none.
    #[must_use]
    pub fn gain_slopes(&self, theta: &[f64]) -> Option<DMatrix<f64>> {
        let slopes = self.solve(theta, true)?.slopes;
        let [n, m] = self.sizes();
        Some(DMatrix::from_fn(n * m, slopes.len(), |i, j| slopes[j][(i / n, i % n)]))
    }

    fn solve(&self, theta: &[f64], with_slopes: bool) -> Option<Gain> {
        let of_plant = theta.get(self.weights()..self.weights() + self.plant.names().len())?;
        let Plant { a, b, .. } = self.plant.plant::<f64>(of_plant);
        let (q, r) = (self.state_weight(theta), &self.control_weight);
        let found = lqr(&a, &b, &q, r, self.clock).ok()?;
        let (p, k) = (found.p, found.k);
        if !with_slopes {
            return Some(Gain { k, slopes: Vec::new() });
        }
        let closed = &a - &b * &k;
        let equation = Lyapunov::new(&closed, self.clock).ok()?;
        let sampled = self.clock == Clock::Sampled;
        let scale = if sampled { r + b.tr_mul(&(&p * &b)) } else { r.clone() };
        let scale = symmetric(&scale).cholesky()?;
        let by = |dq: Option<(usize, f64)>, da: &DMatrix<f64>, db: &DMatrix<f64>| {
            let moved = da - db * &k;
            let inner = if sampled { moved.tr_mul(&(&p * &closed)) } else { moved.tr_mul(&p) };
            let mut right = &inner + inner.transpose();
            if let Some((state, weight)) = dq {
                right[(state, state)] += weight;
            }
            let dp = equation.solve(&right);
            let direct = if sampled {
                b.tr_mul(&(&dp * &closed)) + db.tr_mul(&(&p * &closed)) + b.tr_mul(&(&p * &moved))
            } else {
                b.tr_mul(&dp) + db.tr_mul(&p)
            };
            scale.solve(&direct)
        };
        let (no_a, no_b) = (DMatrix::zeros(a.nrows(), a.ncols()), DMatrix::zeros(b.nrows(), b.ncols()));
        let mut slopes: Vec<DMatrix<f64>> =
            self.weighed.iter().map(|state| by(Some((*state, q[(*state, *state)])), &no_a, &no_b)).collect();
        let mut duals: Vec<Dual> = of_plant.iter().map(|v| Dual { value: *v, slope: 0.0 }).collect();
        for i in 0..duals.len() {
            duals[i].slope = 1.0;
            let moved = self.plant.plant::<Dual>(&duals);
            duals[i].slope = 0.0;
            slopes.push(by(None, &moved.a.map(|v| v.slope), &moved.b.map(|v| v.slope)));
        }
        // The person's delay and lag move no gain.
        slopes.resize(theta.len(), DMatrix::zeros(k.nrows(), k.ncols()));
        Some(Gain { k, slopes })
    }

    /// The parameters of the free loop at these.
    #[must_use]
    pub fn in_free(&self, theta: &[f64], k: &DMatrix<f64>) -> Vec<f64> {
        let rows = k.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<_>>());
        rows.chain(theta[self.weights()..].iter().copied()).collect()
    }

    fn free_rest(&self) -> usize {
        let [n, m] = self.sizes();
        n * m
    }
}

/// `into += share · slope`.
fn add(into: &mut Slope, slope: &Slope, share: f64) {
    into.a += &slope.a * share;
    into.b += &slope.b * share;
    into.c += &slope.c * share;
    into.d += &slope.d * share;
    into.initial += &slope.initial * share;
}

impl<P: PlantModel> LoopModel for OptimalPerson<'_, P> {
    fn names(&self) -> Vec<String> {
        self.names.iter().cloned().chain(self.free.names().into_iter().skip(self.free_rest())).collect()
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        let own = self.start.iter().map(|log| [log - HALF_RANGE, log + HALF_RANGE]);
        own.chain(self.free.limits().into_iter().skip(self.free_rest())).collect()
    }

    fn sampled(&self, theta: &[f64], time: Discrete, slopes: bool) -> Option<Differentiated<Discrete>> {
        let gain = self.solve(theta, slopes)?;
        let free = self.free.sampled(&self.in_free(theta, &gain.k), time, slopes)?;
        if !slopes {
            return Some(free);
        }
        let [n, _] = self.sizes();
        let (of_gain, of_rest) = free.slopes.split_at(self.free_rest());
        let first = of_gain.first()?;
        let none = Slope {
            a: first.a.map(|_| 0.0),
            b: first.b.map(|_| 0.0),
            c: first.c.map(|_| 0.0),
            d: first.d.map(|_| 0.0),
            initial: first.initial.map(|_| 0.0),
        };
        let own = |(i, moved): (usize, &DMatrix<f64>)| {
            let mut slope = i.checked_sub(self.weights()).map_or_else(|| none.clone(), |rest| of_rest[rest].clone());
            for (entry, by_entry) in of_gain.iter().enumerate() {
                let share = moved[(entry / n, entry % n)];
                if share != 0.0 {
                    add(&mut slope, by_entry, share);
                }
            }
            slope
        };
        Some(Differentiated { value: free.value, slopes: gain.slopes.iter().enumerate().map(own).collect() })
    }

    fn draw(&self, stream: &mut Stream, index: usize, time: Discrete, bounds: &[[f64; 2]]) -> Option<Vec<f64>> {
        let weights = self.weights();
        let mut theta: Vec<f64> = self
            .start
            .iter()
            .zip(bounds)
            .map(|(log, [low, high])| {
                // Always drawn, so that the first, which is the start itself, moves nothing else.
                let share = DRAWN * (2.0 * stream.random::<f64>() - 1.0);
                (log + if index == 0 { 0.0 } else { share }).clamp(*low, *high)
            })
            .collect();
        let limits = self.free.limits();
        let all: Vec<[f64; 2]> =
            limits[..self.free_rest()].iter().copied().chain(bounds[weights..].iter().copied()).collect();
        theta.extend(self.free.draw(stream, index, time, &all)?.into_iter().skip(self.free_rest()));
        Some(theta)
    }

    fn ports(&self) -> (usize, usize) {
        self.free.ports()
    }
}

/// The distribution that a ratio is held against.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Null {
    /// χ² with so many degrees of freedom: fewer weights than gains, none of them at zero.
    ChiSquare(usize),
    /// A mixture of χ², from draws: some weights are at zero, where the cone of optimal gains ends.
    Mixture {
        /// Draws.
        draws: usize,
        /// The share of them that lie in the cone, where the ratio is zero.
        inside: f64,
    },
    /// All mass at zero: as many weights as gains, none of them at zero. Every gain nearby is optimal too.
    Zero,
}

/// Whether a person is optimal.
#[derive(Debug, Clone, PartialEq)]
pub struct RatioTest {
    /// Twice the difference of the log likelihoods, of the free loop and of the optimal one.
    pub ratio: f64,
    /// The probability of a larger ratio for a person who is optimal.
    pub p_value: f64,
    /// What the ratio is held against.
    pub null: Null,
    /// Which weights are at zero.
    pub at_zero: Vec<bool>,
}

/// The ratio test of the optimal person at θ against a free gain (Self and Liang, J. Am. Stat. Assoc. 82, 605–610,
/// 1987): near the truth the estimate of the free loop is normal with this covariance, and the ratio is its squared
/// distance from the tangent cone of what is optimal, in that metric.
///
/// `covariance` is that of all parameters of the free loop. `None` where it is not definite, or K has no slopes.
#[must_use]
pub fn ratio_test<P: PlantModel>(
    person: &OptimalPerson<'_, P>,
    theta: &[f64],
    covariance: &DMatrix<f64>,
    ratio: f64,
    seed: u64,
) -> Option<RatioTest> {
    let slopes = person.gain_slopes(theta)?;
    let (gains, parameters) = slopes.shape();
    let weights = person.weighed.len();
    let total = gains + parameters - weights;
    // Parameters of the free loop that a bound holds have no variance, and are held here too.
    let alive: Vec<usize> = (0..total).filter(|i| covariance[(*i, *i)] > 0.0).collect();
    let kept = DMatrix::from_fn(alive.len(), alive.len(), |i, j| covariance[(alive[i], alive[j])]);
    let factor = kept.cholesky()?.l();
    // How the parameters of the free loop move with (ln w, φ), in units of the estimate's own errors.
    let moved = DMatrix::from_fn(alive.len(), parameters, |i, j| match alive[i].checked_sub(gains) {
        None => slopes[(alive[i], j)],
        Some(rest) => f64::from(u8::from(rest + weights == j)),
    });
    let moved = factor.solve_lower_triangular(&moved)?;
    let at_zero: Vec<bool> = (0..weights).map(|j| moved.column(j).norm() < ACTIVE).collect();
    let free: Vec<DVector<f64>> = (0..parameters)
        .filter(|j| !at_zero.get(*j).copied().unwrap_or(false))
        .map(|j| moved.column(j).into_owned())
        .filter(|column| column.norm() > 0.0)
        .collect();
    let basis = orthonormal(&free);
    let rest = alive.len().saturating_sub(basis.len());
    let apart = |v: &DVector<f64>| basis.iter().fold(v.clone(), |v, u| &v - u * u.dot(&v));
    // What is left of the directions into the cone; their lengths do not matter.
    let into: Vec<DVector<f64>> = (0..weights)
        .filter(|j| at_zero[*j])
        .map(|j| {
            let column = moved.column(j).into_owned();
            let length = column.norm();
            apart(&if length > 0.0 { column / length } else { column })
        })
        .filter(|column| column.norm() > 1e-9)
        .map(|column| column.normalize())
        .collect();
    let ratio = ratio.max(0.0);
    let (p_value, null) = if rest == 0 {
        (1.0, Null::Zero)
    } else if into.is_empty() {
        ((1.0 - chi_square_cdf(ratio, rest as f64)).clamp(0.0, 1.0), Null::ChiSquare(rest))
    } else {
        let directions = DMatrix::from_columns(&into);
        let gram = directions.tr_mul(&directions);
        let mut stream = rng::stream(seed, "ratio test");
        let (mut larger, mut inside) = (0, 0);
        for _ in 0..NULL_DRAWS {
            let drawn = DVector::from_fn(alive.len(), |_, _| stream.sample::<f64, _>(StandardNormal));
            let drawn = apart(&drawn);
            let along = directions.tr_mul(&drawn);
            let shares = nonnegative::minimise(&gram, &-&along, 1e-12 * along.amax());
            let distance = (drawn - &directions * shares).norm_squared();
            larger += u32::from(distance >= ratio);
            inside += u32::from(distance < 1e-9);
        }
        let inside = f64::from(inside) / NULL_DRAWS as f64;
        // The ratio itself is one of the draws: so many of them cannot tell a probability of zero.
        let p_value = f64::from(larger + 1) / (NULL_DRAWS + 1) as f64;
        (p_value, Null::Mixture { draws: NULL_DRAWS, inside })
    };
    Some(RatioTest { ratio, p_value, null, at_zero })
}

/// An orthonormal basis of what these columns span.
fn orthonormal(columns: &[DVector<f64>]) -> Vec<DVector<f64>> {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    for column in columns {
        let length = column.norm();
        // Twice, so that rounding leaves nothing of the others.
        let reduced = (0..2).fold(column / length, |v, _| basis.iter().fold(v, |v, u| &v - u * u.dot(&v)));
        if reduced.norm() > 1e-8 {
            basis.push(reduced.normalize());
        }
    }
    basis
}

/// The start of weights where none is known: of equal influence on the plain regulator of this plant.
#[must_use]
pub fn plain_start<P: PlantModel>(plant: &P, clock: Clock, weights: usize, seed: u64) -> Vec<f64> {
    let plant = plant.plant::<f64>(&plant.nominal());
    let mut stream = rng::stream(seed, "plain regulator");
    let size = starts::regulator(&plant.a, &plant.b, clock, &mut stream, 0).map_or(1.0, |k| k.norm_squared());
    vec![size.max(f64::MIN_POSITIVE).ln(); weights]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Continuous;
    use crate::person::state_feedback::{AffinePlant, StateFeedback, Term};

    /// An inverted pendulum whose stiffness is a parameter.
    fn pendulum() -> AffinePlant {
        let zero = |r: usize, c: usize| DMatrix::zeros(r, c);
        let base = Plant {
            a: DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 0.0, -0.3]),
            b: DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
            e: DMatrix::from_row_slice(2, 1, &[0.0, 1.0]),
            c: DMatrix::identity(2, 2),
            d: zero(2, 1),
            f: zero(2, 1),
            initial: vec![0.0; 2],
        };
        let slope = Plant {
            a: DMatrix::from_row_slice(2, 2, &[0.0, 0.0, 1.0, 0.0]),
            b: DMatrix::from_row_slice(2, 1, &[0.0, 0.1]),
            e: zero(2, 1),
            c: zero(2, 2),
            d: zero(2, 1),
            f: zero(2, 1),
            initial: vec![0.0; 2],
        };
        AffinePlant { base, terms: vec![Term { name: "stiffness".into(), nominal: 4.0, slope }] }
    }

    fn person<'a>(free: &'a dyn LoopModel, plant: &'a AffinePlant, clock: Clock) -> OptimalPerson<'a, AffinePlant> {
        OptimalPerson {
            free,
            plant,
            clock,
            weighed: vec![0, 1],
            names: vec!["w1".into(), "w2".into()],
            control_weight: DMatrix::from_element(1, 1, 0.5),
            start: vec![5.0, 1.0],
        }
    }

    /// Against central differences, in both times.
    #[test]
    fn gains_have_exact_slopes_by_weights_and_plant() {
        let mut plant = pendulum();
        for clock in [Clock::Continuous, Clock::Sampled] {
            if clock == Clock::Sampled {
                plant.base.a = DMatrix::from_row_slice(2, 2, &[1.0, 0.1, 0.0, 0.97]);
                plant.base.b = DMatrix::from_row_slice(2, 1, &[0.005, 0.1]);
                plant.terms[0].nominal = 0.3;
            }
            let free = StateFeedback { plant: plant.clone(), time: Continuous, delay: None, lag: None };
            let person = person(&free, &plant, clock);
            let theta = [1.3, -0.4, plant.terms[0].nominal];
            let slopes = person.gain_slopes(&theta).unwrap();
            for j in 0..3 {
                let step = 1e-5;
                let at = |sign: f64| {
                    let mut moved = theta;
                    moved[j] += sign * step;
                    person.gain(&moved).unwrap()
                };
                let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
                for i in 0..2 {
                    let error = (slopes[(i, j)] - difference[(0, i)]).abs();
                    assert!(error <= 1e-7 * (1.0 + difference.norm()), "{clock:?} {i} {j}: {error:e}");
                }
            }
        }
    }

    /// The sampled loop's slopes, through K and through the plant, against differences of the loop itself.
    #[test]
    fn the_loop_has_exact_slopes() {
        let plant = pendulum();
        let free = StateFeedback { plant: plant.clone(), time: Continuous, delay: None, lag: None };
        let person = person(&free, &plant, Clock::Continuous);
        let (theta, time) = ([4.0, 1.0, 4.2], Discrete::new(0.02).unwrap());
        let found = person.sampled(&theta, time, true).unwrap();
        for j in 0..3 {
            let step = 1e-5;
            let at = |sign: f64| {
                let mut moved = theta;
                moved[j] += sign * step;
                person.sampled(&moved, time, false).unwrap().value.model.a().clone()
            };
            let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
            assert!((&found.slopes[j].a - &difference).norm() <= 1e-8 * (1.0 + difference.norm()), "{j}");
        }
    }

    /// Inside the cone nothing is tested; on its edge half of the mass is at zero; with one weight for two gains the
    /// ratio is chi-square with one degree of freedom.
    #[test]
    fn the_null_distribution_is_that_of_the_tangent_cone() {
        let mut plant = pendulum();
        plant.terms.clear();
        plant.base.a[(1, 0)] = 4.0;
        let free = StateFeedback { plant: plant.clone(), time: Continuous, delay: None, lag: None };
        let mut person = person(&free, &plant, Clock::Continuous);
        let covariance = DMatrix::from_row_slice(2, 2, &[0.3, 0.05, 0.05, 0.02]);
        let inside = ratio_test(&person, &[6.0, 3.0], &covariance, 0.0, 1).unwrap();
        assert_eq!((inside.null, inside.p_value), (Null::Zero, 1.0));
        let edge = ratio_test(&person, &[6.0, -22.0], &covariance, 2.706, 1).unwrap();
        assert_eq!(edge.at_zero, [false, true]);
        let Null::Mixture { inside, .. } = edge.null else { panic!("{edge:?}") };
        // Half a point mass at zero, half a chi-square with one degree of freedom.
        assert!((inside - 0.5).abs() < 0.02, "{inside}");
        assert!((edge.p_value - 0.05).abs() < 0.006, "{}", edge.p_value);
        person.weighed = vec![0];
        person.names.truncate(1);
        person.start.truncate(1);
        let one = ratio_test(&person, &[6.0], &covariance, 3.841_458_820_694_124, 1).unwrap();
        assert_eq!(one.null, Null::ChiSquare(1));
        assert!((one.p_value - 0.05).abs() < 1e-9, "{}", one.p_value);
    }
}
