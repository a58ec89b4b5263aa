//! Fisher information of an experiment, and what makes one experiment better than another.

use super::responses::{Response, Responses};
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A measure of information, which a design makes as large as it can. With `M` the Fisher matrix and `σᵢ` the scale of
/// a parameter:
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "DesignCriterion")]
#[serde(rename_all = "snake_case")]
pub enum Criterion {
    /// `tr M` (Priess 2015, eq. 5.6). It depends on the units of the parameters: the most sensitive ones decide.
    T,
    /// `Σ σᵢ² Mᵢᵢ`: information about relative changes.
    ScaledT,
    /// `log det M`: the volume of the confidence ellipsoid. No scale matters.
    D,
    /// `−tr M⁻¹`: the sum of variances.
    A,
    /// `−Σ (M⁻¹)ᵢᵢ / σᵢ²`: the sum of relative variances.
    ScaledA,
}

impl Criterion {
    /// Whether it needs an invertible matrix.
    #[must_use]
    pub fn needs_inverse(self) -> bool {
        matches!(self, Self::D | Self::A | Self::ScaledA)
    }
}

/// The least eigenvalue of the Fisher matrix with unit diagonal below which a combination of parameters counts as not
/// determined.
pub const UNDETERMINED: f64 = 1e-12;

/// Sensitivities of the measured outputs, whitened and in units of the parameters' scales.
#[derive(Debug, Clone, PartialEq)]
pub struct Information {
    /// `Σ^{−1/2} ∂y/∂θᵢ · σᵢ`, one for each parameter and whitened output.
    slopes: Vec<Vec<Response>>,
    scales: Vec<f64>,
    samples: usize,
}

/// A Fisher matrix, `E[(∂ ln p/∂θ)(∂ ln p/∂θ)ᵀ] = Σ_k (∂y_k/∂θ)ᵀ Σ⁻¹ (∂y_k/∂θ)` (Priess 2015, eq. 5.5).
#[derive(Debug, Clone, PartialEq)]
pub struct Fisher {
    /// In units of the scales: `σᵢ σⱼ Mᵢⱼ`.
    scaled: DMatrix<f64>,
    scales: Vec<f64>,
}

/// A combination of parameters that an experiment does not determine.
#[derive(Debug, Clone, PartialEq)]
pub struct Undetermined {
    /// Its weights on the scaled parameters, of length 1.
    pub weights: Vec<f64>,
    /// The least eigenvalue of the matrix with unit diagonal.
    pub eigenvalue: f64,
}

impl Information {
    /// From responses, the outputs that are measured, the covariance of their noise, and the scale of every parameter.
    ///
    /// `None` where the covariance is not positive definite.
    ///
    /// # Panics
    /// If sizes differ, which is a mistake of the caller.
    #[must_use]
    pub fn new(responses: &Responses, measured: &[usize], covariance: &DMatrix<f64>, scales: &[f64]) -> Option<Self> {
        assert_eq!(covariance.nrows(), measured.len(), "a covariance of the measured outputs");
        assert_eq!(scales.len(), responses.slopes.len(), "a scale for every parameter");
        let white = covariance
            .clone()
            .cholesky()?
            .l()
            .solve_lower_triangular(&DMatrix::identity(measured.len(), measured.len()))?;
        let slopes = responses
            .slopes
            .iter()
            .zip(scales)
            .map(|(of_outputs, scale)| {
                let of_measured: Vec<Response> = measured.iter().map(|o| of_outputs[*o].clone()).collect();
                (0..measured.len())
                    .map(|row| {
                        let weights: Vec<f64> = white.row(row).iter().map(|w| w * scale).collect();
                        Response::combined(&weights, &of_measured)
                    })
                    .collect()
            })
            .collect();
        let samples = responses.outputs.first().map_or(0, Response::samples);
        Some(Self { slopes, scales: scales.to_vec(), samples })
    }

    /// Parameters.
    #[must_use]
    pub fn parameters(&self) -> usize {
        self.scales.len()
    }

    /// Samples, N.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The scaled sensitivities for an input: one column for each parameter, outputs one after the other.
    #[must_use]
    pub fn sensitivities(&self, u: &[f64]) -> DMatrix<f64> {
        self.stacked(|response| response.to(u))
    }

    /// What a change of the input changes of them.
    #[must_use]
    pub fn forced(&self, d: &[f64]) -> DMatrix<f64> {
        self.stacked(|response| response.forced(d))
    }

    fn stacked(&self, of: impl Fn(&Response) -> Vec<f64>) -> DMatrix<f64> {
        let columns: Vec<DVector<f64>> = self
            .slopes
            .iter()
            .map(|outputs| DVector::from_vec(outputs.iter().flat_map(&of).collect::<Vec<f64>>()))
            .collect();
        DMatrix::from_columns(&columns)
    }

    /// The Fisher matrix of an input.
    #[must_use]
    pub fn fisher(&self, u: &[f64]) -> Fisher {
        self.of(&self.sensitivities(u))
    }

