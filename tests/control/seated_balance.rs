//! Seated balance against the values of chapter 5, its own nonlinear equations, and finite differences.

use nalgebra::{DMatrix, DVector};
use rand::RngExt;
use serde_json::Value;
use volition::control::parametric::{ParametricError, ParametricModel};
use volition::control::{Discrete, StateSpace};
use volition::num::rng;
use volition::plants::seated_balance::{
    Drive, Output, Parameter, SeatedBalance, SeatedBalanceError, Structure, Values, nonlinear,
};

fn golden() -> Value {
    serde_json::from_str(include_str!("../golden/seated_balance.json")).unwrap()
}

fn list(value: &Value) -> Vec<f64> {
    serde_json::from_value(value.clone()).unwrap()
}

fn matrix(value: &Value) -> DMatrix<f64> {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn tenth() -> Discrete {
    Discrete::new(0.1).unwrap()
}

#[test]
fn the_plant_is_that_of_appendix_b() {
    let golden = golden();
    let plant = SeatedBalance::chapter_five().plant(&SeatedBalance::chapter_five().nominal());
    let (a, b) = (matrix(&golden["plant_a"]), matrix(&golden["plant_b"]));
    assert!((&plant.a - &a).amax() < 1e-13 * a.amax());
    let both = DMatrix::from_columns(&[plant.e.column(0), plant.b.column(0)]);
    assert!((both - b).amax() < 1e-14);
}

/// The entries of appendix B as printed, with one common denominator J₁·J₂ + …
#[test]
fn the_plant_is_that_of_the_printed_entries_for_random_parameters() {
    let mut random = rng::stream(41, "seated balance");
    for _ in 0..50 {
        let mut values = Values::table_5_1();
        for parameter in Parameter::ALL {
            values = values.with(parameter, parameter.nominal() * (0.5 + random.random::<f64>()));
        }
        let model = SeatedBalance::new(Structure::default(), values, Vec::new()).unwrap();
        let plant = model.plant::<f64>(&[]);
        let v = |name: &str| values.get(Parameter::by_name(name).unwrap());
        let (j1, j2, m1, m2, l1, l12, l2) = (v("j1"), v("j2"), v("m1"), v("m2"), v("l1"), v("l12"), v("l2"));
        let (kh, ch, kr, cr, g) = (v("k_h"), v("c_h"), v("k_r"), v("c_r"), v("g"));
        let den = m1 * m2 * l1 * l1 * l2 * l2 + j2 * m1 * l1 * l1 + j2 * m2 * l12 * l12 + j1 * m2 * l2 * l2 + j1 * j2;
        let printed = [
            (
                (1, 0),
                -(j2 * kh + j2 * kr + m2 * kh * l2 * l2 + m2 * kr * l2 * l2
                    - m2 * m2 * g * l12 * l2 * l2
                    - j2 * m1 * g * l1
                    - j2 * m2 * g * l12
                    + m2 * kh * l12 * l2
                    - m1 * m2 * g * l1 * l2 * l2),
            ),
            ((1, 1), -(j2 * ch + j2 * cr + m2 * ch * l2 * l2 + m2 * cr * l2 * l2 + m2 * ch * l12 * l2)),
            ((1, 2), -g * l12 * m2 * m2 * l2 * l2 + kh * m2 * l2 * l2 + kh * l12 * m2 * l2 + j2 * kh),
            ((1, 3), m2 * ch * l2 * l2 + m2 * ch * l12 * l2 + j2 * ch),
            (
                (3, 0),
                j1 * kh + m1 * kh * l1 * l1 + m2 * kh * l12 * l12 - m2 * m2 * g * l12 * l12 * l2
                    + m2 * kh * l12 * l2
                    + m2 * kr * l12 * l2
                    - m1 * m2 * g * l1 * l12 * l2,
            ),
            ((3, 1), j1 * ch + m1 * ch * l1 * l1 + m2 * ch * l12 * l12 + m2 * ch * l12 * l2 + m2 * cr * l12 * l2),
            (
                (3, 2),
                -(-g * l2 * m2 * m2 * l12 * l12 - m1 * g * l2 * m2 * l1 * l1
                    + kh * m2 * l12 * l12
                    + kh * l2 * m2 * l12
                    - j1 * g * l2 * m2
                    + m1 * kh * l1 * l1
                    + j1 * kh),
            ),
            ((3, 3), -(m1 * ch * l1 * l1 + m2 * ch * l12 * l12 + m2 * ch * l2 * l12 + j1 * ch)),
        ];
        for ((i, j), numerator) in printed {
            let scale = plant.a.amax();
            assert!((plant.a[(i, j)] - numerator / den).abs() < 1e-13 * scale, "A[{i},{j}]");
        }
        let control = [-(m2 * l2 * l2 + m2 * l12 * l2 + j2), m1 * l1 * l1 + m2 * l12 * l12 + m2 * l2 * l12 + j1];
        assert!(
            (plant.b[(1, 0)] - control[0] / den).abs() < 1e-13 && (plant.b[(3, 0)] - control[1] / den).abs() < 1e-13
        );
        let seat = [m2 * l2 * l2 + j2, -(m2 * l12 * l2)];
        assert!((plant.e[(1, 0)] - seat[0] / den).abs() < 1e-13 && (plant.e[(3, 0)] - seat[1] / den).abs() < 1e-13);

        let (a, e, b) = nonlinear::linearise(&values, [0.0; 4], 0.0, 0.0);
        assert!((&plant.a - a).amax() < 1e-13 * plant.a.amax(), "(5.1) and (5.2), linearised");
        assert!((plant.e.column(0) - DVector::from_row_slice(&e)).amax() < 1e-14);
        assert!((plant.b.column(0) - DVector::from_row_slice(&b)).amax() < 1e-14);
    }
}

#[test]
fn the_loop_has_the_poles_of_the_reference() {
    let golden = golden();
    let model = SeatedBalance::chapter_five();
    let mut poles = model.closed_loop().unwrap().poles().unwrap();
    let mut expected: Vec<Vec<f64>> = serde_json::from_value(golden["poles"].clone()).unwrap();
    assert_eq!(poles.len(), 10);
    poles.sort_by(|x, y| x.re.total_cmp(&y.re).then(x.im.total_cmp(&y.im)));
    expected.sort_by(|x, y| x[0].total_cmp(&y[0]).then(x[1].total_cmp(&y[1])));
    let wrong = poles.iter().filter(|p| {
        let nearest = expected.iter().map(|e| (p.re - e[0]).hypot(p.im - e[1])).fold(f64::INFINITY, f64::min);
        nearest > 1e-8 * p.norm()
    });
    assert_eq!(wrong.count(), 0, "{poles:?}");
    let sampled = model.realise(&model.nominal()).unwrap().sampled(tenth()).unwrap();
    let radius = sampled.model.poles().unwrap().iter().map(|p| p.norm()).fold(0.0, f64::max);
    assert!((radius - golden["spectral_radius"].as_f64().unwrap()).abs() < 1e-9, "{radius}");
}

fn watched(outputs: Vec<Output>) -> SeatedBalance {
    let structure = Structure { outputs, ..Structure::default() };
    SeatedBalance::new(structure, Values::table_5_1(), Parameter::ALL[..11].to_vec()).unwrap()
}

#[test]
fn markov_parameters_and_free_response_are_those_of_the_reference() {
    let golden = golden();
    let model = watched(vec![Output::LowerAngle, Output::UpperAngle, Output::Torque]);
    let mut impulse = DMatrix::zeros(11, 1);
    impulse[(0, 0)] = 1.0;
    let sampled = model.realise(&model.nominal()).unwrap().sampled(tenth()).unwrap();
    let forced = sampled.respond(&impulse).unwrap();
    let resting = model.starting_from([0.01, 0.0, 0.0, 0.0]).unwrap();
    let free = resting.realise(&resting.nominal()).unwrap().sampled(tenth()).unwrap();
    let free = free.respond(&DMatrix::zeros(11, 1)).unwrap();
    for (column, name) in ["a1", "a2", "uh"].into_iter().enumerate() {
        for (part, found) in [("markov", &forced), ("free_from_lower_angle_0_01", &free)] {
            let expected = list(&golden[part][name]);
            let size = expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            for (k, value) in expected.iter().enumerate() {
                assert!((found[(k + 1, column)] - value).abs() < 1e-8 * size, "{part} {name} {k}");
            }
        }
    }
}

/// The diagonal of the Fisher information of the reference's PRBS, whose derivatives came from complex steps.
#[test]
fn sensitivities_are_those_of_the_reference() {
    let golden = golden();
    let model = SeatedBalance::chapter_five().starting_from([0.01, 0.0, 0.0, 0.0]).unwrap();
    let sampled = model.differentiate(&model.nominal()).unwrap().sampled(tenth()).unwrap();
    let u = list(&golden["prbs"]["u0"]);
    // y₁ … y_N: the last sample needs no input of its own.
    let input = DMatrix::from_fn(u.len() + 1, 1, |i, _| u.get(i).copied().unwrap_or(0.0));
    let found = sampled.respond(&input).unwrap();
    let names = ["K1", "K2", "K3", "K4", "J1", "J2", "l1", "l12", "l2", "tau", "Tw"];
    for (slope, name) in found.slopes.iter().zip(names) {
        let expected = golden["fisher_diagonal_of_prbs"][name].as_f64().unwrap();
        let information = slope.rows(1, u.len()).norm_squared();
        assert!((information / expected - 1.0).abs() < 1e-6, "{name}: {information} {expected}");
    }
}

#[test]
fn derivatives_agree_with_differences_of_high_order() {
    let model = watched(vec![Output::Bend, Output::Torque, Output::LowerRate]);
    let theta = model.nominal();
    let mut random = rng::stream(42, "input");
    let input = DMatrix::from_fn(200, 1, |_, _| 12.0 * (random.random::<f64>() - 0.5));
    let exact = model.differentiate(&theta).unwrap().sampled(tenth()).unwrap().respond(&input).unwrap();
    for i in 0..theta.len() {
        let step = 1e-3 * f64::max(theta[i].abs(), 0.1);
        let at = |steps: f64| {
            let mut moved = theta.clone();
            moved[i] += steps * step;
            model.realise(&moved).unwrap().sampled(tenth()).unwrap().respond(&input).unwrap()
        };
        let pair = |steps: f64| at(steps) - at(-steps);
        let quotient = (pair(1.0) * 45.0 - pair(2.0) * 9.0 + pair(3.0)) / (60.0 * step);
        let error = (&quotient - &exact.slopes[i]).norm() / exact.slopes[i].norm();
        // The quotient loses about three digits to rounding.
        assert!(error < 1e-7, "{}: {error:.1e}", model.names()[i]);
    }
}

#[test]
fn nothing_is_lost_without_damping() {
    let values = [("c_h", 0.0), ("c_r", 0.0)]
        .into_iter()
        .fold(Values::table_5_1(), |values, (name, value)| values.with(Parameter::by_name(name).unwrap(), value));
    let mut z = [0.3, -0.4, -0.2, 0.5];
    let before = nonlinear::energy(&values, z);
    let (k_r, step) = (100.0, 1e-4);
    let slope = |z: [f64; 4]| nonlinear::rate(&values, z, -k_r * z[0], 0.0);
    let moved = |z: [f64; 4], by: f64, s: [f64; 4]| std::array::from_fn(|i| z[i] + by * s[i]);
    for _ in 0..10_000 {
        let k1 = slope(z);
        let k2 = slope(moved(z, 0.5 * step, k1));
        let k3 = slope(moved(z, 0.5 * step, k2));
        let k4 = slope(moved(z, step, k3));
        z = std::array::from_fn(|i| z[i] + step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
    }
    let after = nonlinear::energy(&values, z);
    assert!((after - before).abs() < 1e-9 * before.abs(), "{before} {after}");
    assert!((z[0] - 0.3).abs() > 0.1, "it moved: {z:?}");
}

#[test]
fn small_motions_are_linear_and_large_ones_are_not() {
    let model = watched(vec![Output::LowerAngle, Output::UpperAngle, Output::Torque]);
    let theta = model.nominal();
    let sampled = model.realise(&theta).unwrap().sampled(tenth()).unwrap();
    let difference = |size: f64| {
        let input = DMatrix::from_fn(60, 1, |k, _| if (k / 7) % 2 == 0 { size } else { -size });
        let linear = sampled.respond(&input).unwrap();
        let nonlinear = model.simulate_nonlinear(&theta, &input, tenth(), 200).unwrap();
        (&linear - nonlinear).norm() / linear.norm()
    };
    // The first nonlinear terms are of third order.
    let (small, large) = (difference(0.06), difference(6.0));
    assert!(small < 1e-4 && large > 1e-2, "{small:.1e} {large:.1e}");
    let ratio = difference(0.6) / difference(0.06);
    assert!((80.0..120.0).contains(&ratio), "{ratio}");
}

#[test]
fn the_seat_of_chapter_three_is_turned_by_its_angle() {
    let values = [("k_b", 29580.0), ("c_b", 8090.0), ("k1", -1.8e5), ("k2", -5573.0), ("k3", 2.295e5), ("k4", 7.37e4)]
        .into_iter()
        .fold(Values::table_5_1(), |values, (name, value)| values.with(Parameter::by_name(name).unwrap(), value));
    let free = ["k_b", "c_b"].map(|name| Parameter::by_name(name).unwrap()).to_vec();
    let model = SeatedBalance::new(Structure::chapter_three(), values, free).unwrap();
    let plant = model.plant(&model.nominal());
    let torque =
        SeatedBalance::new(Structure { drive: Drive::Torque, ..Structure::chapter_three() }, values, Vec::new());
    let per_torque = torque.unwrap().plant::<f64>(&[]).e;
    assert!((plant.e.column(0) - per_torque.column(0) * 29580.0).amax() < 1e-10 * plant.e.amax());
    assert!((plant.e.column(1) - per_torque.column(0) * 8090.0).amax() < 1e-10 * plant.e.amax());
    let closed = model.closed_loop().unwrap();
    assert_eq!((closed.states(), closed.inputs(), closed.outputs()), (4, 2, 4));
    assert!(closed.poles().unwrap().iter().all(|p| p.re < 0.0), "the gains of Table 3.2 hold the person upright");
    assert_eq!(
        closed,
        StateSpace::new(&plant.a - &plant.b * model.gain(&model.nominal()), plant.e, plant.c, plant.f, closed.time())
            .unwrap()
    );
}

#[test]
fn what_is_no_model_is_named() {
    let new = |structure, values, free| SeatedBalance::new(structure, values, free).unwrap_err();
    let table = Values::table_5_1();
    let name = |name: &str| Parameter::by_name(name).unwrap();
    let error = new(Structure::default(), table.with(name("j2"), -1.0), Vec::new());
    assert!(matches!(error, SeatedBalanceError::Value { name: "j2", .. }), "{error}");
    let error = new(Structure::default(), table.with(name("tau"), 0.0), Vec::new());
    assert!(matches!(error, SeatedBalanceError::Value { name: "tau", .. }), "{error}");
    let error = new(Structure::default(), table.with(name("l1"), f64::NAN), Vec::new());
    assert!(matches!(error, SeatedBalanceError::Value { name: "l1", .. }), "{error}");
    let error = new(Structure::chapter_three(), table, vec![name("tau")]);
    assert!(matches!(error, SeatedBalanceError::Free { name: "tau", .. }), "{error}");
    let error = new(Structure::default(), table, vec![name("k1"), name("k1")]);
    assert!(matches!(error, SeatedBalanceError::Free { name: "k1", .. }), "{error}");
    let error = new(Structure { outputs: Vec::new(), ..Structure::default() }, table, Vec::new());
    assert_eq!(error, SeatedBalanceError::NoOutput);
    let error = new(Structure { delay_order: 99, ..Structure::default() }, table, Vec::new());
    assert_eq!(error, SeatedBalanceError::DelayOrder { order: 99 });
    assert!(Parameter::by_name("k9").is_none());
    let model = SeatedBalance::chapter_five();
    assert!(matches!(model.realise(&[1.0]), Err(ParametricError::Count { found: 1, expected: 11 })));
    let mut theta = model.nominal();
    theta[9] = -1.0;
    assert!(matches!(model.differentiate(&theta), Err(ParametricError::Parameter { name, .. }) if name == "tau"));
    assert_eq!(model.starting_from([f64::NAN, 0.0, 0.0, 0.0]).unwrap_err(), SeatedBalanceError::Initial);
}

#[test]
fn the_catalogue_knows_it() {
    use volition::plants::ParametricPlant;
    for plant in ParametricPlant::ALL {
        assert_eq!(ParametricPlant::by_name(plant.name()), Some(plant));
        assert_eq!(serde_json::to_value(plant).unwrap(), plant.name());
    }
    for parameter in Parameter::ALL {
        assert_eq!(Parameter::by_name(parameter.name()), Some(parameter));
        assert_eq!(serde_json::to_value(parameter).unwrap(), parameter.name());
        assert!(!parameter.unit().is_empty());
    }
    assert_eq!(ParametricPlant::by_name("two_mass"), None);
}
