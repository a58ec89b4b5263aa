//! Counts of the published candidate pools.

use num_complex::Complex64;
use rand::RngExt;
use serde_json::json;
use volition::control::{Continuous, Discrete, System, TransferFunction, discretise};
use volition::ctl::Ctl;
use volition::identify::pool::recipe::Ingredients;
use volition::identify::pool::roots::RootPair;
use volition::identify::pool::{Degrees, Extremes, PoolName, PoolSpec, Recipe};
use volition::num::{Polynomial, rng};

fn two_mass() -> System {
    System::Continuous(volition::plants::catalogue::two_mass())
}

fn golden() -> serde_json::Value {
    serde_json::from_str(include_str!("../golden/ssid_pools.json")).unwrap()
}

/// Condition C5 is strict: a pole at exactly −0.1 is not in the pool. 3,359 feedback controllers with a gain lie
/// exactly there (a zero at −0.1 cancels a pole at −0.1). The reference counts 405 feedback controllers more than we
/// do; see
/// [`what_the_reference_counts_beyond_the_pool_is_on_the_boundary`].
#[test]
fn appendix_b_counts() {
    let golden = &golden()["appendix_b"];
    let count = |name: &str| golden[name].as_u64().unwrap();
    let recipe = PoolSpec::Name(PoolName::Zhang2015AppendixB).check(Degrees::default()).unwrap();
    assert_eq!(recipe.feedback_denominators.len() as u64, count("P"));
    let pool = recipe.build(&two_mass(), &Ctl::new()).unwrap();
    let feedforward = pool.feedforward().len() as u64;
    let feedback = pool.feedback().len();
    assert_eq!(feedforward, count("M_ff"));
    assert_eq!(feedback, count("M_fb_strict"));
    assert_eq!(pool.size(), feedforward * feedback);

    // With the boundary let in, the controllers on it appear, and nothing else.
    let mut wider = recipe;
    wider.margin -= 1e-10;
    let wider = wider.build(&two_mass(), &Ctl::new()).unwrap();
    let zero_gain_on_boundary = wider.feedforward().len() as u64 - feedforward;
    let on_boundary = wider.feedback().len() - feedback - zero_gain_on_boundary;
    assert_eq!(on_boundary, count("routh_entry_below_1e-9"));
}

