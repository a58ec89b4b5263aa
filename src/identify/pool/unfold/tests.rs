use super::*;
use serde_json::json;

fn spec(value: serde_json::Value) -> PoolSpec {
    serde_json::from_value(value).unwrap()
}

#[test]
fn a_range_holds_the_decimals_that_it_says() {
    let axis: Axis = serde_json::from_value(json!({"from": -8, "to": 8, "step": 0.1})).unwrap();
    let values = axis.values("x").unwrap();
    assert_eq!(values.len(), 161);
    for v in [-8.0, -0.1, 0.0, 5.4, 6.5, 7.1, 8.0] {
        assert!(values.contains(&v), "{v}");
    }
    let axis: Axis = serde_json::from_value(json!({"from": 0, "to": 1, "count": 4})).unwrap();
    assert_eq!(axis.values("x").unwrap(), [0.0, 0.333333333333, 0.666666666667, 1.0]);
}

#[test]
fn repeats_are_dropped() {
    let axis: Axis = serde_json::from_value(json!([1.0, 0.0, -0.0, 1.0, 2.0])).unwrap();
    assert_eq!(axis.values("x").unwrap(), [1.0, 0.0, 2.0]);
}

#[test]
fn errors_name_the_field() {
    let text = |value| serde_json::from_value::<PoolSpec>(value).unwrap_err().to_string();
    assert!(text(json!("zhang")).contains("zhang2015_appendix_b"));
    assert!(text(json!({"name": "zhang2015_appendix_b", "thn": {}})).contains("thn"));
    assert!(text(json!({"thin": {}})).contains("`grid`"));
    assert!(text(json!({"grid": {"feedback_numerator": [{"from": 1, "too": 2}]}})).contains("too"));
    let error =
        spec(json!({"grid": {"feedback_numerator": [{"from": 1, "to": 2, "step": -1}]}})).check(Degrees::default());
    assert_eq!(error.unwrap_err().field, "pool/grid/feedback_numerator/0");
    let error = spec(json!({"name": "zhang2015_appendix_b", "thin": {"zeros": 0}})).check(Degrees::default());
    assert_eq!(error.unwrap_err().field, "pool/thin/zeros");
}

#[test]
fn too_large_a_grid_is_refused_before_it_is_unfolded() {
    let axis = json!({"from": 0, "to": 1, "count": 1_000_000});
    let pool = spec(json!({"grid": {"feedback_numerator": [axis.clone(), axis.clone(), axis]}}));
    let error = pool.check(Degrees::default()).unwrap_err();
    assert!(error.too_large && error.message.contains("1000000000000000000"), "{error}");
    let pool = spec(json!({"grid": {"feedback_numerator": [{"from": 0, "to": 1, "step": 1e-300}]}}));
    assert!(pool.check(Degrees::default()).unwrap_err().too_large);
}

#[test]
fn thinning_keeps_the_first_of_each_list_and_zero_gain() {
    let pool =
        spec(json!({"name": "zhang2015_appendix_b", "thin": {"poles": 10, "zeros": 20, "damping": 8, "gains": 5}}));
    let recipe = pool.check(Degrees::default()).unwrap();
    assert!(recipe.zero_gain);
    assert_eq!(recipe.gains.len(), 2 * 46_usize.div_ceil(5));
    assert_eq!(&recipe.gains[..4], [0.1, -0.1, 0.6, -0.6]);
    assert_eq!(recipe.feedback_numerators.len(), 143_usize.div_ceil(20));
    let reals = 143_usize.div_ceil(10);
    let complex = (149_usize.div_ceil(10) - 1) * 41_usize.div_ceil(8);
    // The natural frequency 0 is a double root at zero, which the thinned real list does not hold.
    assert_eq!(recipe.feedback_denominators.len(), reals * (reals + 1) / 2 + complex + 1);
}

#[test]
fn specs_survive_a_round_trip() {
    for value in [
        json!("zhang2015_appendix_c"),
        json!({"name": "zhang2015_appendix_b", "thin": {"poles": 4, "zeros": 2, "damping": 1, "gains": 1}}),
        json!({"grid": {"feedback_numerator": [[1.0, 2.0]], "feedback_denominator": {"listed": [[0.5], [0.25]]}},
            "stability_margin": 0.0}),
    ] {
        let parsed = spec(value.clone());
        assert_eq!(spec(serde_json::to_value(&parsed).unwrap()), parsed);
    }
}
