//! Models and matrices as a file of MATLAB.

use super::{ExportedModel, ExportedStateSpace, ExportedTransferMatrix, MatrixResponse, ModelExport};
use crate::exchange::write::mat::{self, MatValue};

fn text(text: &str) -> MatValue {
    MatValue::Text(text.to_owned())
}

fn named<const N: usize>(fields: [(&str, MatValue); N]) -> MatValue {
    MatValue::Struct(fields.map(|(name, value)| (name.to_owned(), value)).into())
}

fn model(own: &ExportedModel) -> MatValue {
    let part = |at: usize| own.response.value.iter().map(|z| z[at]).collect::<Vec<_>>();
    named([
        ("num", MatValue::row(&own.num)),
        ("den", MatValue::row(&own.den)),
        ("Ts", MatValue::number(own.dt)),
        ("delay_s", MatValue::number(own.delay_s)),
        ("time_base", text(own.time_base.name())),
        ("omega_rad_s", MatValue::row(&own.response.omega_rad_s)),
        ("response_re", MatValue::row(&part(0))),
        ("response_im", MatValue::row(&part(1))),
        ("pointer", text(&own.pointer)),
    ])
}

/// A part of a response: a row for each frequency, the entries of its matrix column by column.
fn part(response: &MatrixResponse, at: usize) -> MatValue {
    let row = |matrix: &Vec<Vec<[f64; 2]>>| {
        let columns = matrix.first().map_or(0, Vec::len);
        (0..columns).flat_map(|j| matrix.iter().map(move |row| row[j][at])).collect()
    };
    MatValue::Matrix(response.value.iter().map(row).collect())
}

fn space(own: &ExportedStateSpace) -> MatValue {
    let matrix = |rows: &Vec<Vec<f64>>| MatValue::Matrix(rows.clone());
    named([
        ("A", matrix(&own.a)),
        ("B", matrix(&own.b)),
        ("C", matrix(&own.c)),
        ("D", matrix(&own.d)),
        ("Ts", MatValue::number(own.dt)),
        ("time_base", text(own.time_base.name())),
        ("omega_rad_s", MatValue::row(&own.response.omega_rad_s)),
        ("response_re", part(&own.response, 0)),
        ("response_im", part(&own.response, 1)),
        ("pointer", text(&own.pointer)),
    ])
}

fn transfer_matrix(own: &ExportedTransferMatrix) -> MatValue {
    let cells = |rows: &Vec<Vec<Vec<f64>>>| {
        MatValue::Cells(rows.iter().map(|row| row.iter().map(|own| MatValue::row(own)).collect()).collect())
    };
    named([
        ("num", cells(&own.num)),
        ("den", cells(&own.den)),
        ("Ts", MatValue::number(own.dt)),
        ("time_base", text(own.time_base.name())),
        ("omega_rad_s", MatValue::row(&own.response.omega_rad_s)),
        ("response_re", part(&own.response, 0)),
        ("response_im", part(&own.response, 1)),
        ("pointer", text(&own.pointer)),
    ])
}

/// As a file of MATLAB: a struct for each system (`num`, `den` or `A`, `B`, `C`, `D`; `Ts`, `delay_s`, `time_base`, and
/// the response to compare with), a variable for each matrix and its covariance, and `volition`, which says where it is
/// from. `num` and `den` of a matrix of transfer functions are cells, as `tf` takes them.
#[must_use]
pub fn mat(export: &ModelExport) -> Vec<u8> {
    let mut variables = Vec::new();
    variables.extend(export.models.iter().map(|(name, own)| (name.clone(), model(own))));
    variables.extend(export.state_space.iter().map(|(name, own)| (name.clone(), space(own))));
    variables.extend(export.transfer_matrices.iter().map(|(name, own)| (name.clone(), transfer_matrix(own))));
    for (name, own) in &export.matrices {
        variables.push((name.clone(), MatValue::Matrix(own.value.clone())));
        if let Some(covariance) = &own.covariance {
            variables.push((format!("{name}_covariance"), MatValue::Matrix(covariance.clone())));
        }
    }
    let estimates: Vec<Vec<f64>> = export
        .parameters
        .iter()
        .map(|own| {
            let [low, high] = own.interval_95.unwrap_or([f64::NAN; 2]);
            vec![own.value.unwrap_or(f64::NAN), own.standard_error.unwrap_or(f64::NAN), low, high]
        })
        .collect();
    let names: Vec<&str> = export.parameters.iter().map(|own| own.name.as_str()).collect();
    let covariance = export.covariance.clone().map_or(MatValue::number(f64::NAN), MatValue::Matrix);
    let about = named([
        ("kind", text(&export.kind)),
        ("spec_sha256", text(&export.spec_sha256)),
        ("result_sha256", text(&export.result_sha256)),
        ("product_version", text(&export.product_version)),
        ("parameter_names", text(&names.join(","))),
        ("parameters", MatValue::Matrix(estimates)),
        ("covariance", covariance),
    ]);
    variables.push(("volition".to_owned(), about));
    mat::write(&variables)
}
