//! The coefficients of the refined controllers with their deviations.

use super::super::projection::{Point, Unknown};
use super::super::refinement::Refinement;
use super::super::variable;
use super::{Linearised, Parameter, Unavailable};
use nalgebra::{DVector, RowDVector};

impl Refinement<'_> {
    /// Coefficients in powers of s or z, which are linear in β and φ, and their covariance where all have deviations.
    pub(super) fn parameters(
        &self,
        point: &Point,
        linearised: &Linearised,
        general: Option<Unavailable>,
    ) -> (Vec<Parameter>, Option<Vec<Vec<f64>>>) {
        let (projection, beta) = (&self.projection, point.beta.len());
        let (layout, variable) = (&projection.layout, &projection.variable);
        let size = beta + projection.unknowns.len();
        // Rows of the linear map, with the constant part.
        let mut rows: Vec<(String, RowDVector<f64>, f64)> = Vec::new();
        let numerator_degree = self.setup.structure.feedforward_numerator;
        let mut numerators = vec![RowDVector::zeros(size); numerator_degree + 1];
        let even = projection.problem.basis().even().len();
        for i in 0..beta {
            let mut unit = vec![0.0; beta];
            unit[i] = 1.0;
            let coefficients = projection.problem.basis().numerator(&unit[..even], &unit[even..]);
            for (row, c) in numerators.iter_mut().zip(coefficients) {
                row[i] = c;
            }
        }
        if beta == 0 {
            // A feedforward that is held at zero has no coefficients.
            numerators.clear();
        }
        rows.extend(
            numerators.into_iter().enumerate().map(|(i, row)| (format!("feedforward_numerator[{i}]"), row, 0.0)),
        );
        let mut polynomial =
            |name: &str, degree: usize, is_monic: bool, power_of: fn(Unknown) -> Option<usize>, unit: f64| {
                let mut own = vec![RowDVector::zeros(size); degree + 1];
                let add = |descending: Vec<f64>, to: &mut dyn FnMut(usize, f64)| {
                    let offset = degree + 1 - descending.len();
                    descending.iter().enumerate().for_each(|(i, c)| to(offset + i, c * unit));
                };
                let mut constants = vec![0.0; degree + 1];
                if is_monic {
                    add(variable.leave(&variable::power(degree)), &mut |i, c| constants[i] = c);
                }
                for (j, unknown) in projection.unknowns.iter().enumerate() {
                    if let Some(power) = power_of(*unknown) {
                        add(variable.leave(&variable::power(power)), &mut |i, c| own[i][beta + j] = c);
                    }
                }
                for (i, (row, constant)) in own.into_iter().zip(constants).enumerate().skip(usize::from(is_monic)) {
                    rows.push((format!("{name}[{i}]"), row, constant));
                }
            };
        let unit = |degree: usize| variable.unit.powi(degree as i32);
        if layout.feedforward_is_free {
            let degree = layout.feedforward_degree;
            polynomial("feedforward_denominator", degree, true, Unknown::feedforward_denominator, unit(degree));
        }
        let degree = layout.feedback_denominator;
        let numerator = layout.feedback_numerator;
        if layout.has_feedback {
            polynomial("feedback_numerator", numerator, false, Unknown::feedback_numerator, unit(degree));
            polynomial("feedback_denominator", degree, true, Unknown::feedback_denominator, unit(degree));
        }
        for (j, unknown) in projection.unknowns.iter().enumerate() {
            let name = match unknown {
                Unknown::FeedbackDelay => "feedback_delay_s",
                Unknown::FeedforwardDelay => "feedforward_delay_s",
                _ => continue,
            };
            let mut row = RowDVector::zeros(size);
            row[beta + j] = 1.0 / variable.omega;
            rows.push((name.to_owned(), row, 0.0));
        }
        let theta = DVector::from_iterator(size, point.beta.iter().chain(&self.minimum.x).copied());
        let gradients: Vec<DVector<f64>> = rows.iter().map(|(_, row, _)| row.transpose()).collect();
        let parameters: Vec<Parameter> = rows
            .into_iter()
            .map(|(name, row, constant)| {
                let value = (&row * &theta)[0] + constant;
                let found = general.map_or_else(|| linearised.deviation(&row.transpose()), Err);
                let (standard_deviation, interval, unavailable) = match found {
                    Ok(d) => {
                        let half = d.standard * d.quantile;
                        (Some(d.standard), Some([value - half, value + half]), None)
                    }
                    Err(why) => (None, None, Some(why)),
                };
                Parameter { name, value, standard_deviation, interval, unavailable }
            })
            .collect();
        let has_all = parameters.iter().all(|own| own.standard_deviation.is_some());
        let covariance = has_all.then(|| linearised.covariance(&gradients));
        (parameters, covariance)
    }
}
