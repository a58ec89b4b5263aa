//! The search against a slow one that shares nothing with it.

use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use rand::RngExt;
use serde_json::json;
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::identify::pool::{Degrees, Pool, PoolSpec};
use volition::identify::problem::{Lines, NEAR, Problem};
use volition::identify::search::{
    Clusters, Exhaustive, FactorTrees, FactoredSearch, MOST_NEAR, Method, Optimum, Search, SensitivitySearch,
};
use volition::num::{Polynomial, linalg};

/// The exhaustive search's answer, which branch and bound must give as well.
fn both(problem: &Problem, pool: &Pool) -> Optimum {
    let ctl = Ctl::new();
    let slow = Exhaustive.search(problem, pool, &ctl).unwrap();
    let told = ctl.bracket();
    ctl.begin_search();
    let trees = FactorTrees::new(problem, pool, &ctl).unwrap();
    let fast = FactoredSearch { trees: &trees }.search(problem, pool, &ctl).unwrap();
    assert_eq!(fast.method, Method::BranchAndBound);
    assert_eq!((fast.index, fast.cost, fast.near_optimal), (slow.index, slow.cost, slow.near_optimal));
    assert_eq!(fast.near, slow.near);
    assert_eq!(slow.near.first(), Some(&(slow.index, slow.cost)));
    assert!(fast.evaluated <= pool.size(), "{} of {}", fast.evaluated, pool.size());
    let product = ctl.bracket();
    let mut answers = vec![(slow.clone(), told), (fast, product)];
    // Small leaves, so that even small pools are divided deeply.
    for leaf in [3, 40] {
        ctl.begin_search();
        let Some(clusters) = Clusters::with_leaves(problem, pool, leaf, &ctl).unwrap() else { continue };
        let listed = SensitivitySearch { clusters: &clusters }.search(problem, pool, &ctl).unwrap();
        assert_eq!(
            (listed.index, listed.cost, listed.near_optimal, &listed.near),
            (slow.index, slow.cost, slow.near_optimal, &slow.near),
            "listed, leaves of {leaf}"
        );
        answers.push((listed, ctl.bracket()));
    }
    for (found, told) in &answers {
        let told = told.unwrap();
        // Costs at the level of rounding are bounded by what rounding may hide.
        let scale: f64 = problem.lines().iter().map(|line| line.response.norm_sqr()).sum();
        let rounding = 1e-9 * found.cost + 1e-20 * scale;
        assert!(told.bound <= found.cost + rounding && found.cost <= told.incumbent + rounding, "{told:?} {found:?}");
    }
    slow
}

/// A random identification: plant, data, lists of coefficients.
#[derive(Debug, Clone)]
struct Case {
    period: Option<f64>,
    plant: (Vec<f64>, Vec<f64>),
    omega: Vec<f64>,
    h: Vec<Complex64>,
    feedforward: Vec<Vec<f64>>,
    feedback_numerators: Vec<Vec<f64>>,
    feedback_denominators: Vec<Vec<f64>>,
    numerator_degree: usize,
    margin: f64,
}

impl Case {
    fn point(&self, w: f64) -> Complex64 {
        self.period.map_or(Complex64::new(0.0, w), |t| Complex64::from_polar(1.0, w * t))
    }

    fn plant(&self) -> System {
        let (num, den) = &self.plant;
        match self.period {
            None => System::Continuous(TransferFunction::new(num, den, Continuous).unwrap()),
            Some(t) => System::Discrete(TransferFunction::new(num, den, Discrete::new(t).unwrap()).unwrap()),
        }
    }

    fn spec(&self) -> PoolSpec {
        let lower = |rows: &[Vec<f64>]| rows.iter().map(|row| row[1..].to_vec()).collect::<Vec<_>>();
        serde_json::from_value(json!({
            "grid": {
                "feedforward_denominator": {"listed": lower(&self.feedforward)},
                "feedback_numerator": {"listed": self.feedback_numerators},
                "feedback_denominator": {"listed": lower(&self.feedback_denominators)},
            },
            "stability_margin": self.margin,
        }))
        .unwrap()
    }

    fn search(&self) -> Option<Optimum> {
        let plant = self.plant();
        let degrees = Degrees { feedforward_numerator: Some(self.numerator_degree), ..Degrees::default() };
        let pool = self.spec().check(degrees).unwrap().build(&plant, &Ctl::new()).ok()?;
        let problem = Problem::new(&Lines::new(&plant, &self.omega, &self.h, None), self.numerator_degree).unwrap();
        Some(both(&problem, &pool))
    }

