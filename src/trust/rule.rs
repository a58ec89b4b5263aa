//! The rule: its constants and its rows, for whoever applies, shows or documents them.

use super::level::Level;
use schemars::JsonSchema;
use serde::Serialize;

/// Rises with every change of what the rule says of the same report, so that what was stored is judged anew.
pub const RULE_VERSION: u32 = 1;

/// The numbers of the rule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "TrustConstants")]
pub struct Constants {
    /// Share of the recorded output's variation that does not follow from the control through the plant, above which
    /// nothing identified is to be used.
    pub unexplained_output_do_not_use: f64,
    /// The same share, above which warnings are to be read.
    pub unexplained_output_read: f64,
    /// Share of the output's variation that the simulated controllers explain, at or below which nothing identified is
    /// to be used.
    pub simulated_share_do_not_use: f64,
    /// The same share, below which warnings are to be read.
    pub simulated_share_read: f64,
    /// Half-width of a 95 % interval over its value, above which the value is not to be used.
    pub half_width_do_not_use: f64,
    /// The same, above which warnings are to be read.
    pub half_width_read: f64,
    /// Upper over lower end of a 95 % interval, above which the value is not to be used.
    pub interval_ratio_do_not_use: f64,
    /// Greatest over least value among candidates that fit nearly as well, above which the value is not to be used.
    pub spread_do_not_use: f64,
    /// The same, above which warnings are to be read.
    pub spread_read: f64,
    /// Smallest p of the tests of the residuals, adjusted by Holm, below which an interval is not to be used.
    pub residual_p_do_not_use: f64,
    /// The same, below which warnings are to be read.
    pub residual_p_read: f64,
    /// Share of the members of a mean that must be at the worst level for the mean to be at it.
    pub mean_share: f64,
}

/// The numbers of the rule.
pub const CONSTANTS: Constants = Constants {
    unexplained_output_do_not_use: 0.2,
    unexplained_output_read: 0.05,
    simulated_share_do_not_use: 0.0,
    simulated_share_read: 0.5,
    half_width_do_not_use: 1.0,
    half_width_read: 0.25,
    interval_ratio_do_not_use: 3.0,
    spread_do_not_use: 3.0,
    spread_read: 1.25,
    residual_p_do_not_use: 0.001,
    residual_p_read: 0.05,
    mean_share: 1.0 / 3.0,
};

/// Whether so many of so many are more than the share that decides a mean.
pub(super) fn exceeds_share(count: usize, of: usize) -> bool {
    count as f64 > CONSTANTS.mean_share * of as f64
}

/// A row of the rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Row {
    /// Its place in the table, from 1; rows of one place differ in degree.
    pub number: u32,
    /// Its code.
    pub code: &'static str,
    /// Where the finding stands in a report or trial.
    pub field: &'static str,
    /// When it applies.
    pub condition: &'static str,
    /// What it is about.
    pub quantities: &'static str,
    /// What it says: of row 8 of the feedback, of failing simulations of what has no interval.
    pub level: Level,
    /// What to do, in one sentence.
    pub advice: &'static str,
}

const ALL_IDENTIFIED: &str = "everything identified";
const ITSELF: &str = "the quantity itself";

macro_rules! row {
    ($number:literal, $code:literal, $field:expr, $condition:expr, $quantities:expr, $level:ident, $advice:expr) => {
        Row {
            number: $number,
            code: $code,
            field: $field,
            condition: $condition,
            quantities: $quantities,
            level: Level::$level,
            advice: $advice,
        }
    };
}

