//! What is identified from: a plant and matrices of frequency data in the request.

use crate::analysis::contract::{Inputs, Part};
use crate::analysis::inputs::data::{
    check_frequencies, check_responses, check_variances, in_order, increasing, wrong_data,
};
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use crate::control::MultivariableModel;
use crate::identify::mimo::MatrixFrequencyData;
use crate::trial::pointer;
use nalgebra::DMatrix;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Rows and columns of a response at most.
const MAX_CHANNELS: usize = 16;

/// What is identified from.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[schemars(deny_unknown_fields)]
pub struct SsidMimoInputs {
    /// The known plant, from the controls to all of its outputs.
    pub plant: MultivariableModel,
    /// Which of its outputs are measured (the rows of `h`), counted from 0. Default: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_outputs: Option<Vec<usize>>,
    /// Which of its outputs are compared with the command (one command for each), counted from 0. Default: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fed_back_outputs: Option<Vec<usize>>,
    /// The closed loop's response from the commands to the measured outputs.
    pub frequency_response: MatrixResponses,
}

/// Matrices of frequency data in a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MatrixResponses {
    /// Angular frequencies in rad/s, not negative, each once; they are sorted.
    pub omega_rad_s: Vec<f64>,
    /// The response at each: rows are measured outputs, columns are commands, entries `[re, im]`.
    pub h: Vec<Vec<Vec<[f64; 2]>>>,
    /// The variance of each line, the same for all entries, positive; only weights by inverse variance need it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variance: Option<Vec<f64>>,
}

impl MatrixResponses {
    /// As the identification takes it.
    #[must_use]
    pub fn data(&self) -> MatrixFrequencyData {
        let matrix = |rows: &Vec<Vec<[f64; 2]>>| {
            DMatrix::from_fn(rows.len(), rows.first().map_or(0, Vec::len), |i, j| {
                Complex64::new(rows[i][j][0], rows[i][j][1])
            })
        };
        MatrixFrequencyData {
            omega_rad_s: self.omega_rad_s.clone(),
            h: self.h.iter().map(matrix).collect(),
            variance: self.variance.clone(),
        }
    }

    fn check(&self) -> Result<(), Problem> {
        let lines = self.omega_rad_s.len();
        check_frequencies(&self.omega_rad_s, true)?;
        check_responses(self.h.len(), lines, "h")?;
        for (k, rows) in self.h.iter().enumerate() {
            let columns = rows.first().map_or(0, Vec::len);
            if rows.is_empty() || columns == 0 || rows.len() > MAX_CHANNELS || columns > MAX_CHANNELS {
                let detail = format!(
                    "the response at line {k} (counted from 0) is {}x{columns}; 1 to {MAX_CHANNELS} rows and columns \
                     are taken",
                    rows.len()
                );
                return Err(wrong_data(detail, format!("h/{k}")));
            }
            if let Some(row) = rows.iter().position(|row| row.len() != columns) {
                let detail = format!(
                    "the response at line {k} (counted from 0) is ragged: row {row} has {} columns, and row 0 has \
                     {columns}",
                    rows[row].len()
                );
                return Err(wrong_data(detail, format!("h/{k}/{row}")));
            }
        }
        check_variances(self.variance.as_deref(), lines, "variance")
    }

    fn sorted(self) -> Self {
        let order = increasing(&self.omega_rad_s);
        Self {
            omega_rad_s: in_order(&self.omega_rad_s, &order),
            h: in_order(&self.h, &order),
            variance: self.variance.map(|variance| in_order(&variance, &order)),
        }
    }
}

impl Inputs for SsidMimoInputs {}

impl Part for SsidMimoInputs {
    fn read(inputs: &Value, _at: &str) -> Result<Self, Problem> {
        fn read<T: serde::de::DeserializeOwned>(value: &Value, at: &str) -> Result<T, Problem> {
            serde_json::from_value(value.clone()).map_err(|error| wrong(error.to_string(), at))
        }
        let Value::Object(members) = inputs else { return Err(wrong("the inputs are no object", "/inputs")) };
        for name in members.keys() {
            let at = pointer::member("/inputs", name);
            match name.as_str() {
                "plant" | "measured_outputs" | "fed_back_outputs" | "frequency_response" => {}
                "trial" | "trials" => {
                    let detail = "recorded trials have one command, one control and one output; identification with \
                         several inputs and outputs takes frequency data in the request";
                    return Err(wrong(detail, at).mend(
                        "Give frequency_response with a matrix for each line and the plant beside it, \
                         or ask for ssid, which identifies from trials.",
                    ));
                }
                _ => {
                    return Err(wrong(
                        format!(
                            "there is no input {name:?} beside plant, measured_outputs, fed_back_outputs and \
                             frequency_response"
                        ),
                        at,
                    ));
                }
            }
        }
        let member = |name: &str| members.get(name).filter(|value| !value.is_null());
        let data = member("frequency_response").ok_or_else(|| {
            wrong("there is no frequency_response", "/inputs").mend("Give omega_rad_s and a matrix h for each line.")
        })?;
        if data.pointer("/h/0/0").is_some_and(Value::is_number) {
            return Err(wrong(
                "h holds one complex number for each line; with a plant, pool or outputs in matrix form it holds a \
                 matrix for each line",
                "/inputs/frequency_response/h",
            )
            .mend("Write [[[re, im]]] for a response with one row and one column."));
        }
        let frequency_response: MatrixResponses = read(data, "/inputs/frequency_response")?;
        frequency_response.check()?;
        let frequency_response = frequency_response.sorted();
        let plant = member("plant")
            .ok_or_else(|| wrong("there is no plant", "/inputs").mend("Give the plant beside the data."))?;
        let outputs = |name: &str| member(name).map(|value| read(value, &format!("/inputs/{name}"))).transpose();
        Ok(Self {
            plant: read(plant, "/inputs/plant")?,
            measured_outputs: outputs("measured_outputs")?,
            fed_back_outputs: outputs("fed_back_outputs")?,
            frequency_response,
        })
    }
}
