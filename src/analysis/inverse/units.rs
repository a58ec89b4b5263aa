//! The units of weights.
//!
//! A cost is free up to its scale. On the scale on which R has the mean eigenvalue 1 the cost counts in squares of the
//! input's unit, so that `Q_ij` is in `[u]²/([x_i][x_j])`; of a filter W and V are noise intensities, `[x_i][x_j]/s`
//! and `[y]² s` in continuous time and covariances in sampled time, and with V of the mean eigenvalue 1 `W_ij` is in
//! `[x_i][x_j]/([y]² s²)`, or `[x_i][x_j]/[y]²`. Inputs (outputs) of several units leave the scale a unit of its own,
//! `cost` (`noise`).

/// Whether one of these stands outside of all parentheses.
fn has_outside(unit: &str, symbols: &[char]) -> bool {
    let mut depth = 0;
    unit.chars().any(|c| {
        match c {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ => {}
        }
        depth == 0 && symbols.contains(&c)
    })
}

/// A product, quotient or power within a unit is held together by parentheses.
fn held(unit: &str) -> String {
    if has_outside(unit, &[' ', '/', '·', '*', '^', '²']) { format!("({unit})") } else { unit.to_owned() }
}

fn is_one(unit: &str) -> bool {
    unit.is_empty() || unit == "1"
}

/// `[a][b]`; empty for a number.
fn product(a: &str, b: &str) -> String {
    match (is_one(a), is_one(b)) {
        (true, true) => String::new(),
        (false, true) => a.to_owned(),
        (true, false) => b.to_owned(),
        (false, false) if a == b => format!("{}²", held(a)),
        (false, false) => format!("{}·{}", held(a), held(b)),
    }
}

/// `[a]/[b]`, `1` for a number.
fn quotient(a: &str, b: &str) -> String {
    match (is_one(a), is_one(b)) {
        (true, true) => "1".to_owned(),
        (false, true) => a.to_owned(),
        (one, false) => {
            let below = if has_outside(b, &[' ', '/', '·', '*']) { format!("({b})") } else { b.to_owned() };
            format!("{}/{below}", if one { "1" } else { a })
        }
    }
}

/// The unit that all share, if they do.
fn common(units: &[String]) -> Option<&String> {
    units.first().filter(|first| units.iter().all(|unit| unit == *first))
}

/// The units of the entries of Q and R on the scale on which R has the mean eigenvalue 1.
pub(super) fn of_cost(states: &[String], inputs: &[String]) -> [Vec<Vec<String>>; 2] {
    let scale = common(inputs).map_or_else(|| "cost".to_owned(), |unit| product(unit, unit));
    let table = |units: &[String]| {
        let entry = |a: &String, b: &String| quotient(&scale, &product(a, b));
        units.iter().map(|a| units.iter().map(|b| entry(a, b)).collect()).collect()
    };
    let of_inputs =
        if common(inputs).is_some() { vec![vec!["1".to_owned(); inputs.len()]; inputs.len()] } else { table(inputs) };
    [table(states), of_inputs]
}

/// The units of the entries of W and V on the scale on which V has the mean eigenvalue 1.
pub(super) fn of_noise(states: &[String], outputs: &[String], is_continuous: bool) -> [Vec<Vec<String>>; 2] {
    let scale = common(outputs).map(|unit| {
        let square = product(unit, unit);
        match (is_continuous, is_one(&square)) {
            (true, true) => "s²".to_owned(),
            (true, false) => format!("{square}·s²"),
            (false, _) => square,
        }
    });
    let table = |units: &[String], density: &str| {
        let entry = |a: &String, b: &String| {
            let above = product(a, b);
            let own =
                || format!("{}{density}", if is_one(&above) { "noise".to_owned() } else { format!("noise·{above}") });
            scale.as_ref().map_or_else(own, |scale| quotient(&above, scale))
        };
        units.iter().map(|a| units.iter().map(|b| entry(a, b)).collect()).collect()
    };
    let [of_process, of_measurement] = if is_continuous { ["/s", "·s"] } else { [""; 2] };
    let of_outputs = match scale {
        Some(_) => vec![vec!["1".to_owned(); outputs.len()]; outputs.len()],
        None => table(outputs, of_measurement),
    };
    [table(states, of_process), of_outputs]
}

/// The units of what a state is worth: input per state.
pub(super) fn of_equivalents(states: &[String], inputs: &[String]) -> Vec<String> {
    let input = common(inputs).map_or("√cost", String::as_str);
    states
        .iter()
        .map(|state| quotient(&if is_one(input) { String::new() } else { held(input) }, &held(state)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(units: &[&str]) -> Vec<String> {
        units.iter().map(|u| (*u).to_owned()).collect()
    }

    #[test]
    fn a_cost_counts_in_squares_of_the_input() {
        let [q, r] = of_cost(&list(&["rad", "rad/s", "1"]), &list(&["N m"]));
        assert_eq!(q[0], ["(N m)²/rad²", "(N m)²/(rad·(rad/s))", "(N m)²/rad"]);
        assert_eq!(q[1][1], "(N m)²/(rad/s)²");
        assert_eq!(q[2][2], "(N m)²");
        assert_eq!(r, [["1"]]);
        assert_eq!(of_equivalents(&list(&["rad", "rad/s"]), &list(&["N m"])), ["(N m)/rad", "(N m)/(rad/s)"]);
    }

    #[test]
    fn inputs_of_several_units_leave_the_scale_its_own() {
        let [q, r] = of_cost(&list(&["m"]), &list(&["N", "V"]));
        assert_eq!(q, [["cost/m²"]]);
        assert_eq!(r, [["cost/N²", "cost/(N·V)"], ["cost/(V·N)", "cost/V²"]]);
    }

    #[test]
    fn noise_in_continuous_time_is_an_intensity() {
        let states = list(&["m", "m/s"]);
        let [w, v] = of_noise(&states, &list(&["m"]), true);
        assert_eq!(w[1], ["(m/s)·m/(m²·s²)", "(m/s)²/(m²·s²)"]);
        assert_eq!(v, [["1"]]);
        let [w, _] = of_noise(&states, &list(&["m"]), false);
        assert_eq!(w[1][1], "(m/s)²/m²");
        let [w, v] = of_noise(&list(&["1"]), &list(&["1"]), true);
        assert_eq!((w[0][0].as_str(), v[0][0].as_str()), ("1/s²", "1"));
        let [w, v] = of_noise(&states, &list(&["m", "rad"]), true);
        assert_eq!((w[0][0].as_str(), v[0][1].as_str()), ("noise·m²/s", "noise·m·rad·s"));
        assert_eq!(of_equivalents(&list(&["N·m"]), &list(&["1"])), ["1/(N·m)"]);
    }
}
