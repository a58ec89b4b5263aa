//! The plant of a fit, checked, with its free parameters.

use super::plant::{GainFitPlant, LARGEST, MatrixPlant, NamedPlant};
use crate::analysis::inputs::matrix::dense;
use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_inputs as wrong;
use crate::control::{Model, System, conversion};
use crate::num::dual::Real;
use crate::person::state_feedback::{AffinePlant, Plant, PlantModel, Term};
use crate::plants::SeatedBalance;
use crate::plants::seated_balance::{Parameter, Structure, Values};
use crate::trial::pointer;
use nalgebra::DMatrix;

/// States at most.
const MAX_STATES: usize = 64;
/// Parameters of a plant at most.
const MAX_PARAMETERS: usize = 40;

/// A plant before it is known which parameters are free.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum PlantSource {
    /// As the request has it.
    Written(GainFitPlant),
    /// The model that stored trials were recorded on.
    Stored(Model),
}

impl PlantSource {
    pub(super) fn sample_time_s(&self) -> Option<f64> {
        match self {
            Self::Written(GainFitPlant::Named(_)) => None,
            Self::Written(GainFitPlant::Matrices(plant)) => plant.sample_time_s,
            Self::Stored(model) => model.sample_time_s(),
        }
    }

    /// The names of the states.
    pub(super) fn state_names(&self, states: usize) -> Vec<String> {
        match self {
            Self::Written(GainFitPlant::Named(_)) => {
                ["lower_angle", "lower_rate", "upper_angle", "upper_rate"].map(str::to_owned).to_vec()
            }
            _ => (1..=states).map(|i| format!("x{i}")).collect(),
        }
    }

    /// The units of the states and of the controls, where the catalogue knows them.
    pub(super) fn units(&self) -> [Option<Vec<String>>; 2] {
        let list = |units: &[&str]| Some(units.iter().map(|unit| (*unit).to_owned()).collect());
        match self {
            Self::Written(GainFitPlant::Named(_)) => [list(&["rad", "rad/s", "rad", "rad/s"]), list(&["N m"])],
            _ => [None, None],
        }
    }

    /// The plant with these free parameters; by default all that matrices are affine in, and none of the catalogue's.
    pub(super) fn check(&self, free: Option<&[String]>) -> Result<KnownPlant, Problem> {
        match self {
            Self::Written(GainFitPlant::Named(plant)) => named(plant, free.unwrap_or_default()).map(KnownPlant::Seated),
            Self::Written(GainFitPlant::Matrices(plant)) => matrices(plant, free).map(KnownPlant::Matrices),
            Self::Stored(model) => stored(model, free.unwrap_or_default()).map(KnownPlant::Matrices),
        }
    }
}

/// A checked plant with its free parameters.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum KnownPlant {
    Matrices(AffinePlant),
    Seated(SeatedBalance),
}

impl PlantModel for KnownPlant {
    fn names(&self) -> Vec<String> {
        match self {
            Self::Matrices(plant) => plant.names(),
            Self::Seated(plant) => PlantModel::names(plant),
        }
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        match self {
            Self::Matrices(plant) => plant.limits(),
            Self::Seated(plant) => PlantModel::limits(plant),
        }
    }

    fn nominal(&self) -> Vec<f64> {
        match self {
            Self::Matrices(plant) => plant.nominal(),
            Self::Seated(plant) => PlantModel::nominal(plant),
        }
    }

    fn plant<S: Real>(&self, theta: &[S]) -> Plant<S> {
        match self {
            Self::Matrices(plant) => plant.plant(theta),
            Self::Seated(plant) => PlantModel::plant(plant, theta),
        }
    }
}

fn unknown(name: &str, known: &[String], at: String) -> Problem {
    let mend = if known.is_empty() {
        "The plant has no parameters to fit.".to_owned()
    } else {
        format!("It has: {}.", known.join(", "))
    };
    wrong(format!("the plant has no parameter {name:?}"), at).mend(mend)
}

