//! Systems with several inputs and outputs, and whatever stands in state space.

use super::found::{self, Found};
use super::{ModelTimeBase, frequencies};
use crate::control::model::{StateSpaceModel, TransferFunctionModel};
use crate::control::{
    Continuous, Discrete, Model, Multivariable, MultivariableModel, MultivariableSystem, System, TimeBase,
};
use crate::num::Complex64;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// The response of a system with several inputs and outputs, for a loader to compare with its own.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct MatrixResponse {
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// At each a matrix with a row for each output and a column for each input; entries `[re, im]`, in the unit of the
    /// output per unit of the input.
    pub value: Vec<Vec<Vec<[f64; 2]>>>,
}

/// A system in state space, `x' = A x + B u` or `x[k+1] = A x[k] + B u[k]`, `y = C x + D u`.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ExportedStateSpace {
    /// Where it stands in the result, as a JSON pointer.
    pub pointer: String,
    /// In which time it is.
    pub time_base: ModelTimeBase,
    /// Time between samples in seconds; null in continuous time.
    pub sample_time_s: Option<f64>,
    /// The same as python-control (`dt`) and MATLAB (`Ts`) write it, in seconds: 0 in continuous time.
    pub dt: f64,
    /// A, n by n, row by row.
    pub a: Vec<Vec<f64>>,
    /// B, n by m.
    pub b: Vec<Vec<f64>>,
    /// C, p by n.
    pub c: Vec<Vec<f64>>,
    /// D, p by m.
    pub d: Vec<Vec<f64>>,
    /// The response of `C (xI − A)⁻¹ B + D`.
    pub response: MatrixResponse,
}

/// A matrix of transfer functions, one row for each output and one column for each input.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ExportedTransferMatrix {
    /// Where it stands in the result, as a JSON pointer.
    pub pointer: String,
    /// In which time it is.
    pub time_base: ModelTimeBase,
    /// Time between samples in seconds; null in continuous time.
    pub sample_time_s: Option<f64>,
    /// The same as python-control (`dt`) and MATLAB (`Ts`) write it, in seconds: 0 in continuous time.
    pub dt: f64,
    /// Numerators: of each entry the coefficients in descending powers.
    pub num: Vec<Vec<Vec<f64>>>,
    /// Denominators, likewise.
    pub den: Vec<Vec<Vec<f64>>>,
    /// The response of `num/den`, entry by entry.
    pub response: MatrixResponse,
}

/// The response of a matrix of systems; frequencies at a pole are left out.
fn response(sample_time_s: Option<f64>, at: impl Fn(f64) -> Option<Vec<Vec<Complex64>>>) -> MatrixResponse {
    let mut told = MatrixResponse { omega_rad_s: Vec::new(), value: Vec::new() };
    for omega in frequencies(sample_time_s) {
        let Some(value) = at(omega) else { continue };
        if value.iter().flatten().all(|z| z.re.is_finite() && z.im.is_finite()) {
            told.omega_rad_s.push(omega);
            told.value.push(value.iter().map(|row| row.iter().map(|z| [z.re, z.im]).collect()).collect());
        }
    }
    told
}

fn state_space(pointer: String, own: StateSpaceModel) -> Option<ExportedStateSpace> {
    let sample_time_s = own.sample_time_s;
    let rows = |m: nalgebra::DMatrix<Complex64>| m.row_iter().map(|row| row.iter().copied().collect()).collect();
    let response = match sample_time_s {
        None => {
            let system = own.check(Continuous).ok()?;
            response(None, |omega| system.response(omega).map(rows))
        }
        Some(period) => {
            let system = own.check(Discrete::new(period).ok()?).ok()?;
            response(sample_time_s, |omega| system.response(omega).map(rows))
        }
    };
    let (time_base, dt) = ModelTimeBase::of(sample_time_s);
    let StateSpaceModel { a, b, c, d, .. } = own;
    Some(ExportedStateSpace { pointer, time_base, sample_time_s, dt, a, b, c, d, response })
}

/// State space of a fraction of matrices.
fn realised(value: Value) -> Option<StateSpaceModel> {
    let model: MultivariableModel = serde_json::from_value(value).ok()?;
    let written = match model.check().ok()? {
        MultivariableSystem::Continuous(own) => realisation(&own),
        MultivariableSystem::Discrete(own) => realisation(&own),
    }?;
    match written {
        MultivariableModel::StateSpace(own) => Some(own),
        _ => None,
    }
}

fn realisation<T: TimeBase>(own: &Multivariable<T>) -> Option<MultivariableModel> {
    let model = own.to_state_space().ok()?;
    Some(MultivariableModel::from(&Multivariable::StateSpace(model)))
}

/// An entry's coefficients as they stand in a result.
fn coefficients(entry: &Value, name: &str) -> Option<Vec<f64>> {
    serde_json::from_value(entry.get(name)?.clone()).ok()
}

