//! Samples as text.

use std::io::{self, Write};

/// Writes `t,<column>` and one row per sample, as RFC 4180 has it; every number reads back as the same double.
///
/// # Errors
/// Those of the writer.
pub fn csv(column: &str, sample_time_s: f64, values: &[f64], out: &mut impl Write) -> io::Result<()> {
    write!(out, "t,{column}\r\n")?;
    for (k, value) in values.iter().enumerate() {
        write!(out, "{:?},{value:?}\r\n", k as f64 * sample_time_s)?;
    }
    Ok(())
}
