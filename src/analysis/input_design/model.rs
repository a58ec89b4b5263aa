//! The model whose parameters an experiment is to tell, checked.

use super::model_input::{Entry, FormulaModel};
use super::refusal::wrong;
use crate::analysis::problem::Problem;
use crate::control::parametric::{Differentiated, Matrices, ParametricModel};
use crate::control::{Continuous, Discrete, TimeBase};
use crate::num::dual::Real;
use crate::num::expression::Expression;
use crate::plants::head_neck::HeadNeck;
use crate::plants::seated_balance::SeatedBalance;
use nalgebra::{DMatrix, DVector};

/// States, outputs, inputs and free parameters at most.
const MOST: [(&str, usize); 4] = [("states", 40), ("outputs", 12), ("inputs", 12), ("free parameters", 40)];
/// Magnitudes beyond this overflow in products of a few matrices.
pub(super) const LARGEST: f64 = 1e60;

/// Formulas, checked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Formulas<T> {
    time: T,
    /// Values of all parameters, and the places of the free ones among them.
    values: Vec<f64>,
    free: Vec<usize>,
    names: Vec<String>,
    limits: Vec<[f64; 2]>,
    a: DMatrix<Expression>,
    b: DMatrix<Expression>,
    c: DMatrix<Expression>,
    d: DMatrix<Expression>,
    initial: Vec<Expression>,
}

impl<T: TimeBase> ParametricModel for Formulas<T> {
    type Time = T;

    fn time(&self) -> T {
        self.time
    }

    fn names(&self) -> Vec<String> {
        self.free.iter().map(|i| self.names[*i].clone()).collect()
    }

    fn limits(&self) -> Vec<[f64; 2]> {
        self.free.iter().map(|i| self.limits[*i]).collect()
    }

    fn matrices<S: Real>(&self, theta: &[S]) -> Matrices<S> {
        let mut values: Vec<S> = self.values.iter().map(|v| S::from(*v)).collect();
        for (index, value) in self.free.iter().zip(theta) {
            values[*index] = *value;
        }
        let of = |m: &DMatrix<Expression>| DMatrix::from_fn(m.nrows(), m.ncols(), |i, j| m[(i, j)].value(&values));
        Matrices {
            a: of(&self.a),
            b: of(&self.b),
            c: of(&self.c),
            d: of(&self.d),
            initial: DVector::from_fn(self.initial.len(), |i, _| self.initial[i].value(&values)),
        }
    }
}

/// A checked model.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Known {
    Seated(SeatedBalance),
    Head(HeadNeck),
    Continuous(Formulas<Continuous>),
    Sampled(Formulas<Discrete>),
}

/// A model with the names of its outputs.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Model {
    known: Known,
    pub outputs: Vec<String>,
    /// Those that are measured where nothing else is said.
    pub measured: Vec<String>,
    pub inputs: usize,
}