    /// The Fisher matrix of sensitivities.
    #[must_use]
    pub fn of(&self, sensitivities: &DMatrix<f64>) -> Fisher {
        Fisher { scaled: sensitivities.tr_mul(sensitivities), scales: self.scales.clone() }
    }

    /// The Fisher matrices along a line: `M₀ + α M₁ + α² M₂` for the input `u + α d`, in units of the scales.
    #[must_use]
    pub fn along(&self, sensitivities: &DMatrix<f64>, change: &DMatrix<f64>) -> [DMatrix<f64>; 3] {
        let cross = sensitivities.tr_mul(change);
        [sensitivities.tr_mul(sensitivities), &cross + cross.transpose(), change.tr_mul(change)]
    }

    /// A Fisher matrix in units of the scales.
    #[must_use]
    pub fn scaled(&self, scaled: DMatrix<f64>) -> Fisher {
        Fisher { scaled, scales: self.scales.clone() }
    }

    /// The gradient of a criterion with respect to the input: `2 Σᵢ Hᵢᵀ (Σⱼ Φᵢⱼ sⱼ)` with `Φ = ∂(criterion)/∂M` and
    /// `sᵢ` the sensitivities.
    ///
    /// `None` where the criterion needs an inverse that does not exist.
    #[must_use]
    pub fn gradient(&self, criterion: Criterion, sensitivities: &DMatrix<f64>) -> Option<DVector<f64>> {
        let weight = self.of(sensitivities).weight(criterion)?;
        let weighted = sensitivities * weight * 2.0;
        let mut gradient = vec![0.0; self.samples];
        for (column, outputs) in weighted.column_iter().zip(&self.slopes) {
            let column: Vec<f64> = column.iter().copied().collect();
            for (part, response) in column.chunks(self.samples).zip(outputs) {
                response.add_adjoint(part, &mut gradient);
            }
        }
        Some(DVector::from_vec(gradient))
    }

    /// What the second order adds to a step's growth of T at most: `M(u + d) = M(u) + (first order) + S(d)ᵀS(d)`
    /// exactly, and with `|d_k| ≤ δ` no sample of a sensitivity is larger than `δ Σ|h|`. `None` of the other criteria,
    /// whose growth is not quadratic.
    #[must_use]
    pub fn second_order_bound(&self, criterion: Criterion, radius: f64) -> Option<f64> {
        let weight = |scale: f64| match criterion {
            Criterion::T => Some(scale.powi(-2)),
            Criterion::ScaledT => Some(1.0),
            Criterion::D | Criterion::A | Criterion::ScaledA => None,
        };
        let mut total = 0.0;
        for (outputs, scale) in self.slopes.iter().zip(&self.scales) {
            for response in outputs {
                let mut sum = 0.0;
                let squares = response.impulse.iter().map(|h| {
                    sum += h.abs();
                    (radius * sum).powi(2)
                });
                total += weight(*scale)? * squares.sum::<f64>();
            }
        }
        Some(total)
    }

    /// The quadratic form `tr M(u) = uᵀFu + 2fᵀu + f₀` of the unscaled trace: F, f and f₀.
    #[must_use]
    pub fn quadratic(&self) -> (DMatrix<f64>, DVector<f64>, f64) {
        let n = self.samples;
        let (mut matrix, mut vector, mut constant) = (DMatrix::zeros(n, n), vec![0.0; n], 0.0);
        for (outputs, scale) in self.slopes.iter().zip(&self.scales) {
            for response in outputs {
                let weight = scale.powi(-2);
                // F_ij = Σ_k h_{k−i} h_{k−j}: along each diagonal a running sum, from the last sample backwards.
                for lag in 0..n {
                    let mut sum = 0.0;
                    for k in 0..n - lag {
                        // i + lag = n − 1 − k is the later of the two samples.
                        sum += weight * response.impulse[k] * response.impulse[k + lag];
                        let i = n - 1 - k - lag;
                        matrix[(i, i + lag)] += sum;
                    }
                }
                let weighted: Vec<f64> = response.free.iter().map(|f| f * weight).collect();
                response.add_adjoint(&weighted, &mut vector);
                constant += response.free.iter().map(|f| weight * f * f).sum::<f64>();
            }
        }
        matrix.fill_lower_triangle_with_upper_triangle();
        (matrix, DVector::from_vec(vector), constant)
    }
}

impl Fisher {
    /// The matrix itself, in the units of the parameters.
    #[must_use]
    pub fn matrix(&self) -> DMatrix<f64> {
        let n = self.scales.len();
        DMatrix::from_fn(n, n, |i, j| self.scaled[(i, j)] / (self.scales[i] * self.scales[j]))
    }

    /// In units of the scales.
    #[must_use]
    pub fn scaled_matrix(&self) -> &DMatrix<f64> {
        &self.scaled
    }