    /// Largest real part of the exponents of a polynomial's roots.
    fn slowest(&self, p: &Polynomial) -> f64 {
        let exponent = |r: &Complex64| self.period.map_or(r.re, |t| r.norm().ln() / t);
        p.roots().unwrap().iter().map(exponent).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Every stable candidate's cost in the order of the pool, from the formulas (2.4) to (2.8) as printed: powers of
    /// the variable, one dense least-squares problem each. `None` if a pole is too near the boundary to call.
    fn slow(&self) -> Option<Vec<f64>> {
        let poly = |c: &[f64]| Polynomial::new(c.to_vec());
        let (np, dp) = (poly(&self.plant.0), poly(&self.plant.1));
        let call = |p: &Polynomial| {
            let distance = self.slowest(p) + self.margin;
            if distance.abs() < 1e-6 { None } else { Some(distance < 0.0) }
        };
        let mut stable = Vec::new();
        for den in &self.feedforward {
            if den.len() == 1 || call(&poly(den))? {
                stable.push(den);
            }
        }
        let mut costs = Vec::new();
        for dfb in &self.feedback_denominators {
            for nfb in &self.feedback_numerators {
                let closed = dp.mul(&poly(dfb)).add(&np.mul(&poly(nfb)));
                if !call(&closed)? {
                    continue;
                }
                for dff in &stable {
                    costs.push(self.cost(&np, &closed, dff, nfb, dfb));
                }
            }
        }
        Some(costs)
    }

    fn cost(&self, np: &Polynomial, closed: &Polynomial, dff: &[f64], nfb: &[f64], dfb: &[f64]) -> f64 {
        let (dff, nfb, dfb) = (Polynomial::new(dff), Polynomial::new(nfb), Polynomial::new(dfb));
        let lines = self.omega.len();
        let mut a = DMatrix::zeros(2 * lines, self.numerator_degree + 1);
        let mut b = DVector::zeros(2 * lines);
        for (k, w) in self.omega.iter().enumerate() {
            let x = self.point(*w);
            let below = dff.eval(x) * closed.eval(x);
            let target = self.h[k] - np.eval(x) * dff.eval(x) * nfb.eval(x) / below;
            (b[k], b[lines + k]) = (target.re, target.im);
            for i in 0..=self.numerator_degree {
                let entry = np.eval(x) * dfb.eval(x) * x.powu(i as u32) / below;
                (a[(k, i)], a[(lines + k, i)]) = (entry.re, entry.im);
            }
        }
        for mut column in a.column_iter_mut() {
            let norm = column.norm();
            column /= norm;
        }
        linalg::least_squares(&a, &b).unwrap().1
    }
}

fn rows(
    count: std::ops::Range<usize>,
    degree: usize,
    size: f64,
    leading: bool,
) -> impl Strategy<Value = Vec<Vec<f64>>> {
    let row = proptest::collection::vec(-size..size, degree + usize::from(!leading));
    proptest::collection::vec(row, count).prop_map(move |rows| {
        rows.into_iter().map(|row| if leading { [&[1.0], row.as_slice()].concat() } else { row }).collect()
    })
}

/// Monic polynomials with most roots inside the stable region, so that enough candidates are stable.
fn monic(count: std::ops::Range<usize>, degree: usize, sampled: bool) -> BoxedStrategy<Vec<Vec<f64>>> {
    let (low, high) = if sampled { (-0.7, 1.05) } else { (-6.0, 0.3) };
    let roots = proptest::collection::vec(low..high, degree);
    proptest::collection::vec(roots, count)
        .prop_map(|all| {
            let from = |roots: Vec<f64>| {
                let roots: Vec<Complex64> = roots.into_iter().map(|r| Complex64::new(r, 0.0)).collect();
                Polynomial::from_roots(&roots).coefficients().to_vec()
            };
            all.into_iter().map(from).collect()
        })
        .boxed()
}

fn case(sampled: bool) -> impl Strategy<Value = Case> {
    let period = if sampled { Some(0.1) } else { None };
    // Plant: a gain, zeros on either side, poles of which one may be unstable.
    let (zeros, poles) = if sampled { (0.2..1.4, 0.5..1.08) } else { (-4.0..4.0, -5.0..0.8) };
    (1..=3_usize, 0..=1_usize, 0..=2_usize, 0..=4_usize).prop_flat_map(move |(dp, dff, dfb, extra)| {
        let np = dp - 1;
        let nfb = dfb.min(1);
        let numerator_degree = if sampled { extra.min(dff) } else { extra };
        (
            (0.3..3.0_f64, proptest::collection::vec(zeros.clone(), np), proptest::collection::vec(poles.clone(), dp)),
            monic(1..if dff == 0 { 2 } else { 14 }, dff, sampled),
            rows(3..12, nfb, if sampled { 0.6 } else { 6.0 }, false),
            monic(1..if dfb == 0 { 2 } else { 6 }, dfb, sampled),
            proptest::collection::vec((-0.2..0.2_f64, -0.2..0.2_f64), 14),
            prop_oneof![Just(0.0), 0.05..0.3_f64],
        )
            .prop_map(move |((gain, zeros, poles), feedforward, numerators, denominators, noise, margin)| {
                let from = |roots: Vec<f64>| {
                    let roots: Vec<Complex64> = roots.into_iter().map(|r| Complex64::new(r, 0.0)).collect();
                    Polynomial::from_roots(&roots)
                };
                let omega: Vec<f64> = (1..=14).map(|k| 0.4 * f64::from(k)).collect();
                let h = omega
                    .iter()
                    .zip(&noise)
                    .map(|(w, (re, im))| 1.0 / Complex64::new(1.0, 0.3 * w) + Complex64::new(*re, *im))
                    .collect();
                Case {
                    period,
                    plant: (from(zeros).scale(gain).coefficients().to_vec(), from(poles).coefficients().to_vec()),
                    omega,
                    h,
                    feedforward,
                    feedback_numerators: numerators,
                    feedback_denominators: denominators,
                    numerator_degree,
                    margin,
                }
            })
    })
}

/// How many cases had a candidate at all: a test of empty pools would prove nothing.
fn check(case: &Case) -> Result<bool, TestCaseError> {
    let Some(costs) = case.slow() else { return Ok(false) };
    let Some(found) = case.search() else {
        prop_assert!(costs.is_empty(), "{} stable candidates were not found", costs.len());
        return Ok(false);
    };
    prop_assert_eq!(found.evaluated, costs.len() as u64);
    let (index, cost) = costs.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    prop_assert!((found.cost - cost).abs() <= 1e-9 * cost, "cost {} and {}", found.cost, cost);
    // Two candidates of equal cost to rounding may swap places between two ways of computing it.
    let tied = (costs[found.index as usize] - cost).abs() <= 1e-12 * cost;
    prop_assert!(found.index == index as u64 || tied, "argmin {} and {}", found.index, index);
    let count = |limit: f64| costs.iter().filter(|c| **c <= limit).count() as u64;
    let near = (1.0 + NEAR) * cost;
    prop_assert!((count(near * (1.0 - 1e-9))..=count(near * (1.0 + 1e-9))).contains(&found.near_optimal));
    let mut sorted: Vec<f64> = costs.iter().copied().filter(|c| *c <= near).collect();
    sorted.sort_by(f64::total_cmp);
    for ((index, own), expected) in found.near.iter().zip(&sorted) {
        prop_assert!((own - expected).abs() <= 1e-9 * cost, "near {} and {}", own, expected);
        prop_assert!((costs[*index as usize] - own).abs() <= 1e-9 * cost, "the cost of {} is not {}", index, own);
    }
    prop_assert!(found.near.len() >= sorted.len().min(MOST_NEAR).saturating_sub(1));
    Ok(true)
}

fn compare(sampled: bool, seed: [u8; 32]) {
    let config = ProptestConfig { failure_persistence: None, ..ProptestConfig::default() };
    let rng = proptest::test_runner::TestRng::from_seed(proptest::test_runner::RngAlgorithm::ChaCha, &seed);
    let mut runner = proptest::test_runner::TestRunner::new_with_rng(config, rng);
    let mut compared = 0;
    for _ in 0..400 {
        let case = case(sampled).new_tree(&mut runner).unwrap().current();
        match check(&case) {
            Ok(true) => compared += 1,
            Ok(false) => {}
            Err(error) => panic!("seed {}: {error}\n{case:?}", String::from_utf8_lossy(&seed)),
        }
        if compared == 120 {
            return;
        }
    }
    panic!("only {compared} pools had a stable candidate");
}

#[test]
fn continuous_pools_agree_with_a_slow_search() {
    compare(false, *b"volition-ssid-search-continuous!");
}

#[test]
fn sampled_pools_agree_with_a_slow_search() {
    compare(true, *b"volition-ssid-search-sampled-iir");
}

/// Thinned published pools against QR on every candidate, and any number of threads.
#[test]
fn thinned_published_pools_agree_with_qr_on_every_candidate() {
    let omega: Vec<f64> = (0..13).map(|k| 2.0 * std::f64::consts::PI * (0.1 + 0.025 * f64::from(k))).collect();
    let h: Vec<Complex64> = omega.iter().map(|w| Complex64::from_polar(0.95, -0.1 * w * w)).collect();
    let continuous = System::Continuous(volition::plants::catalogue::two_mass());
    let time = Discrete::new(0.02).unwrap();
    let nonminimum = volition::plants::catalogue::nonminimum_phase();
    let sampled = System::Discrete(volition::control::discretise::zero_order_hold(&nonminimum, time).unwrap());
    for (plant, pool, degrees) in [
        (
            &continuous,
            json!({"name": "zhang2015_appendix_b", "thin": {"poles": 20, "zeros": 12, "damping": 6, "gains": 8}}),
            Degrees::default(),
        ),
        (
            &sampled,
            json!({"name": "zhang2015_appendix_c", "thin": {"poles": 20, "zeros": 20, "damping": 6, "gains": 8}}),
            Degrees { feedforward_denominator: Some(6), ..Degrees::default() },
        ),
    ] {
        let pool: PoolSpec = serde_json::from_value(pool).unwrap();
        let recipe = pool.check(degrees).unwrap();
        let pool = recipe.build(plant, &Ctl::new()).unwrap();
        let degree = recipe.feedforward_numerator_degree;
        let problem = Problem::new(&Lines::new(plant, &omega, &h, None), degree).unwrap();
        let found: Vec<Optimum> = [1, 3]
            .into_iter()
            .map(|threads| {
                let threads = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                threads.install(|| both(&problem, &pool))
            })
            .collect();
        assert_eq!(found[0], found[1]);
        assert!(pool.size() > 10_000 && pool.size() < 3_000_000, "{}", pool.size());
        let mut best = (f64::INFINITY, 0);
        for index in (0..pool.size()).step_by(if pool.size() > 200_000 { 7 } else { 1 }).chain([found[0].index]) {
            let cost = volition::identify::search::exact::cost(&problem, &pool.candidate(pool.position(index)));
            if cost < best.0 {
                best = (cost, index);
            }
        }
        assert_eq!(best, (found[0].cost, found[0].index));
    }
}

/// Trials from early to late learning with 0 to 30 % noise, on the plants of the thesis: both searches, the same
/// answer.
#[test]
fn branch_and_bound_agrees_on_thinned_published_pools() {
    use volition::plants::catalogue;
    let omega: Vec<f64> = (0..13).map(|k| 2.0 * std::f64::consts::PI * (0.1 + 0.025 * f64::from(k))).collect();
    let mut rng = volition::num::rng::stream(3, "branch and bound");
    let mut draw = || rng.random::<f64>();
    let appendix = |name: &str, thin: [usize; 4]| {
        let [poles, zeros, damping, gains] = thin;
        json!({"name": name, "thin": {"poles": poles, "zeros": zeros, "damping": damping, "gains": gains}})
    };
    for (plant, pool, order, trials) in [
        (catalogue::two_mass(), appendix("zhang2015_appendix_b", [14, 12, 4, 4]), None, 30),
        (catalogue::nonminimum_phase(), appendix("zhang2015_appendix_c", [16, 16, 6, 4]), Some(6), 30),
        (catalogue::minimum_phase(), appendix("zhang2015_appendix_c", [16, 16, 6, 4]), Some(2), 30),
        (catalogue::damped_double_integrator(), appendix("zhang2015_appendix_c", [16, 16, 6, 4]), Some(3), 20),
        // Unstable: only feedback holds it.
        (
            TransferFunction::new(&[1.0], &[1.0, 0.2, -0.5], Continuous).unwrap(),
            appendix("zhang2015_appendix_b", [14, 12, 4, 4]),
            None,
            20,
        ),
    ] {
        let pool: PoolSpec = serde_json::from_value(pool).unwrap();
        let recipe = pool.check(Degrees { feedforward_denominator: order, ..Degrees::default() }).unwrap();
        let continuous = System::Continuous(plant);
        let plant = volition::identify::ssid::plant_for(&recipe, &continuous, Some(0.02)).unwrap();
        let pool = recipe.build(&plant, &Ctl::new()).unwrap();
        assert!(pool.size() > 10_000 && pool.size() < 20_000_000, "{}", pool.size());
        for trial in 0..trials {
            let learned = f64::from(trial) / f64::from(trials - 1);
            let noise = if trial % 5 == 0 { 0.0 } else { 0.01 * 30f64.powf(draw()) };
            let (gain, zero, lag) = (0.3 * 10f64.powf(draw()), 0.5 + 4.0 * draw(), 0.1 + 0.2 * draw());
            let h: Vec<Complex64> = omega
                .iter()
                .map(|w| {
                    let (s, g) = (Complex64::new(0.0, *w), continuous.response(*w));
                    let slow = 1.0 / (1.0 + s * lag) / (1.0 + s * lag);
                    let feedback = gain * (s + zero) / zero * slow;
                    let feedforward = learned * slow / g + (1.0 - learned) * 1.5 * slow;
                    let scatter = Complex64::from_polar(noise * (2.0 * draw()).sqrt(), std::f64::consts::TAU * draw());
                    g * (feedforward + feedback) / (1.0 + g * feedback) + scatter
                })
                .collect();
            let problem =
                Problem::new(&Lines::new(&plant, &omega, &h, None), recipe.feedforward_numerator_degree).unwrap();
            both(&problem, &pool);
        }
    }
}

/// A bug once: where nothing was known of a cluster, its bound was not a number, and taking the smaller of two numbers
/// dropped it: clusters that spread over half a turn of phase were thrown away with the best candidate in them.
#[test]
fn clusters_of_which_nothing_is_known_are_kept() {
    let omega: Vec<f64> = (0..13).map(|k| 2.0 * std::f64::consts::PI * (0.1 + 0.025 * f64::from(k))).collect();
    let h: Vec<Complex64> = omega.iter().map(|w| Complex64::from_polar(0.95, -0.1 * w * w)).collect();
    let plant = System::Continuous(volition::plants::catalogue::two_mass());
    let spec = json!({"name": "zhang2015_appendix_b", "thin": {"poles": 9, "zeros": 6, "damping": 2, "gains": 6}});
    let recipe = serde_json::from_value::<PoolSpec>(spec).unwrap().check(Degrees::default()).unwrap();
    let pool = recipe.build(&plant, &Ctl::new()).unwrap();
    let problem = Problem::new(&Lines::new(&plant, &omega, &h, None), 4).unwrap();
    both(&problem, &pool);
}

/// A bug once: a feedback integrator on the line 0 Hz made the cost NaN, and NaN won the search.
#[test]
fn a_feedback_pole_on_a_line_costs_its_limit() {
    let time = Discrete::new(1.0).unwrap();
    let plant = System::Discrete(TransferFunction::new(&[0.4], &[1.0, -0.9], time).unwrap());
    let omega: Vec<f64> = (0..12).map(|k| 0.05 * f64::from(k)).collect();
    let h: Vec<Complex64> = omega.iter().map(|w| 0.8 / Complex64::new(1.0, *w)).collect();
    let cost = |pole: f64| {
        let problem = Problem::new(&Lines::new(&plant, &omega, &h, None), 2).unwrap();
        let candidate = volition::identify::pool::Candidate {
            feedforward_denominator: vec![1.0, 0.0, 0.0],
            feedback_numerator: vec![1.0],
            feedback_gain: 0.1,
            feedback_denominator: vec![1.0, -pole],
        };
        volition::identify::search::exact::cost(&problem, &candidate)
    };
    // At 0 Hz the integrator makes the loop's response 1, which misses the data by 0.2 whatever the feedforward does.
    assert!(
        cost(1.0) > 0.04 && (cost(1.0) / cost(1.0 - 1e-9) - 1.0).abs() < 1e-6,
        "{} {}",
        cost(1.0),
        cost(1.0 - 1e-9)
    );
    let pool: PoolSpec = serde_json::from_value(
        json!({"grid": {"feedback_numerator": [[0.05, 0.1]], "feedback_denominator": [[-1.0, -0.5]]}}),
    )
    .unwrap();
    let recipe = pool.check(Degrees { feedforward_denominator: Some(2), ..Degrees::default() }).unwrap();
    let pool = recipe.build(&plant, &Ctl::new()).unwrap();
    assert_eq!(pool.size(), 4);
    let problem = Problem::new(&Lines::new(&plant, &omega, &h, None), 2).unwrap();
    let found = Exhaustive.search(&problem, &pool, &Ctl::new()).unwrap();
    let costs: Vec<f64> =
        (0..4).map(|i| volition::identify::search::exact::cost(&problem, &pool.candidate(pool.position(i)))).collect();
    assert!(costs.iter().all(|c| c.is_finite()), "{costs:?}");
    assert_eq!(found.cost, costs.iter().copied().fold(f64::INFINITY, f64::min));
}
