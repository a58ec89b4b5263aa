//! The plant of a request: a model, the id of a stored one, or the mass and damping of a linear drive.

use super::problems;
use crate::analysis::ids::PlantId;
use crate::analysis::inputs::library::Library;
use crate::analysis::inputs::plant::{check_delayed_plant, parse_model};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::{read, wrong_inputs as wrong};
use crate::analysis::report::sha256_json;
use crate::control::model::TransferFunctionModel;
use crate::control::{Discrete, Model, System};
use crate::excite::measured::{self, FittedPlant, Measured};
use crate::excite::path::{Discretisation, SampledPlant};
use crate::num::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// Lines of a measured response at most.
const MOST_LINES: usize = 10_000;

/// `P(s) = 1/(m s² + c s)` from force to position: the linear drive of a manipulandum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MassDamper {
    /// m, kg.
    pub mass_kg: f64,
    /// c, N s/m; may be 0.
    pub damping_ns_per_m: f64,
    /// By how much the position answers later, s. Default: 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay_s: Option<f64>,
}

/// A plant in continuous time by its measured frequency response; a rational model of the given size is fitted to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeasuredPlant {
    /// Frequencies, Hz, positive and increasing.
    pub frequency_hz: Vec<f64>,
    /// The response at each, from force to position, as `[re, im]` in their units.
    pub response: Vec<[f64; 2]>,
    /// Poles of the model, integrators included: 1 to 8. Default: 2.
    #[serde(default = "two")]
    pub poles: usize,
    /// Zeros of the model, fewer than poles. Default: 0.
    #[serde(default)]
    pub zeros: usize,
    /// Poles at s = 0. Default: 1, as a device that is moved by a force has.
    #[serde(default = "one")]
    pub integrators: usize,
    /// A known delay, s. Default: 0.
    #[serde(default)]
    pub delay_s: f64,
}

fn one() -> usize {
    1
}

fn two() -> usize {
    2
}

/// How well a model fits a measured frequency response.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct PlantFit {
    /// The model, without its delay.
    pub model: TransferFunctionModel,
    /// Its delay, s.
    pub delay_s: f64,
    /// The frequencies, Hz.
    pub frequency_hz: Vec<f64>,
    /// `|measured − model|/|model|` at every frequency, dimensionless.
    pub misfit: Vec<f64>,
    /// The largest, dimensionless.
    pub largest_misfit: f64,
    /// Where it is, Hz.
    pub largest_misfit_hz: f64,
}

/// A plant of a request.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum PlantInput {
    /// A linear drive.
    #[schemars(title = "MassDamperPlant")]
    MassDamper(MassDamper),
    /// A measured frequency response.
    #[schemars(title = "MeasuredPlant")]
    Measured(Box<MeasuredPlant>),
    /// A model in the request.
    #[schemars(title = "ModelPlant")]
    Model(Model),
    /// The id of a stored plant.
    #[schemars(title = "StoredPlant")]
    Stored(PlantId),
}

