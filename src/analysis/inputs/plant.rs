//! Plants of a request, and what keeps one from being used.

use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::wrong_inputs;
use crate::control::conversion::ConversionError;
use crate::control::model::{StateSpaceModel, TransferFunctionModel};
use crate::control::{Model, ModelError, System};
use serde_json::Value;

/// A model of a plant as JSON; whether it is a usable system is checked by [`check_plant`].
///
/// # Errors
/// `invalid`, with what is wrong with the form that it comes nearest to.
pub fn parse_model(value: &Value, location: &str) -> Result<Model, Problem> {
    serde_json::from_value::<Model>(value.clone()).map_err(|_| {
        // An untagged enum says only that nothing fits; the form that was meant says what does not.
        let meant: Result<(), serde_json::Error> = if value.get("a").is_some() {
            serde_json::from_value::<StateSpaceModel>(value.clone()).map(|_| ())
        } else {
            serde_json::from_value::<TransferFunctionModel>(value.clone()).map(|_| ())
        };
        let why = meant.err().map_or_else(|| "it has neither form".to_owned(), |error| error.to_string());
        wrong_inputs(format!("this is no model: {why}"), location).mend(
            "A model is {\"num\": [..], \"den\": [..], \"sample_time_s\": null} in descending powers, or {\"a\", \
             \"b\", \"c\", \"d\", \"sample_time_s\"} with row-major nested arrays.",
        )
    })
}

/// The plant as a checked system.
///
/// # Errors
/// `invalid`, where it is no system with one input and one output.
pub fn check_plant(plant: &Model, location: &str) -> Result<System, Problem> {
    plant.check().map_err(|error| unusable(&error, location))
}

/// The plant as a checked system with the delay behind it in seconds, which is 0 in sampled time.
///
/// # Errors
/// As [`check_plant`].
pub fn check_delayed_plant(plant: &Model, location: &str) -> Result<(System, f64), Problem> {
    plant.check_delayed().map_err(|error| unusable(&error, location))
}

fn unusable(error: &ModelError, location: &str) -> Problem {
    {
        let problem = Problem::new(Code::Invalid, "unusable plant", error.to_string()).at(location.to_owned());
        if matches!(error, ModelError::Conversion(ConversionError::NotSingle { .. })) {
            problem.mend(
                "With several inputs or outputs ask for ssid_mimo: frequency_response with a matrix for each line and \
                 a matrix_grid as the pool; recorded trials have one of each.",
            )
        } else {
            problem
        }
    }
}