/// With a zero at −0.1 and a pole at −0.1, the closed loop has a pole at −0.1 whatever the plant and the gain are: the
/// controller is not in the pool. Those whose other poles are fast enough are the 3,359 of the boundary.
///
/// The reference's count is ours and 405 of these: as many as come in where the coefficients of `s² + a1 s + a0` are
/// taken as decimals, moved by the margin in doubles, and any constant term above zero passes. That its program does so
/// is inferred from the number; it must judge denominators alone otherwise, or 14 more than 5,137 would pass without
/// feedback.
#[test]
fn what_the_reference_counts_beyond_the_pool_is_on_the_boundary() {
    let golden = &golden()["appendix_b"];
    let count = |name: &str| golden[name].as_u64().unwrap();
    let mut recipe = PoolSpec::Name(PoolName::Zhang2015AppendixB).check(Degrees::default()).unwrap();
    // Roots in tenths of rad/s are whole numbers.
    let tenths = |root: f64| {
        let whole = (10.0 * root).round();
        assert_eq!(whole / 10.0, root);
        whole as i64
    };
    let Ingredients::Roots(numerators) = &recipe.feedback_numerators else { panic!("a list of roots") };
    let zeros: Vec<i64> =
        numerators.iter().map(|n| if let RootPair::One(z) = n { tenths(*z) } else { panic!("{n:?}") }).collect();
    let Ingredients::Roots(denominators) = &recipe.feedback_denominators else { panic!("a list of roots") };
    let with_the_pole: Vec<RootPair> =
        denominators.iter().copied().filter(|d| matches!(d, RootPair::Two(p, q) if *p == -0.1 || *q == -0.1)).collect();
    assert_eq!(with_the_pole.len(), 143);
    recipe.feedback_denominators = Ingredients::Roots(with_the_pole.clone());
    let strict = recipe.build(&two_mass(), &Ctl::new()).unwrap();
    recipe.margin -= 1e-10;
    let wider = recipe.build(&two_mass(), &Ctl::new()).unwrap();

    let (mut on_boundary, mut let_in, mut named) = (0, 0, Vec::new());
    for (d, pair) in with_the_pole.iter().enumerate() {
        let RootPair::Two(p, q) = *pair else { panic!("{pair:?}") };
        let poles = [tenths(p), tenths(q)];
        for (n, zero) in zeros.iter().enumerate() {
            let (inside, here) = (strict.feedback().gains_of(d, Some(n)), wider.feedback().gains_of(d, Some(n)));
            // 100 Dfb and 10 Nfb at s = −1/10.
            let (below, above) = ((-1 - poles[0]) * (-1 - poles[1]), -1 - zero);
            assert_eq!(below, 0);
            if above != 0 {
                assert_eq!(inside, here, "{pair:?}, zero {zero}/10");
                continue;
            }
            assert_eq!(inside, [0.0; 0], "{pair:?}");
            on_boundary += here.len() as u64;
            let (a1, a0) = (-(poles[0] + poles[1]) as f64 / 10.0, (poles[0] * poles[1]) as f64 / 100.0);
            if a0 - 0.1 * a1 + 0.1 * 0.1 > 0.0 && !here.is_empty() {
                let_in += here.len() as u64;
                named.push((poles[0], poles[1], here.len()));
            }
        }
    }
    assert_eq!(on_boundary, count("routh_entry_below_1e-9"));
    assert_eq!(let_in, count("M_fb_reference") - count("M_fb_strict"));
    let expected = [
        (-55, -1, 49),
        (-45, -1, 48),
        (-40, -1, 48),
        (-23, -1, 45),
        (-22, -1, 45),
        (-13, -1, 36),
        (-11, -1, 33),
        (-6, -1, 27),
        (-5, -1, 25),
        (-2, -1, 19),
        (-1, 1, 11),
        (-1, 2, 9),
        (-1, 3, 6),
        (-1, 5, 2),
        (-1, 6, 2),
    ];
    assert_eq!(named, expected);
}

/// The controllers of appendix B nearest to the boundary on either side that are not on it, their slowest pole found
/// with 80 digits: −0.1 − 2.4·10⁻⁹ and −0.1 + 1.2·10⁻⁸.
#[test]
fn the_nearest_controllers_of_appendix_b_are_on_their_side_of_the_boundary() {
    for (natural_frequency, damping, zero, gain, belongs) in
        [(15.5, 0.7, -20.0, -1.1, true), (0.75, 0.18, -1.7, 0.5, false)]
    {
        let mut recipe = PoolSpec::Name(PoolName::Zhang2015AppendixB).check(Degrees::default()).unwrap();
        let Ingredients::Roots(zeros) = &recipe.feedback_numerators else { panic!("a list of roots") };
        let numerator = zeros.iter().position(|z| *z == RootPair::One(zero)).unwrap();
        let position = recipe.gains.iter().position(|g| *g == gain).unwrap();
        let denominator = RootPair::Complex { natural_frequency, damping };
        assert_eq!(recipe.feedback_denominators.len(), 16_364);
        let Ingredients::Roots(all) = &recipe.feedback_denominators else { panic!("a list of roots") };
        assert!(all.contains(&denominator));
        recipe.feedback_denominators = Ingredients::Roots(vec![denominator]);
        let mut found = false;
        let pool = recipe.build(&two_mass(), &Ctl::new()).unwrap();
        let visit = |row: volition::identify::pool::feedback::Row<'_>| {
            found |= row.numerator == Some(numerator) && row.positions().contains(&position);
            Ok(())
        };
        pool.feedback().walk_denominator(0, &Ctl::new(), visit).unwrap();
        assert_eq!(found, belongs, "{denominator:?}, zero {zero}, gain {gain}");
    }
}