fn named(plant: &NamedPlant, free: &[String]) -> Result<SeatedBalance, Problem> {
    // Gains, delay and lag belong to the person, not to the plant.
    let of_plant =
        |p: &Parameter| !Parameter::GAINS.contains(p) && !matches!(p, Parameter::Delay | Parameter::MuscleLag);
    let names: Vec<String> = Parameter::ALL.iter().filter(|p| of_plant(p)).map(|p| p.name().to_owned()).collect();
    let known =
        |name: &str, at: String| Parameter::by_name(name).filter(of_plant).ok_or_else(|| unknown(name, &names, at));
    let mut values = Values::table_5_1();
    for (name, value) in &plant.values {
        let at = pointer::member("/inputs/plant/values", name);
        values = values.with(known(name, at)?, *value);
    }
    let mut parameters = Vec::new();
    for (i, name) in free.iter().enumerate() {
        parameters.push(known(name, format!("/spec/free/{i}"))?);
    }
    let structure = Structure { drive: plant.drive, delay_order: 0, muscle_lag: false, outputs: plant.outputs.clone() };
    SeatedBalance::new(structure, values, parameters).map_err(|error| wrong(error.to_string(), "/inputs/plant"))
}

/// A matrix of the request, its size checked.
fn sized(
    rows: Option<&Vec<Vec<f64>>>,
    letter: &str,
    shape: (usize, usize),
    at: &str,
) -> Result<Option<DMatrix<f64>>, Problem> {
    let Some(rows) = rows else { return Ok(None) };
    let found = dense(rows, letter, at)?;
    if found.shape() != shape {
        let (rows, columns) = found.shape();
        return Err(wrong(format!("{letter} is {rows}x{columns} and must be {}x{}", shape.0, shape.1), at));
    }
    for (index, value) in found.iter().enumerate() {
        if value.is_nan() || value.abs() > LARGEST {
            let (i, j) = (index % shape.0, index / shape.0);
            return Err(wrong(
                format!(
                    "{letter} has the entry {value:e} at row {i}, column {j} (counted from 0); magnitudes up to \
                     {LARGEST:e} are taken"
                ),
                format!("{at}/{i}/{j}"),
            )
            .mend("Choose units in which the numbers are of moderate size."));
        }
    }
    Ok(Some(found))
}

