//! Samples as text.

use std::io::{self, Write};

/// Writes `t` and the named columns, one row per sample, as RFC 4180 has it; every number reads back as the same
/// double.
///
/// There are as many rows as the shortest column has samples.
///
/// # Errors
/// Those of the writer.
pub fn csv(sample_time_s: f64, columns: &[(&str, &[f64])], out: &mut impl Write) -> io::Result<()> {
    write!(out, "t")?;
    for (name, _) in columns {
        write!(out, ",{name}")?;
    }
    write!(out, "\r\n")?;
    let rows = columns.iter().map(|(_, values)| values.len()).min().unwrap_or(0);
    for k in 0..rows {
        write!(out, "{:?}", k as f64 * sample_time_s)?;
        for (_, values) in columns {
            write!(out, ",{:?}", values[k])?;
        }
        write!(out, "\r\n")?;
    }
    Ok(())
}
