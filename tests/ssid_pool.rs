//! Counts of the published candidate pools.
#![allow(clippy::unwrap_used, missing_docs)]

use volition::control::{Continuous, System, TransferFunction};
use volition::identify::pool::{Degrees, PoolName, PoolSpec};
use volition::num::Ctl;

fn two_mass() -> System {
    let pi = std::f64::consts::PI;
    let (m1, m2, c1, c2, k1, k2) = (1.0, 0.5, 0.56 * pi, 0.5 * pi, 0.16 * pi * pi, 0.5 * pi * pi);
    let num = [m1, c1 + c2, k1 + k2];
    let den = [m1 * m2, m1 * c2 + c1 * m2 + m2 * c2, m1 * k2 + c1 * c2 + k1 * m2 + m2 * k2, c1 * k2 + k1 * c2, k1 * k2];
    System::Continuous(TransferFunction::new(&num, &den, Continuous).unwrap())
}

fn golden() -> serde_json::Value {
    serde_json::from_str(include_str!("golden/ssid_pools.json")).unwrap()
}

/// Condition C5 is strict: a pole at exactly −0.1 is not in the pool. 3,359 feedback controllers with a gain lie
/// exactly there (a zero at −0.1 cancels a pole at −0.1); floating point let 405 of them into the count of the reference.
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
    let let_in = count("M_fb_reference") - feedback;
    assert!(let_in < on_boundary, "{let_in} of {on_boundary}");
    assert_eq!(count("M_ff") * count("M_fb_reference"), count("M_reference"));
}