impl Model {
    /// The model of formulas in the request.
    pub(super) fn of_formulas(written: &FormulaModel) -> Result<Self, Problem> {
        let at = "/inputs/model";
        let names: Vec<String> = written.parameters.iter().map(|p| p.name.clone()).collect();
        for (i, parameter) in written.parameters.iter().enumerate() {
            let here = format!("{at}/parameters/{i}");
            let mut letters = parameter.name.chars();
            let is_name = letters.next().is_some_and(|c| c.is_alphabetic() || c == '_')
                && letters.all(|c| c.is_alphanumeric() || c == '_')
                && !matches!(parameter.name.as_str(), "sin" | "cos" | "pi");
            if !is_name || names[..i].contains(&parameter.name) {
                return Err(wrong(
                    format!("{:?} is no name, or is there twice", parameter.name),
                    format!("{here}/name"),
                )
                .mend("A name is of letters, digits and _, begins with no digit, and is none of sin, cos, pi."));
            }
            let (lower, upper) = (parameter.lower.unwrap_or(-LARGEST), parameter.upper.unwrap_or(LARGEST));
            if !(lower < upper && lower <= parameter.value && parameter.value <= upper) {
                return Err(wrong(
                    format!("{} is {} and must lie between {lower} and {upper}", parameter.name, parameter.value),
                    format!("{here}/value"),
                ));
            }
        }
        let matrix = |rows: &[Vec<Entry>], field: &str| -> Result<DMatrix<Expression>, Problem> {
            let width = rows.first().map_or(0, Vec::len);
            let mut entries = Vec::new();
            for (i, row) in rows.iter().enumerate() {
                if row.len() != width {
                    return Err(wrong(
                        format!("row {i} has {} entries where row 0 has {width}", row.len()),
                        format!("{at}/{field}/{i}"),
                    ));
                }
                for (j, entry) in row.iter().enumerate() {
                    entries.push(expression(entry, &names, &format!("{at}/{field}/{i}/{j}"))?);
                }
            }
            Ok(DMatrix::from_row_iterator(rows.len(), width, entries))
        };
        let (a, b, c) = (matrix(&written.a, "a")?, matrix(&written.b, "b")?, matrix(&written.c, "c")?);
        let (n, m, p) = (a.nrows(), b.ncols(), c.nrows());
        let zero = Expression::Number(0.0);
        let d = match &written.d {
            Some(rows) => matrix(rows, "d")?,
            None => DMatrix::from_element(p, m, zero.clone()),
        };
        for (field, shape, wanted) in
            [("a", a.shape(), (n, n)), ("b", b.shape(), (n, m)), ("c", c.shape(), (p, n)), ("d", d.shape(), (p, m))]
        {
            if shape != wanted || n == 0 || m == 0 || p == 0 {
                return Err(wrong(
                    format!("{field} is {}x{} and must be {}x{}", shape.0, shape.1, wanted.0.max(1), wanted.1.max(1)),
                    format!("{at}/{field}"),
                ));
            }
        }
        let initial = match &written.initial {
            None => vec![zero; n],
            Some(entries) if entries.len() == n => entries
                .iter()
                .enumerate()
                .map(|(i, entry)| expression(entry, &names, &format!("{at}/initial/{i}")))
                .collect::<Result<_, _>>()?,
            Some(entries) => {
                return Err(wrong(
                    format!("the initial state has {} entries and must have {n}", entries.len()),
                    format!("{at}/initial"),
                ));
            }
        };
        let outputs = written.outputs.clone().unwrap_or_else(|| (1..=p).map(|i| format!("y{i}")).collect());
        let is_twice = (0..outputs.len()).any(|i| outputs[..i].contains(&outputs[i]));
        if outputs.len() != p || is_twice {
            return Err(wrong(
                format!("there are {} names for {p} outputs, or one of them twice", outputs.len()),
                format!("{at}/outputs"),
            ));
        }
        let free = (0..names.len()).filter(|i| written.parameters[*i].free).collect();
        let values = written.parameters.iter().map(|p| p.value).collect();
        let limits =
            written.parameters.iter().map(|p| [p.lower.unwrap_or(-LARGEST), p.upper.unwrap_or(LARGEST)]).collect();
        let known = match written.sample_time_s {
            None => Known::Continuous(Formulas { time: Continuous, values, free, names, limits, a, b, c, d, initial }),
            Some(period) => {
                let time =
                    Discrete::new(period).map_err(|error| wrong(error.to_string(), format!("{at}/sample_time_s")))?;
                Known::Sampled(Formulas { time, values, free, names, limits, a, b, c, d, initial })
            }
        };
        Self::checked(known, outputs, m)
    }