/// The rows, in the order of the table.
pub const ROWS: &[Row] = &[
    row!(
        1,
        "not_identified",
        "status",
        "there is no succeeded analysis, or it gives no value",
        ALL_IDENTIFIED,
        NotIdentified,
        "Start an analysis of the trial, or read why the one that there is has no value."
    ),
    row!(
        2,
        "divergent",
        "metrics.divergent",
        "the output passed the study's display limit",
        "all of the trial",
        DoNotUse,
        "Leave the trial out; correct the study's display limit if that is wrong."
    ),
    row!(
        2,
        "excluded",
        "excluded",
        "somebody excluded the trial, with a reason",
        "all of the trial",
        DoNotUse,
        "Leave the trial out; take it in again if the reason is wrong."
    ),
    row!(
        3,
        "output_not_from_control",
        "warnings: output_not_from_control, channels_exchanged",
        "more than 20 % of the output does not follow from the control through the plant",
        ALL_IDENTIFIED,
        DoNotUse,
        "Check the plant, the columns and the sample time, and upload the recording again."
    ),
    row!(
        3,
        "output_loosely_from_control",
        "warnings: output_loosely_from_control",
        "more than 5 % of the output does not follow from the control through the plant",
        ALL_IDENTIFIED,
        Read,
        "Look at the figure plant_check before relying on what was identified."
    ),
    row!(
        4,
        "simulation_fails",
        "warnings: simulation_fails, loop_unstable; the simulated share of y",
        "simulated, the controllers explain none of the output",
        ALL_IDENTIFIED,
        DoNotUse,
        "Identify with another pool or estimator, or record a longer trial."
    ),
    row!(
        4,
        "simulation_weak",
        "the simulated share of y",
        "simulated, the controllers explain less than half of the output",
        ALL_IDENTIFIED,
        Read,
        "Compare the recording with the figure simulated before relying on the controllers."
    ),
    row!(
        5,
        "interval_too_wide",
        "the quantity's 95 % interval",
        "its half-width is more than the value, or its upper end more than three times its lower end",
        ITSELF,
        DoNotUse,
        "Record longer, or several trials, and estimate them together."
    ),
    row!(
        6,
        "interval_wide",
        "the quantity's 95 % interval",
        "its half-width is more than 25 % of the value",
        ITSELF,
        Read,
        "Give the interval with the value."
    ),
    row!(
        7,
        "spread_too_wide",
        "near_optimal.spread",
        "among candidates that fit nearly as well the greatest value is more than three times the least",
        ITSELF,
        DoNotUse,
        "Restrict the pool, or record with a second stimulus."
    ),
    row!(
        7,
        "spread_wide",
        "near_optimal.spread",
        "among candidates that fit nearly as well the greatest value is more than 1.25 times the least",
        ITSELF,
        Read,
        "Give the range of the candidates with the value."
    ),
    row!(
        8,
        "feedback_not_told",
        "warnings: feedback_poorly_determined, feedback_not_determined, command_does_not_determine_feedback, \
         near_inverse_of_the_plant",
        "the stimuli do not tell the feedback from the feedforward",
        "the feedback; everything else identified is to be read",
        DoNotUse,
        "Record with a disturbance of the control beside the command."
    ),
    row!(
        9,
        "no_interval",
        "refined.uncertainty, metrics.*.reason",
        "the quantity has no interval",
        ALL_IDENTIFIED,
        Read,
        "Estimate it by prediction_error, which has intervals, or record several periods."
    ),
    row!(
        10,
        "interval_refused",
        "refined.residual_tests",
        "the residuals refuse the model with p below 0.001: the interval is not to be used, the value to be read",
        ALL_IDENTIFIED,
        Read,
        "Do not print the interval; free the structure, or look for another stimulus in the trial."
    ),
    row!(
        10,
        "interval_doubtful",
        "refined.residual_tests",
        "the residuals speak against the model with p below 0.05",
        ALL_IDENTIFIED,
        Read,
        "Look at the residuals before printing the interval."
    ),
    row!(
        11,
        "not_converged",
        "refined.converged, certificate.exact",
        "the search did not arrive",
        ALL_IDENTIFIED,
        Read,
        "Run it again with another start, or more time."
    ),
    row!(
        12,
        "held_back",
        "warnings: stability_margin_active, edge_of_pool; refined.active_constraints",
        "a limit of the search holds the answer back",
        "feedforward and feedback",
        Read,
        "Widen the pool or the margin, and see whether the answer moves."
    ),
    row!(
        12,
        "form_moves_answer",
        "warnings: answer_moves, feedback_cut_short, feedforward_cut_short, prediction_errors_not_white",
        "the form of the model holds the answer back",
        "feedforward and feedback",
        Read,
        "Change the orders and lags that the warning names, and see whether the answer moves."
    ),
    row!(
        13,
        "boundary",
        "verdict",
        "the gain lies at the boundary of those that are optimal for a cost",
        "cost and noise matrices",
        Read,
        "Give the cost with the verdict, as one of many."
    ),
    row!(
        13,
        "infeasible",
        "verdict",
        "no cost makes the gain optimal",
        "cost and noise matrices",
        NotIdentified,
        "Show the certificate, and no matrices as the cost."
    ),
    row!(
        14,
        "parameter_not_determined",
        "warnings: not_identifiable, starts_disagree, parameters_not_determined, gain_and_filter",
        "the data do not determine it",
        "those parameters",
        DoNotUse,
        "Hold a parameter of the combination fixed, or excite more."
    ),
    row!(15, "measured", "metrics", "it was measured in time, and not identified", "measures of time", Ok, ""),
    row!(16, "ok", "", "nothing of the above applies", ITSELF, Ok, ""),
];

