//! Where the search for a fit starts.

use super::cost::{Cost, inside};
use crate::num::{linalg, rng};
use crate::two_stimulus::controllers::{LineControllers, controllers};
use crate::two_stimulus::responses::LineResponse;
use crate::two_stimulus::structure::{FeedbackLaw, FeedforwardLaw, Person, RationalLaw};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;

/// A start with a stable loop: from typical values for the first, scattered around them for the others; numerators of
/// rational laws by linear least squares on the estimates without structure.
pub(super) fn first_guess(cost: &Cost<'_>, responses: &[LineResponse], seed: u64, start: usize) -> Option<Vec<f64>> {
    let person = cost.person;
    let mut stream = rng::stream(seed, &format!("start {start} of a two-stimulus fit"));
    let mut scatter = |deviation: f64| -> f64 {
        let normal: f64 = stream.sample(StandardNormal);
        if start == 0 { 0.0 } else { deviation * normal }
    };
    let estimated = controllers(responses);
    let collect = |pick: &dyn Fn(&LineControllers) -> Option<Complex64>| -> Vec<(f64, Complex64)> {
        estimated.lines.iter().filter_map(|line| Some((line.response.omega_rad_s, pick(line)?))).collect()
    };
    let feedback = collect(&|line| line.feedback.filter(|f| !f.interpolated).map(|f| f.value));
    let feedforward = collect(&|line| line.feedforward.map(|f| f.value));
    let mut sizes: Vec<f64> = feedback.iter().map(|(_, g)| g.norm()).collect();
    sizes.sort_by(f64::total_cmp);
    let typical = sizes.get(sizes.len() / 2).copied().unwrap_or(1.0);
    // The lowest line has the least delay.
    let sign = feedback.first().map_or(1.0, |(_, g)| if g.re < -0.5 * g.norm() { -1.0 } else { 1.0 });
    let unit = 1.0 / person.scale_rad_s();
    let mut values: Vec<f64> = Vec::new();
    for parameter in person.parameters() {
        let factor = scatter(0.7).exp();
        let value = match parameter.name.as_str() {
            "feedback_gain" => sign * typical * factor,
            "feedforward_gain" => 0.5 * factor,
            "feedback_lead_s" => 0.3 * unit * factor,
            "feedback_lag_s" => 0.2 * unit * factor,
            "feedforward_lag_s" | "neuromuscular_lag_s" => 0.1 * unit * factor,
            "neuromuscular_frequency_rad_s" => 4.0 / unit * factor,
            "neuromuscular_damping" => 0.5 * factor,
            name if name.ends_with("_delay_s") => {
                // A look ahead is where a fit may go, not where it starts.
                let [low, high] = [parameter.range[0].max(0.0), parameter.range[1]];
                (low + (high - low) * 0.25 * factor).min(low + 0.95 * (high - low))
            }
            name if name.contains("_denominator_") => factor * factor,
            _ => 0.0,
        };
        let [low, high] = parameter.range;
        values.push(value.clamp(low, high));
    }
    for (prefix, law, data) in rational_laws(person, &feedback, &feedforward) {
        fill_numerator(person, prefix, law, data, &mut values);
    }
    // A smaller loop gain is stable sooner.
    for _ in 0..40 {
        if person.is_stable(&values) {
            let x: Vec<f64> = person.parameters().iter().zip(&values).map(|(p, v)| inside(p, *v)).collect();
            return Some(x);
        }
        for (parameter, value) in person.parameters().iter().zip(values.iter_mut()) {
            if parameter.name == "feedback_gain" || parameter.name.starts_with("feedback_numerator_") {
                *value *= 0.7;
            }
        }
    }
    None
}

type Samples = Vec<(f64, Complex64)>;

fn rational_laws<'a>(
    person: &Person,
    feedback: &'a Samples,
    feedforward: &'a Samples,
) -> Vec<(&'static str, RationalLaw, &'a Samples)> {
    let mut laws = Vec::new();
    if let FeedbackLaw::Rational(law) = person.structure().feedback {
        laws.push(("feedback", law, feedback));
    }
    if let FeedforwardLaw::Rational(law) = person.structure().feedforward {
        laws.push(("feedforward", law, feedforward));
    }
    laws
}

/// The numerator that comes nearest to the data for the denominator and delay at hand; each numerator coefficient
/// enters linearly.
fn fill_numerator(person: &Person, prefix: &str, law: RationalLaw, data: &Samples, values: &mut [f64]) {
    let name = format!("{prefix}_numerator_0");
    let Some(first) = person.parameters().iter().position(|p| p.name == name) else { return };
    let count = law.numerator_degree + 1;
    let columns: Vec<Vec<Complex64>> = (0..count)
        .map(|i| {
            let mut unit = values.to_vec();
            unit[first..first + count].fill(0.0);
            unit[first + i] = 1.0;
            data.iter()
                .map(|(omega, _)| {
                    let response = person.response(&unit, *omega);
                    if prefix == "feedback" { response.feedback } else { response.feedforward }
                })
                .collect()
        })
        .collect();
    let rows = data.len();
    let part = |z: Complex64, i: usize| if i < rows { z.re } else { z.im };
    // Relative errors: every line tells as much.
    let a = DMatrix::from_fn(2 * rows, count, |i, j| part(columns[j][i % rows] / data[i % rows].1.norm(), i));
    let b = DVector::from_fn(2 * rows, |i, _| part(data[i % rows].1 / data[i % rows].1.norm(), i));
    if let Some((solution, _)) = linalg::least_squares(&a, &b) {
        values[first..first + count].copy_from_slice(solution.as_slice());
    } else {
        values[first] = data.first().map_or(1.0, |(_, g)| g.norm());
    }
}