impl PlantInput {
    /// Checks it as far as it goes without its surroundings.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub fn parse(value: &Value, at: &str) -> Result<Self, Problem> {
        if let Some(text) = value.as_str() {
            return text
                .parse()
                .map(Self::Stored)
                .map_err(|_| wrong(format!("{text:?} is no id of a plant"), at).mend("Ids are UUIDs."));
        }
        if value.get("mass_kg").is_some() || value.get("damping_ns_per_m").is_some() {
            let drive: MassDamper = read(value, at, "unusable plant")?;
            let probe =
                Discrete::new(1e-3).map_err(|error| Problem::new(Code::Internal, "no probe", error.to_string()))?;
            SampledPlant::mass_damper(drive.mass_kg, drive.damping_ns_per_m, probe).map_err(|e| problems::path(&e))?;
            if let Some(delay_s) = drive.delay_s {
                check_delay(delay_s, at)?;
            }
            return Ok(Self::MassDamper(drive));
        }
        if value.get("frequency_hz").is_some() {
            let measured: MeasuredPlant = read(value, at, "unusable plant")?;
            measured.check(at)?;
            return Ok(Self::Measured(Box::new(measured)));
        }
        let model = parse_model(value, at)?;
        check_delayed_plant(&model, at)?;
        Ok(Self::Model(model))
    }

    /// The stored plant that it names.
    #[must_use]
    pub fn id(&self) -> Option<PlantId> {
        if let Self::Stored(id) = self { Some(*id) } else { None }
    }

    /// SHA-256 of its content: of a stored plant that of its model.
    ///
    /// # Errors
    /// `not_found` for a stored plant that is gone.
    pub fn sha256(&self, library: &Library, at: &str) -> Result<String, Problem> {
        Ok(sha256_json(&match self {
            Self::MassDamper(drive) => json!(drive),
            Self::Measured(measured) => json!(measured),
            Self::Model(model) => json!(model),
            Self::Stored(id) => json!(library.plant(*id).map_err(|problem| problem.at(at))?),
        }))
    }

    /// The plant as signals of this sample time see it.
    ///
    /// # Errors
    /// A [`Problem`] where it is gone, or cannot be sampled so.
    pub fn sample(
        &self,
        library: &Library,
        how: Discretisation,
        time: Discrete,
        at: &str,
    ) -> Result<SampledPlant, Problem> {
        let path = |error| problems::path(&error);
        let of_model = |model: &Model, at: &str| -> Result<(SampledPlant, f64), Problem> {
            let (system, delay_s) = check_delayed_plant(model, at)?;
            Ok((SampledPlant::new(&system, how, time).map_err(path)?, delay_s))
        };
        let (plant, delay_s) = match self {
            Self::MassDamper(MassDamper { mass_kg, damping_ns_per_m, delay_s }) => {
                let plant = if how == Discretisation::ZeroOrderHold {
                    SampledPlant::mass_damper(*mass_kg, *damping_ns_per_m, time).map_err(path)?
                } else {
                    let den = vec![*mass_kg, *damping_ns_per_m, 0.0];
                    let written = TransferFunctionModel { num: vec![1.0], den, sample_time_s: None, delay_s: None };
                    of_model(&Model::TransferFunction(written), at)?.0
                };
                (plant, delay_s.unwrap_or(0.0))
            }
            Self::Measured(measured) => {
                let system = System::Continuous(measured.fitted(at)?.plant);
                (SampledPlant::new(&system, how, time).map_err(path)?, measured.delay_s)
            }
            Self::Model(model) => of_model(model, at)?,
            Self::Stored(id) => of_model(library.plant(*id).map_err(|problem| problem.at(at))?, at)?,
        };
        if delay_s == 0.0 { Ok(plant) } else { plant.delayed(delay_s).map_err(path) }
    }

    /// How well the model of a measured plant fits; `None` of others.
    ///
    /// # Errors
    /// A [`Problem`] where nothing fits.
    pub fn fit(&self, at: &str) -> Result<Option<PlantFit>, Problem> {
        let Self::Measured(measured) = self else { return Ok(None) };
        let found = measured.fitted(at)?;
        let largest = found.misfit.iter().copied().enumerate().fold((0, 0.0), |m, v| if v.1 > m.1 { v } else { m });
        Ok(Some(PlantFit {
            model: (&found.plant).into(),
            delay_s: measured.delay_s,
            frequency_hz: measured.frequency_hz.clone(),
            largest_misfit: largest.1,
            largest_misfit_hz: measured.frequency_hz[largest.0],
            misfit: found.misfit,
        }))
    }
}

fn check_delay(delay_s: f64, at: &str) -> Result<(), Problem> {
    if (0.0..1e3).contains(&delay_s) {
        Ok(())
    } else {
        Err(wrong(format!("the delay is {delay_s}, and must be zero or more seconds"), format!("{at}/delay_s")))
    }
}

impl MeasuredPlant {
    fn check(&self, at: &str) -> Result<(), Problem> {
        let lines = self.frequency_hz.len();
        if !(4..=MOST_LINES).contains(&lines) || self.response.len() != lines {
            let detail = format!(
                "there are {lines} frequencies and {} responses; 4 to {MOST_LINES} of each are taken",
                self.response.len()
            );
            return Err(wrong(detail, format!("{at}/frequency_hz")));
        }
        let rising = self.frequency_hz.windows(2).position(|pair| pair[0] >= pair[1]);
        let is_positive = self.frequency_hz.iter().all(|f| *f > 0.0 && *f < 1e9);
        if let Some(i) = rising.map(|i| i + 1).or((!is_positive).then_some(0)) {
            return Err(wrong("frequencies must be positive and increasing", format!("{at}/frequency_hz/{i}")));
        }
        if let Some(i) = self.response.iter().position(|h| !((1e-60..1e60).contains(&h[0].hypot(h[1])))) {
            return Err(wrong("a response of zero, or none", format!("{at}/response/{i}")));
        }
        if !(1..=8).contains(&self.poles) || self.zeros >= self.poles || self.integrators > self.poles {
            let detail = format!(
                "a model of {} poles, {} of them at the origin, and {} zeros: 1 to 8 poles and fewer zeros are fitted",
                self.poles, self.integrators, self.zeros
            );
            return Err(wrong(detail, format!("{at}/poles")));
        }
        check_delay(self.delay_s, at)
    }

    fn fitted(&self, at: &str) -> Result<FittedPlant, Problem> {
        let omegas: Vec<f64> = self.frequency_hz.iter().map(|f| 2.0 * std::f64::consts::PI * f).collect();
        let response: Vec<Complex64> = self.response.iter().map(|[re, im]| Complex64::new(*re, *im)).collect();
        let measured = Measured {
            omega_rad_s: &omegas,
            response: &response,
            poles: self.poles,
            zeros: self.zeros,
            integrators: self.integrators,
            delay_s: self.delay_s,
        };
        measured::fit(&measured).map_err(|error| {
            Problem::new(Code::NotIdentifiable, "no model fits the measured plant", error.to_string())
                .at(at)
                .mend("Give fewer poles, other integrators or the delay, or more lines.")
        })
    }
}
