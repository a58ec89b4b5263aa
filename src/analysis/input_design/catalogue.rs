//! Models by name: people with their plants, and the catalogue's plants alone as formulas in the parameters that a lab
//! would want to know.

use super::model::{Known, LARGEST, Model};
use super::model_input::{Entry, FormulaModel, ModelName, ModelParameter, NamedModel};
use super::refusal::wrong;
use crate::analysis::problem::Problem;
use crate::plants::head_neck::{self, Axis, HeadNeck};
use crate::plants::seated_balance::{Output, Parameter, SeatedBalance, Structure, Values};
use crate::trial::pointer;
use std::f64::consts::PI;

/// Where the model is in a request.
const AT: &str = "/inputs/model";
/// The least mass that a fit may come to.
const LEAST: f64 = 1e-9;

/// The model with this name.
///
/// # Errors
/// A [`Problem`] with the JSON pointer of what is wrong.
pub(super) fn named(named: &NamedModel) -> Result<Model, Problem> {
    match named.name {
        ModelName::SeatedBalance => seated_balance(named),
        ModelName::HeadNeck => head_neck(named),
        name => {
            let plant = plant(name);
            let mut model = Model::of_formulas(&written(&plant, named)?)?;
            model.measured = vec![plant.outputs[0].to_owned()];
            Ok(model)
        }
    }
}

fn stray(field: &str) -> Problem {
    wrong(format!("this model takes no {field}"), format!("{AT}/{field}"))
}

fn seated_balance(named: &NamedModel) -> Result<Model, Problem> {
    if named.axis.is_some() {
        return Err(stray("axis"));
    }
    let initial = <[f64; 4]>::try_from(named.initial.clone().unwrap_or_else(|| vec![0.0; 4])).map_err(|given| {
        wrong(format!("the initial state has {} entries and must have 4", given.len()), format!("{AT}/initial"))
    })?;
    let parameter = |name: &str, at: String| {
        Parameter::by_name(name).ok_or_else(|| {
            let known: Vec<&str> = Parameter::ALL.iter().map(|p| p.name()).collect();
            wrong(format!("there is no parameter {name:?}"), at)
                .mend(format!("Its parameters are {}.", known.join(", ")))
        })
    };
    let mut values = Values::table_5_1();
    for (name, value) in &named.values {
        values = values.with(parameter(name, pointer::member(&format!("{AT}/values"), name))?, *value);
    }
    let free = match &named.free {
        None => Parameter::ALL[..11].to_vec(),
        Some(names) => names
            .iter()
            .enumerate()
            .map(|(i, name)| parameter(name, format!("{AT}/free/{i}")))
            .collect::<Result<_, _>>()?,
    };
    let outputs =
        [Output::LowerAngle, Output::LowerRate, Output::UpperAngle, Output::UpperRate, Output::Bend, Output::Torque];
    let mut structure = Structure { outputs: outputs.to_vec(), ..Structure::default() };
    structure.delay_order = named.delay_order.unwrap_or(structure.delay_order);
    let model = SeatedBalance::new(structure, values, free)
        .and_then(|model| model.starting_from(initial))
        .map_err(|error| wrong(error.to_string(), AT))?;
    let names = ["lower_angle", "lower_rate", "upper_angle", "upper_rate", "bend", "torque"];
    Model::checked(Known::Seated(model), names.map(str::to_owned).to_vec(), 1)
}

fn head_neck(named: &NamedModel) -> Result<Model, Problem> {
    if named.initial.is_some() {
        return Err(stray("initial"));
    }
    let place = |name: &str, at: String| {
        head_neck::PARAMETERS.iter().position(|known| *known == name).ok_or_else(|| {
            wrong(format!("there is no parameter {name:?}"), at)
                .mend(format!("Its parameters are {}.", head_neck::PARAMETERS.join(", ")))
        })
    };
    let mut values = named.axis.unwrap_or(Axis::FlexionExtension).nominal();
    for (name, value) in &named.values {
        values[place(name, pointer::member(&format!("{AT}/values"), name))?] = *value;
    }
    let free = match &named.free {
        None => vec![0, 1, 2, 3],
        Some(names) => {
            names.iter().enumerate().map(|(i, name)| place(name, format!("{AT}/free/{i}"))).collect::<Result<_, _>>()?
        }
    };
    let drive = head_neck::Drive::Target { delay_order: named.delay_order.unwrap_or(5) };
    let model = HeadNeck::new(values, free, drive).map_err(|error| wrong(error.to_string(), AT))?;
    Model::checked(Known::Head(model), head_neck::OUTPUTS.map(str::to_owned).to_vec(), 1)
}