fn matrices(plant: &MatrixPlant, free: Option<&[String]>) -> Result<AffinePlant, Problem> {
    let at = |name: &str| format!("/inputs/plant/{name}");
    let n = plant.a.len();
    if n == 0 {
        return Err(wrong("A has no rows: there must be at least one state", at("a")));
    }
    if n > MAX_STATES {
        return Err(wrong(format!("A has {n} rows; at most {MAX_STATES} states are taken"), at("a")));
    }
    let width = |rows: &[Vec<f64>]| rows.first().map_or(0, Vec::len);
    let columns = width(&plant.a);
    if columns != n {
        return Err(wrong(format!("A is {n}x{columns} and must be square"), at("a")));
    }
    let m = width(&plant.b);
    let p = plant.c.as_ref().map_or(n, Vec::len);
    let q = plant.e.as_ref().map_or(m, |rows| width(rows));
    for (letter, count, port) in [("B", m, "control"), ("C", p, "output"), ("E", q, "input")] {
        if count == 0 {
            let detail = format!("{letter} is empty: there must be at least one {port}");
            return Err(wrong(detail, at(&letter.to_lowercase())));
        }
    }
    let read =
        |rows: Option<&Vec<Vec<f64>>>, letter: &str, shape| sized(rows, letter, shape, &at(&letter.to_lowercase()));
    let a = read(Some(&plant.a), "A", (n, n))?.unwrap_or_default();
    let b = read(Some(&plant.b), "B", (n, m))?.unwrap_or_default();
    let c = read(plant.c.as_ref(), "C", (p, n))?.unwrap_or_else(|| DMatrix::identity(p, n));
    let d = read(plant.d.as_ref(), "D", (p, m))?.unwrap_or_else(|| DMatrix::zeros(p, m));
    let e = read(plant.e.as_ref(), "E", (n, q))?;
    let f = match read(plant.f.as_ref(), "F", (p, q))? {
        Some(f) => f,
        None if e.is_none() => d.clone(),
        None => DMatrix::zeros(p, q),
    };
    let follows = e.is_none();
    let e = e.unwrap_or_else(|| b.clone());
    if let Some(period) = plant.sample_time_s
        && !(period > 0.0 && period.is_finite())
    {
        return Err(wrong(format!("the sample time is {period} s, and must be positive"), at("sample_time_s")));
    }
    if plant.parameters.len() > MAX_PARAMETERS {
        let detail = format!("there are {} parameters; at most {MAX_PARAMETERS} are taken", plant.parameters.len());
        return Err(wrong(detail, at("parameters")));
    }
    let mut base = Plant { a, b, e, c, d, f, initial: vec![0.0; n] };
    let names: Vec<String> = plant.parameters.iter().map(|p| p.name.clone()).collect();
    if let Some((i, name)) = free.unwrap_or_default().iter().enumerate().find(|(_, name)| !names.contains(name)) {
        return Err(unknown(name, &names, format!("/spec/free/{i}")));
    }
    let mut terms = Vec::new();
    for (i, parameter) in plant.parameters.iter().enumerate() {
        let place = |name: &str| format!("/inputs/plant/parameters/{i}/{name}");
        if names[..i].contains(&parameter.name) || parameter.name.is_empty() {
            return Err(wrong(format!("the name {:?} is empty, or taken already", parameter.name), place("name")));
        }
        if parameter.nominal.is_nan() || parameter.nominal.abs() > LARGEST {
            return Err(wrong(format!("the nominal value is {:e}", parameter.nominal), place("nominal")));
        }
        let read = |rows: Option<&Vec<Vec<f64>>>, letter: &str, shape: (usize, usize)| {
            sized(rows, letter, shape, &place(&letter.to_lowercase()))
        };
        let zeros = |shape: (usize, usize)| DMatrix::zeros(shape.0, shape.1);
        let b = read(parameter.b.as_ref(), "B", (n, m))?.unwrap_or_else(|| zeros((n, m)));
        let d = read(parameter.d.as_ref(), "D", (p, m))?.unwrap_or_else(|| zeros((p, m)));
        // An input that is added to the control moves with it.
        let e =
            read(parameter.e.as_ref(), "E", (n, q))?.unwrap_or_else(|| if follows { b.clone() } else { zeros((n, q)) });
        let f =
            read(parameter.f.as_ref(), "F", (p, q))?.unwrap_or_else(|| if follows { d.clone() } else { zeros((p, q)) });
        let slope = Plant {
            a: read(parameter.a.as_ref(), "A", (n, n))?.unwrap_or_else(|| zeros((n, n))),
            c: read(parameter.c.as_ref(), "C", (p, n))?.unwrap_or_else(|| zeros((p, n))),
            b,
            d,
            e,
            f,
            initial: Vec::new(),
        };
        let is_free = free.is_none_or(|free| free.contains(&parameter.name));
        if is_free {
            terms.push(Term { name: parameter.name.clone(), nominal: parameter.nominal, slope });
        } else {
            let value = parameter.nominal;
            base.a += slope.a * value;
            base.b += slope.b * value;
            base.e += slope.e * value;
            base.c += slope.c * value;
            base.d += slope.d * value;
            base.f += slope.f * value;
        }
    }
    Ok(AffinePlant { base, terms })
}

/// The plant that a trial was recorded on, in the states of its canonical form.
fn stored(model: &Model, free: &[String]) -> Result<AffinePlant, Problem> {
    if let Some(name) = free.first() {
        return Err(unknown(name, &[], "/spec/free/0".to_owned()));
    }
    let unusable = |error: String| wrong(format!("the plant of the trial cannot be used: {error}"), "/inputs/trials");
    let [a, b, c, d] = match model {
        Model::StateSpace(written) => [&written.a, &written.b, &written.c, &written.d]
            .map(|rows| DMatrix::from_fn(rows.len(), rows.first().map_or(0, Vec::len), |i, j| rows[i][j])),
        Model::TransferFunction(_) => {
            let system = model.check().map_err(|error| unusable(error.to_string()))?;
            let parts = |a: &DMatrix<f64>, b: &DMatrix<f64>, c: &DMatrix<f64>, d: &DMatrix<f64>| {
                [a.clone(), b.clone(), c.clone(), d.clone()]
            };
            match system {
                System::Continuous(tf) => conversion::to_state_space(&tf)
                    .map(|ss| ss.balanced())
                    .map(|ss| parts(ss.a(), ss.b(), ss.c(), ss.d())),
                System::Discrete(tf) => conversion::to_state_space(&tf)
                    .map(|ss| ss.balanced())
                    .map(|ss| parts(ss.a(), ss.b(), ss.c(), ss.d())),
            }
            .map_err(|error| unusable(error.to_string()))?
        }
    };
    if a.nrows() == 0 {
        return Err(unusable("it has no states".to_owned()));
    }
    let initial = vec![0.0; a.nrows()];
    Ok(AffinePlant { base: Plant { e: b.clone(), f: d.clone(), a, b, c, d, initial }, terms: Vec::new() })
}