fn transfer_matrix(pointer: String, value: &Value) -> Option<ExportedTransferMatrix> {
    let entries: Vec<Vec<Value>> = serde_json::from_value(value.get("transfer_functions")?.clone()).ok()?;
    let columns = entries.first().map_or(0, Vec::len);
    if columns == 0 || entries.iter().any(|row| row.len() != columns) {
        return None;
    }
    let of = |name: &str| -> Option<Vec<Vec<Vec<f64>>>> {
        entries.iter().map(|row| row.iter().map(|entry| coefficients(entry, name)).collect()).collect()
    };
    let (num, den) = (of("num")?, of("den")?);
    let own_time = |owner: &Value| owner.get("sample_time_s").and_then(Value::as_f64);
    let sample_time_s = own_time(value).or_else(|| own_time(&entries[0][0]));
    let entry = |i: usize, j: usize| {
        let own =
            TransferFunctionModel { num: num[i][j].clone(), den: den[i][j].clone(), sample_time_s, delay_s: None };
        Model::TransferFunction(own).check().ok()
    };
    let systems: Vec<Vec<System>> =
        (0..entries.len()).map(|i| (0..columns).map(|j| entry(i, j)).collect::<Option<_>>()).collect::<Option<_>>()?;
    let at = |omega: f64| Some(systems.iter().map(|row| row.iter().map(|own| own.response(omega)).collect()).collect());
    let response = response(sample_time_s, at);
    let (time_base, dt) = ModelTimeBase::of(sample_time_s);
    Some(ExportedTransferMatrix { pointer, time_base, sample_time_s, dt, num, den, response })
}

/// Systems in state space, and matrices of transfer functions, by name.
pub(super) fn systems(
    result: &Value,
) -> (BTreeMap<String, ExportedStateSpace>, BTreeMap<String, ExportedTransferMatrix>) {
    let (mut spaces, mut matrices) = (BTreeMap::new(), BTreeMap::new());
    for own in found::systems(result) {
        let (name, pointer) = (own.name(), own.pointer());
        if own.value.get("transfer_functions").is_some() {
            if let Some(matrix) = transfer_matrix(pointer, &own.value) {
                matrices.insert(name, matrix);
            }
        } else if let Some(model) = written_in_state_space(own)
            && let Some(space) = state_space(pointer, model)
        {
            spaces.insert(name, space);
        }
    }
    (spaces, matrices)
}

fn written_in_state_space(own: Found) -> Option<StateSpaceModel> {
    if own.value.get("num").is_some() {
        return None;
    }
    if own.value.get("numerator").is_some() { realised(own.value) } else { serde_json::from_value(own.value).ok() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// 1/(s² + 2s + 3) and s/(s² + 2s + 3) of one input, by hand.
    fn by_hand(x: Complex64) -> [Complex64; 2] {
        let den = x * x + 2.0 * x + 3.0;
        [1.0 / den, x / den]
    }

    #[test]
    fn state_space_and_fractions_come_with_their_responses() {
        let space = json!({"a": [[0, 1], [-3, -2]], "b": [[0], [1]], "c": [[1, 0], [0, 1]], "d": [[0], [0]],
            "sample_time_s": null});
        let fraction = json!({"numerator": [[[1]], [[1, 0]]], "denominator": [[[1, 2, 3]]], "sample_time_s": null});
        let matrix = json!({"transfer_functions": [[{"num": [1], "den": [1, 2, 3]}], [{"num": [1, 0],
            "den": [1, 2, 3]}]], "sample_time_s": null});
        let result = json!({"plant": space, "controller": {"model": fraction}, "loop": matrix,
            "near_optimal": {"plant": space}, "degrees": {"numerator": 1, "denominator": 2}});
        let (spaces, matrices) = systems(&result);
        assert_eq!(spaces.keys().collect::<Vec<_>>(), ["controller", "plant"]);
        assert_eq!(matrices.keys().collect::<Vec<_>>(), ["loop"]);
        assert_eq!((spaces["controller"].pointer.as_str(), spaces["plant"].dt), ("/controller/model", 0.0));
        for told in [&spaces["plant"].response, &spaces["controller"].response, &matrices["loop"].response] {
            assert_eq!(told.omega_rad_s.len(), 9);
            for (omega, value) in told.omega_rad_s.iter().zip(&told.value) {
                for (own, truth) in value.iter().zip(by_hand(Complex64::new(0.0, *omega))) {
                    let own = Complex64::new(own[0][0], own[0][1]);
                    assert!((own - truth).norm() < 1e-14 * truth.norm(), "{omega}: {own} {truth}");
                }
            }
        }
    }

    #[test]
    fn a_sampled_system_is_told_below_its_fastest_frequency() {
        let result = json!({"plant": {"a": [[0.5]], "b": [[1, 2]], "c": [[1]], "d": [[0, 1]], "sample_time_s": 0.1}});
        let (spaces, _) = systems(&result);
        let own = &spaces["plant"];
        assert_eq!((own.dt, own.time_base), (0.1, ModelTimeBase::Discrete));
        let (omega, value) = (own.response.omega_rad_s[8], &own.response.value[8]);
        assert!(omega < std::f64::consts::PI / 0.1);
        let z = Complex64::new(0.0, 0.1 * omega).exp();
        for (own, truth) in value[0].iter().zip([1.0 / (z - 0.5), 2.0 / (z - 0.5) + 1.0]) {
            assert!((Complex64::new(own[0], own[1]) - truth).norm() < 1e-14, "{own:?} {truth}");
        }
    }

    #[test]
    fn what_is_no_system_is_left_out() {
        let ragged = json!({"a": [[0, 1], [-3]], "b": [[0], [1]], "c": [[1, 0]], "d": [[0]]});
        let uneven = json!({"transfer_functions": [[{"num": [1], "den": [1]}], []]});
        let (spaces, matrices) = systems(&json!({"plant": ragged, "loop": uneven}));
        assert!(spaces.is_empty() && matrices.is_empty());
    }
}