/// Thinned pools of both appendices, counted once more by other means: peaks on a fine grid, closed-loop poles as
/// eigenvalues.
#[test]
fn thinned_counts_agree_with_a_slow_count() {
    let time = Discrete::new(0.02).unwrap();
    let zoh = |plant| System::Discrete(discretise::zero_order_hold(&plant, time).unwrap());
    for (name, plant) in [
        ("zhang2015_appendix_b", two_mass()),
        ("zhang2015_appendix_c", zoh(volition::plants::catalogue::minimum_phase())),
        ("zhang2015_appendix_c", zoh(volition::plants::catalogue::nonminimum_phase())),
    ] {
        let spec: PoolSpec = serde_json::from_value(
            json!({"name": name, "thin": {"poles": 31, "zeros": 37, "damping": 11, "gains": 9}}),
        )
        .unwrap();
        let recipe = spec.check(Degrees::default()).unwrap();
        let pool = recipe.build(&plant, &Ctl::new()).unwrap();
        let (Ingredients::Roots(denominators), Ingredients::Roots(numerators)) =
            (&recipe.feedback_denominators, &recipe.feedback_numerators)
        else {
            panic!("lists of roots")
        };
        let period = plant.sample_time_s();
        let polynomial =
            |pair: RootPair| Polynomial::new(period.map_or_else(|| pair.polynomial(), |t| pair.matched(t)));
        let [low, high] = recipe.band_rad_s.unwrap();
        let at = |p: &Polynomial, w: f64| {
            p.eval(period.map_or(Complex64::new(0.0, w), |t| Complex64::from_polar(1.0, w * t))).norm()
        };
        let slowest = |p: &Polynomial| {
            let exponent = |r: &Complex64| period.map_or(r.re, |t| r.norm().ln() / t);
            p.roots().unwrap().iter().map(exponent).fold(f64::NEG_INFINITY, f64::max)
        };
        let (mut stable, mut near) = (0, 0);
        let mut judge = |p: &Polynomial| {
            let distance = slowest(p) + recipe.margin;
            near += u64::from(distance.abs() < 1e-5);
            stable += u64::from(distance < 0.0);
        };
        for d in denominators {
            let below = polynomial(*d);
            let base = plant.den().mul(&below);
            judge(&base);
            for n in numerators {
                let above = polynomial(*n);
                let peak = (0..=2000)
                    .map(|i| low + (high - low) * f64::from(i) / 2000.0)
                    .map(|w| at(&above, w) / at(&below, w))
                    .fold(0.0, f64::max);
                if peak > 1e6 {
                    continue; // A pole on the band: no gain has a finite peak.
                }
                for gain in &recipe.gains {
                    judge(&base.add(&plant.num().mul(&above).scale(gain / peak)));
                }
            }
        }
        // Candidates that neither way can call for sure may fall on either side.
        let found = pool.feedback().len();
        assert!(found.abs_diff(stable) <= near, "{name}: {found} and {stable}, {near} too near to call");
        assert!(found > 100 && near * 200 < found, "{name}: {found} found, {near} near the boundary");
    }
}

