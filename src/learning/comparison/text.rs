//! Numbers and metrics in sentences.

use crate::learning::curves::Metric;

/// Three significant digits.
pub(crate) fn number(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    if !(-4..7).contains(&digits) {
        return format!("{value:.2e}");
    }
    format!("{value:.*}", usize::try_from(2 - digits).unwrap_or(0))
}

/// The metric as the papers write it.
pub(crate) fn symbol(metric: Metric) -> &'static str {
    match metric {
        Metric::MeanAbsError => "‖e‖",
        Metric::RmsError => "rms error",
        Metric::NormFeedback => "‖Gfb‖",
        Metric::NormFeedforwardMinusInverse => "‖Gff − G⁻¹‖",
        Metric::NormFeedforwardPlantMinusOne => "‖Gff G − 1‖",
        Metric::VarianceAccountedFor => "variance accounted for",
        Metric::ControlLogDimensionlessJerk => "log dimensionless jerk of u",
    }
}
