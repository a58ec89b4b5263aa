//! Sound: one column as samples of 32-bit floating point between −1 and 1, with what 1 stands for said in the file.

use super::Sequence;
use crate::analysis::{Code, Problem};

/// Floating point, of the formats of a wave file.
const FLOAT: u16 = 3;

/// A rate is a whole number of samples a second, to this part.
const TOLERANCE: f64 = 1e-9;

/// A wave file, with what a sample of 1 stands for.
#[derive(Debug, Clone, PartialEq)]
pub struct Wave {
    /// The file.
    pub bytes: Vec<u8>,
    /// What a sample of 1 stands for, in the unit of the signal.
    pub full_scale: f64,
}

fn chunk(out: &mut Vec<u8>, name: &[u8; 4], data: &[u8]) {
    out.extend(name);
    out.extend(u32::try_from(data.len()).unwrap_or(u32::MAX).to_le_bytes());
    out.extend(data);
    // Chunks begin at even places.
    out.resize(out.len().next_multiple_of(2), 0);
}

/// A column of a sequence as sound: the one named, or the first that is no time. `full_scale` is what a sample of 1
/// stands for; without it, the largest magnitude of the column.
///
/// # Errors
/// Where there is no such column, the rate is no whole number of samples a second, or a sample is above full scale.
pub fn write(sequence: &Sequence, column: Option<&str>, full_scale: Option<f64>) -> Result<Wave, Problem> {
    let invalid = |title: &str, why: String| Problem::new(Code::Invalid, title, why);
    let names: Vec<&str> = sequence.columns.iter().map(|(name, _)| name.as_str()).filter(|name| *name != "t").collect();
    let wanted = column.or(names.first().copied()).unwrap_or_default();
    let Some((name, values)) = sequence.columns.iter().find(|(name, _)| name == wanted && name != "t") else {
        let why = format!("there is no column '{wanted}'");
        return Err(invalid("no such column", why).at("column").mend(format!("Name one of {}.", names.join(", "))));
    };
    let rate = 1.0 / sequence.sample_time_s;
    let whole = rate.round();
    if !(1.0..=f64::from(u32::MAX / 4)).contains(&whole) || (rate - whole).abs() > TOLERANCE * whole {
        let why = format!("{rate} samples a second are no whole number, and sound has one");
        return Err(invalid("no rate of sound", why).mend("Take CSV, MATLAB or NumPy, which state the sample time."));
    }
    let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let full_scale = full_scale.unwrap_or(if largest > 0.0 { largest } else { 1.0 });
    if !(full_scale.is_normal() && full_scale > 0.0) || largest > full_scale {
        let why = format!("the column reaches {largest}, and full scale is {full_scale}");
        return Err(invalid("above full scale", why).at("full_scale").mend("Give at least the largest magnitude."));
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole, and in range")]
    let rate = whole as u32;
    #[allow(clippy::cast_possible_truncation, reason = "sound has single precision")]
    let samples: Vec<u8> = values.iter().flat_map(|value| ((value / full_scale) as f32).to_le_bytes()).collect();
    let mut form = Vec::new();
    form.extend(FLOAT.to_le_bytes());
    form.extend(1_u16.to_le_bytes());
    form.extend(rate.to_le_bytes());
    form.extend((4 * rate).to_le_bytes());
    form.extend(4_u16.to_le_bytes());
    form.extend(32_u16.to_le_bytes());
    form.extend(0_u16.to_le_bytes());
    let mut comment = b"INFO".to_vec();
    let said = format!("column {name}; a sample of 1 is {full_scale:?} in the unit of the signal\0");
    chunk(&mut comment, b"ICMT", said.as_bytes());
    let mut body = b"WAVE".to_vec();
    chunk(&mut body, b"fmt ", &form);
    chunk(&mut body, b"fact", &u32::try_from(values.len()).unwrap_or(u32::MAX).to_le_bytes());
    chunk(&mut body, b"LIST", &comment);
    chunk(&mut body, b"data", &samples);
    let mut bytes = Vec::new();
    chunk(&mut bytes, b"RIFF", &body);
    Ok(Wave { bytes, full_scale })
}