/// The rows of every denominator, counted eight at a time and row by row: the same gains to the last one, and the same
/// extremes.
fn scans_agree(recipe: &Recipe, plant: &System, seen: &mut u64) {
    let Ok(pool) = recipe.build(plant, &Ctl::new()) else { return };
    let table = pool.feedback();
    let width = table.numerators().len();
    let scales: Vec<f64> = (0..width).map(|n| 0.3 + (n % 17) as f64).collect();
    let mut total = 0;
    for denominator in 0..table.denominators().len() {
        let (mut fast, mut slow) = (Extremes::none(width), Extremes::none(width));
        let scale = 1.0 + denominator as f64;
        let count = table.scan(denominator, Some((&mut fast, scale, &scales)), &Ctl::new()).unwrap();
        let mut listed = 0;
        table
            .walk_denominator(denominator, &Ctl::new(), |row| {
                listed += row.gains.len() as u64;
                let Some(n) = row.numerator else { return Ok(()) };
                for gain in row.gains {
                    let modulus = gain.abs() * (scale * scales[n]);
                    let (least, most) = if *gain > 0.0 {
                        (&mut slow.least_positive[n], &mut slow.most_positive[n])
                    } else {
                        (&mut slow.least_negative[n], &mut slow.most_negative[n])
                    };
                    (*least, *most) = (least.min(modulus), most.max(modulus));
                }
                // The same gains by looking at each sign within bounds.
                for negative in [false, true] {
                    let mut opened: Vec<Option<usize>> = Vec::new();
                    table.open(denominator).visit(n, negative, [0.0, f64::INFINITY], |f| opened.push(f.gain_position));
                    opened.sort_unstable();
                    let of_sign = |i: &usize| (row.gains[*i] < 0.0) == negative;
                    let row: Vec<_> = (0..row.gains.len()).filter(of_sign).map(|i| Some(row.positions()[i])).collect();
                    assert_eq!(opened, row);
                }
                Ok(())
            })
            .unwrap();
        assert_eq!(count, listed, "denominator {denominator}");
        assert_eq!(fast, slow, "denominator {denominator}");
        total += count;
    }
    assert_eq!(total, table.len());
    *seen += total;
}

#[test]
fn counting_several_rows_at_once_agrees_with_row_by_row() {
    let time = Discrete::new(0.02).unwrap();
    let zoh = |plant| System::Discrete(discretise::zero_order_hold(&plant, time).unwrap());
    let unstable = TransferFunction::new(&[1.0, 3.0], &[1.0, 0.2, -0.5], Continuous).unwrap();
    let mut seen = 0;
    for plant in [
        zoh(volition::plants::catalogue::minimum_phase()),
        zoh(volition::plants::catalogue::nonminimum_phase()),
        zoh(volition::plants::catalogue::damped_double_integrator()),
        zoh(unstable),
    ] {
        for thin in [[13, 11, 5, 1], [17, 9, 7, 2]] {
            let spec: PoolSpec = serde_json::from_value(json!({
                "name": "zhang2015_appendix_c",
                "thin": {"poles": thin[0], "zeros": thin[1], "damping": thin[2], "gains": thin[3]}
            }))
            .unwrap();
            scans_agree(&spec.check(Degrees::default()).unwrap(), &plant, &mut seen);
        }
    }
    assert!(seen > 1_000_000, "{seen}");

    // Coefficients as they come: leading ones of either sign, zeros among them, gains of either sign.
    let mut rng = rng::stream(29, "scan");
    let mut draw = move |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
    let mut seen = 0;
    for case in 0..200 {
        let mut rows = |count: usize, length: usize, size: f64| -> Vec<Vec<f64>> {
            let mut entry = |i: usize, j: usize| if (i + j + case).is_multiple_of(7) { 0.0 } else { draw(-size, size) };
            (0..count).map(|i| (0..length).map(|j| entry(i, j)).collect()).collect()
        };
        let (numerators, mut denominators) = (rows(27, 3, 1.5), rows(6, 2, 1.2));
        denominators.push(vec![-0.5, 0.06]);
        let plant = rows(1, 3, 1.0).remove(0);
        let plant = TransferFunction::new(&[0.4 + plant[0].abs(), plant[1]], &[1.0, -1.2, 0.35 + 0.1 * plant[2]], time)
            .unwrap();
        let spec: PoolSpec = serde_json::from_value(json!({
            "grid": {"feedback_numerator": {"listed": numerators}, "feedback_denominator": {"listed": denominators}},
            "stability_margin": if case % 2 == 0 { 0.0 } else { 0.1 },
        }))
        .unwrap();
        let mut recipe = spec.check(Degrees::default()).unwrap();
        recipe.gains = vec![1.0, -0.3, 0.05, -2.0, 0.4, 1e-3, 7.0, -0.01, 1.0 + 1e-15];
        recipe.zero_gain = case % 3 == 0;
        scans_agree(&recipe, &System::Discrete(plant), &mut seen);
    }
    assert!(seen > 5_000, "{seen}");
}