/// A parameter: its name, its value in the source, and whether it is positive by its nature.
type Value = (&'static str, f64, bool);

/// A plant in formulas: `ẋ = Ax + bu`, `y = Cx`.
struct Plant {
    parameters: &'static [Value],
    a: &'static [&'static [&'static str]],
    b: &'static [&'static str],
    c: &'static [&'static [&'static str]],
    /// Of which the first is measured where nothing else is said.
    outputs: &'static [&'static str],
}

/// [`two_mass`](crate::plants::catalogue::two_mass): the states are position and velocity of the first mass, then of
/// the second, which is driven and seen.
const TWO_MASS: Plant = Plant {
    parameters: &[
        ("m1", 1.0, true),
        ("m2", 0.5, true),
        ("c1", 0.56 * PI, false),
        ("c2", 0.5 * PI, false),
        ("k1", 0.16 * PI * PI, false),
        ("k2", 0.5 * PI * PI, false),
    ],
    a: &[
        &["0", "1", "0", "0"],
        &["-(k1 + k2)/m1", "-(c1 + c2)/m1", "k2/m1", "c2/m1"],
        &["0", "0", "0", "1"],
        &["k2/m2", "c2/m2", "-k2/m2", "-c2/m2"],
    ],
    b: &["0", "0", "0", "1/m2"],
    c: &[&["0", "0", "1", "0"], &["0", "0", "0", "1"], &["1", "0", "0", "0"]],
    outputs: &["position", "velocity", "first_position"],
};

/// `1/(m s² + c s)`.
const fn mass_and_damper(parameters: &'static [Value]) -> Plant {
    Plant {
        parameters,
        a: &[&["0", "1"], &["0", "-damping/mass"]],
        b: &["0", "1/mass"],
        c: &[&["1", "0"], &["0", "1"]],
        outputs: &["position", "velocity"],
    }
}

/// `gain (s + zero)/(s² + damping s + stiffness)`.
const fn with_zero(parameters: &'static [Value]) -> Plant {
    Plant {
        parameters,
        a: &[&["0", "1"], &["-stiffness", "-damping"]],
        b: &["0", "1"],
        c: &[&["gain*zero", "gain"]],
        outputs: &["position"],
    }
}

/// `gain/s`.
const INTEGRATOR: Plant =
    Plant { parameters: &[("gain", 1.0, false)], a: &[&["0"]], b: &["gain"], c: &[&["1"]], outputs: &["position"] };

fn plant(name: ModelName) -> Plant {
    match name {
        ModelName::TwoMass => TWO_MASS,
        // Qiu 2021, section IV.B.
        ModelName::LinearDrive => mass_and_damper(&[("mass", 10.0, true), ("damping", 50.0, false)]),
        ModelName::DampedDoubleIntegrator => mass_and_damper(&[("mass", 1.0, true), ("damping", 1.0, false)]),
        ModelName::MinimumPhase => {
            with_zero(&[("gain", 2.0, false), ("zero", 2.2, false), ("damping", 3.6, false), ("stiffness", 4.0, false)])
        }
        ModelName::NonminimumPhase => with_zero(&[
            ("gain", -2.0, false),
            ("zero", -2.2, false),
            ("damping", 3.6, false),
            ("stiffness", 4.0, false),
        ]),
        ModelName::SlowNonminimumPhase => with_zero(&[
            ("gain", -5.5, false),
            ("zero", -0.8, false),
            ("damping", 3.6, false),
            ("stiffness", 4.0, false),
        ]),
        ModelName::Integrator | ModelName::SeatedBalance | ModelName::HeadNeck => INTEGRATOR,
    }
}

/// A plant's formulas with the values that are asked for.
fn written(plant: &Plant, named: &NamedModel) -> Result<FormulaModel, Problem> {
    if named.axis.is_some() {
        return Err(stray("axis"));
    }
    if named.delay_order.is_some() {
        return Err(stray("delay_order"));
    }
    let names: Vec<&str> = plant.parameters.iter().map(|(name, ..)| *name).collect();
    let known = |name: &String, at: String| {
        if names.contains(&name.as_str()) {
            return Ok(());
        }
        Err(wrong(format!("there is no parameter {name:?}"), at)
            .mend(format!("Its parameters are {}.", names.join(", "))))
    };
    for (name, value) in &named.values {
        let at = pointer::member(&format!("{AT}/values"), name);
        known(name, at.clone())?;
        let is_positive = plant.parameters.iter().any(|(own, _, positive)| own == name && *positive);
        if !(value.abs() < LARGEST && (!is_positive || *value >= LEAST)) {
            let which = if is_positive { "positive, and " } else { "" };
            return Err(wrong(format!("{name} is {value}, and must be {which}of moderate size"), at));
        }
    }
    for (i, name) in named.free.iter().flatten().enumerate() {
        known(name, format!("{AT}/free/{i}"))?;
    }
    let parameter = |(name, value, is_positive): &Value| ModelParameter {
        name: (*name).to_owned(),
        value: named.values.get(*name).copied().unwrap_or(*value),
        free: named.free.as_ref().is_none_or(|free| free.iter().any(|own| own == name)),
        lower: is_positive.then_some(LEAST),
        upper: None,
    };
    let row = |row: &[&str]| row.iter().map(|text| Entry::Formula((*text).to_owned())).collect::<Vec<Entry>>();
    Ok(FormulaModel {
        parameters: plant.parameters.iter().map(parameter).collect(),
        a: plant.a.iter().map(|entries| row(entries)).collect(),
        b: plant.b.iter().map(|entry| row(&[entry])).collect(),
        c: plant.c.iter().map(|entries| row(entries)).collect(),
        d: None,
        initial: named.initial.as_ref().map(|initial| initial.iter().map(|x| Entry::Number(*x)).collect()),
        outputs: Some(plant.outputs.iter().map(|name| (*name).to_owned()).collect()),
        sample_time_s: None,
    })
}