    /// The factor that brings the diagonal to 1; zero where there is no information at all.
    fn unit(&self) -> DVector<f64> {
        self.scaled.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 })
    }

    fn normalised(&self) -> DMatrix<f64> {
        let unit = self.unit();
        DMatrix::from_fn(unit.len(), unit.len(), |i, j| self.scaled[(i, j)] * unit[i] * unit[j])
    }

    /// The combination of parameters that the experiment determines least, if it does not determine it at all.
    #[must_use]
    pub fn undetermined(&self) -> Option<Undetermined> {
        let normalised = self.normalised();
        if normalised.iter().any(|v| !v.is_finite()) {
            return Some(Undetermined { weights: vec![0.0; self.scales.len()], eigenvalue: 0.0 });
        }
        let eigen = normalised.symmetric_eigen();
        let (least, eigenvalue) = eigen.eigenvalues.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
        (eigenvalue < UNDETERMINED).then(|| {
            let unit = self.unit();
            let vector = eigen.eigenvectors.column(least);
            let weights =
                DVector::from_fn(unit.len(), |i, _| if unit[i] > 0.0 { vector[i] * unit[i] } else { vector[i] });
            let length = weights.norm().max(f64::MIN_POSITIVE);
            Undetermined { weights: weights.iter().map(|w| w / length).collect(), eigenvalue }
        })
    }

    /// The ratio of the largest to the least eigenvalue of the matrix with unit diagonal, whatever the units; infinite
    /// for a singular one.
    #[must_use]
    pub fn condition(&self) -> f64 {
        let values = self.normalised().symmetric_eigenvalues();
        if values.min() > 0.0 { values.max() / values.min() } else { f64::INFINITY }
    }

    /// The inverse in units of the scales; `None` where some combination is not determined.
    fn inverse(&self) -> Option<DMatrix<f64>> {
        if self.undetermined().is_some() {
            return None;
        }
        let unit = self.unit();
        let inverse = self.normalised().cholesky()?.inverse();
        Some(DMatrix::from_fn(unit.len(), unit.len(), |i, j| inverse[(i, j)] * unit[i] * unit[j]))
    }

    /// Cramér and Rao's bound of the covariance, `M⁻¹`, in the units of the parameters.
    #[must_use]
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        let inverse = self.inverse()?;
        let n = self.scales.len();
        Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * self.scales[i] * self.scales[j]))
    }

    /// Standard deviations of the parameters by that bound.
    #[must_use]
    pub fn deviations(&self) -> Option<Vec<f64>> {
        self.covariance().map(|covariance| covariance.diagonal().iter().map(|v| v.sqrt()).collect())
    }

    /// Weights on the diagonal of the scaled matrix, or of its inverse.
    fn diagonal_weight(&self, criterion: Criterion, i: usize) -> f64 {
        match criterion {
            Criterion::T => self.scales[i].powi(-2),
            Criterion::A => self.scales[i].powi(2),
            _ => 1.0,
        }
    }

    /// The criterion; `None` where it needs an inverse that does not exist.
    #[must_use]
    pub fn value(&self, criterion: Criterion) -> Option<f64> {
        let weighted = |diagonal: DVector<f64>| -> f64 {
            diagonal.iter().enumerate().map(|(i, v)| v * self.diagonal_weight(criterion, i)).sum()
        };
        match criterion {
            Criterion::T | Criterion::ScaledT => Some(weighted(self.scaled.diagonal())),
            Criterion::A | Criterion::ScaledA => Some(-weighted(self.inverse()?.diagonal())),
            Criterion::D => {
                self.inverse()?;
                let factor = self.normalised().cholesky()?;
                let logarithm: f64 = factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>()
                    - self.unit().iter().map(|d| d.ln()).sum::<f64>();
                Some(2.0 * logarithm)
            }
        }
    }

    /// `Φ = ∂(criterion)/∂(scaled matrix)`.
    fn weight(&self, criterion: Criterion) -> Option<DMatrix<f64>> {
        let n = self.scales.len();
        let diagonal = DMatrix::from_fn(n, n, |i, j| if i == j { self.diagonal_weight(criterion, i) } else { 0.0 });
        match criterion {
            Criterion::T | Criterion::ScaledT => Some(diagonal),
            Criterion::D => self.inverse(),
            Criterion::A | Criterion::ScaledA => {
                let inverse = self.inverse()?;
                Some(&inverse * diagonal * &inverse)
            }
        }
    }
}

/// By what factor an experiment is better than another: of T the ratio of traces, of D the root of the ratio of
/// determinants (the mean factor for one parameter), of A the ratio of sums of variances.
#[must_use]
pub fn factor(criterion: Criterion, value: f64, reference: f64, parameters: usize) -> f64 {
    match criterion {
        Criterion::T | Criterion::ScaledT => value / reference,
        Criterion::D => ((value - reference) / parameters as f64).exp(),
        Criterion::A | Criterion::ScaledA => reference / value,
    }
}