/// What to do where a row applies.
#[must_use]
pub fn advice(code: &str) -> &'static str {
    ROWS.iter().find(|row| row.code == code).map_or("", |row| row.advice)
}

/// A row of the rule, as it is shown.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
#[schemars(rename = "TrustRuleRow")]
pub struct RuleRow {
    /// Its place in the table, from 1; rows of one place differ in degree.
    pub number: u32,
    /// Its code, as `trust` has it.
    pub code: String,
    /// Where the finding stands in a report or trial.
    pub field: String,
    /// When it applies.
    pub condition: String,
    /// Which quantities it is about.
    pub quantities: String,
    /// What it says of them.
    pub level: Level,
    /// What to do, in one sentence.
    #[serde(rename = "do")]
    pub advice: String,
}

/// The rule by which values are marked.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct TrustRule {
    /// Rises with every change of the rule.
    pub version: u32,
    /// Its numbers.
    pub constants: Constants,
    /// Its rows; the level of a quantity is the worst of those that apply.
    pub rows: Vec<RuleRow>,
}

/// The rule, as it is shown.
#[must_use]
pub fn rule() -> TrustRule {
    let row = |row: &Row| RuleRow {
        number: row.number,
        code: row.code.to_owned(),
        field: row.field.to_owned(),
        condition: row.condition.to_owned(),
        quantities: row.quantities.to_owned(),
        level: row.level,
        advice: row.advice.to_owned(),
    };
    TrustRule { version: RULE_VERSION, constants: CONSTANTS, rows: ROWS.iter().map(row).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_has_a_code_of_its_own_and_says_what_to_do() {
        let codes: std::collections::BTreeSet<&str> = ROWS.iter().map(|row| row.code).collect();
        assert_eq!(codes.len(), ROWS.len());
        assert!(ROWS.windows(2).all(|pair| pair[0].number <= pair[1].number));
        for row in ROWS {
            assert_eq!(row.advice.is_empty(), row.level == Level::Ok, "{row:?}");
            assert!(row.advice.is_empty() || row.advice.ends_with('.'), "{row:?}");
        }
    }

    /// The words of the table name the constants.
    #[test]
    fn the_words_of_the_rows_agree_with_the_constants() {
        let text = |code: &str| ROWS.iter().find(|row| row.code == code).unwrap().condition;
        let percent = |share: f64| format!("{} %", 100.0 * share);
        assert!(text("output_not_from_control").contains(&percent(CONSTANTS.unexplained_output_do_not_use)));
        assert!(text("output_loosely_from_control").contains(&percent(CONSTANTS.unexplained_output_read)));
        assert!(text("interval_wide").contains(&percent(CONSTANTS.half_width_read)));
        assert!(text("spread_wide").contains(&CONSTANTS.spread_read.to_string()));
        assert!(text("interval_refused").contains(&CONSTANTS.residual_p_do_not_use.to_string()));
        assert!(text("interval_doubtful").contains(&CONSTANTS.residual_p_read.to_string()));
        assert_eq!([CONSTANTS.interval_ratio_do_not_use, CONSTANTS.spread_do_not_use], [3.0; 2], "three times");
        assert_eq!([CONSTANTS.half_width_do_not_use, CONSTANTS.simulated_share_do_not_use], [1.0, 0.0]);
    }
}
