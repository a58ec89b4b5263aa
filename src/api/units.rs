//! The units of signals in bodies.

use super::checks;
use super::extract::present;
use crate::analysis::{Code, Problem};
use crate::store::{SignalUnits, UnitsChange};
use schemars::JsonSchema;
use serde::Deserialize;

/// Characters of a unit at most.
const MOST: usize = 40;

/// Units to be set or changed; what is left out stays as it is.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "SignalUnitsPatch", example = serde_json::json!({"output": "cm", "control": "N"}))]
pub(crate) struct UnitsBody {
    /// Of the command r and the output y; null takes it away.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<String>", length(min = 1, max = 40))]
    output: Option<Option<String>>,
    /// Of the control u and the disturbance d; null takes it away.
    #[serde(default, deserialize_with = "present")]
    #[schemars(with = "Option<String>", length(min = 1, max = 40))]
    control: Option<Option<String>>,
}

impl UnitsBody {
    /// What is to change.
    ///
    /// # Errors
    /// `invalid` for an empty or overlong unit, and for one with control characters.
    pub(super) fn change(&self) -> Result<UnitsChange, Problem> {
        let unit = |own: &Option<Option<String>>, pointer: &str| -> Result<Option<Option<String>>, Problem> {
            let Some(Some(text)) = own else { return Ok(own.clone()) };
            let text = checks::name(text, pointer)?;
            if text.chars().count() > MOST {
                let count = text.chars().count();
                return Err(Problem::new(Code::Invalid, "bad unit", format!("it has {count} characters"))
                    .at(pointer)
                    .mend(format!("Give 1 to {MOST} characters, such as cm or N/m.")));
            }
            Ok(Some(Some(text)))
        };
        Ok(UnitsChange {
            output: unit(&self.output, "/units/output")?,
            control: unit(&self.control, "/units/control")?,
        })
    }

    /// The units of something new.
    ///
    /// # Errors
    /// As [`UnitsBody::change`].
    pub(super) fn new_units(&self) -> Result<SignalUnits, Problem> {
        Ok(SignalUnits::default().changed(&self.change()?))
    }
}
