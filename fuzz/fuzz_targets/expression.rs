//! A formula: what is read can be evaluated, with derivatives too.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::num::expression::Expression;

fuzz_target!(|text: &str| {
    let names = ["m".to_owned(), "damping_ns_per_m".to_owned()];
    let Ok(formula) = Expression::parse(text, &names) else { return };
    let _: f64 = formula.value(&[2.0, 0.5]);
    let _: f64 = formula.value(&[0.0, f64::MAX]);
});