    /// With what follows from it: what is measured by default, and whether it is of a size that is taken.
    pub(super) fn checked(known: Known, outputs: Vec<String>, inputs: usize) -> Result<Self, Problem> {
        let measured = match &known {
            Known::Seated(_) => ["lower_angle", "upper_angle"].map(str::to_owned).to_vec(),
            Known::Head(_) => vec!["angle".to_owned()],
            Known::Continuous(_) | Known::Sampled(_) => outputs.clone(),
        };
        let model = Self { known, outputs, measured, inputs };
        let at = "/inputs/model";
        let states = model
            .with(|m| m.0)
            .map_err(|error| wrong(error, at).mend("The model must be defined at the values of its parameters."))?;
        let counts = [states, model.outputs.len(), inputs, model.names().len()];
        for ((what, most), count) in MOST.into_iter().zip(counts) {
            if count > most {
                return Err(wrong(format!("there are {count} {what}; at most {most} are taken"), at));
            }
        }
        if model.names().is_empty() {
            return Err(wrong("no parameter is free, so there is nothing that an experiment could tell", at)
                .mend("Free at least one parameter."));
        }
        Ok(model)
    }

    /// The number of states and of inputs, where the model is defined at its nominal values.
    fn with(&self, of: impl Fn((usize, usize)) -> usize) -> Result<usize, String> {
        fn sizes<M: ParametricModel>(model: &M, theta: &[f64]) -> Result<(usize, usize), String> {
            let found = model.realise(theta).map_err(|error| error.to_string())?;
            Ok((found.model.states(), found.model.inputs()))
        }
        let theta = self.nominal();
        let found = match &self.known {
            Known::Seated(model) => sizes(model, &theta),
            Known::Head(model) => sizes(model, &theta),
            Known::Continuous(model) => sizes(model, &theta),
            Known::Sampled(model) => sizes(model, &theta),
        };
        found.map(of)
    }

    /// Names of the free parameters.
    pub(super) fn names(&self) -> Vec<String> {
        match &self.known {
            Known::Seated(model) => model.names(),
            Known::Head(model) => model.names(),
            Known::Continuous(model) => model.names(),
            Known::Sampled(model) => model.names(),
        }
    }

    /// Their values.
    pub(super) fn nominal(&self) -> Vec<f64> {
        fn of<T>(model: &Formulas<T>) -> Vec<f64> {
            model.free.iter().map(|i| model.values[*i]).collect()
        }
        match &self.known {
            Known::Seated(model) => model.nominal(),
            Known::Head(model) => model.nominal(),
            Known::Continuous(model) => of(model),
            Known::Sampled(model) => of(model),
        }
    }

    /// Between which values they may move.
    pub(super) fn limits(&self) -> Vec<[f64; 2]> {
        match &self.known {
            Known::Seated(model) => model.limits(),
            Known::Head(model) => model.limits(),
            Known::Continuous(model) => model.limits(),
            Known::Sampled(model) => model.limits(),
        }
    }

    /// Its own sample time, of a sampled model.
    pub(super) fn sample_time_s(&self) -> Option<f64> {
        if let Known::Sampled(model) = &self.known { Some(model.time.period_s()) } else { None }
    }

    /// The model and its derivatives at θ, sampled.
    pub(super) fn sampled(&self, theta: &[f64], time: Discrete) -> Result<Differentiated<Discrete>, String> {
        fn held<M: ParametricModel<Time = Continuous>>(
            model: &M,
            theta: &[f64],
            time: Discrete,
        ) -> Result<Differentiated<Discrete>, String> {
            let found = model.differentiate(theta).map_err(|error| error.to_string())?;
            found.sampled(time).map_err(|error| error.to_string())
        }
        match &self.known {
            Known::Seated(model) => held(model, theta, time),
            Known::Head(model) => held(model, theta, time),
            Known::Continuous(model) => held(model, theta, time),
            Known::Sampled(model) => model.differentiate(theta).map_err(|error| error.to_string()),
        }
    }
}

fn expression(entry: &Entry, names: &[String], at: &str) -> Result<Expression, Problem> {
    match entry {
        Entry::Number(number) => Ok(Expression::Number(*number)),
        Entry::Formula(text) => Expression::parse(text, names).map_err(|error| wrong(error.to_string(), at)),
    }
}
