//! Numbers as cells hold them.

/// Why a cell holds none.
pub(super) enum NoNumber {
    Empty,
    Text,
    NotFinite,
}

/// Whether a cell says that its value is not there.
#[must_use]
pub fn is_missing(cell: &str) -> bool {
    let lower = cell.trim().to_ascii_lowercase();
    ["", "nan", "n/a", "na", "null", "none", "-", ".", "#n/a", "missing", "nd"].contains(&lower.as_str())
        || lower.trim_start_matches('-').starts_with("1.#") && !lower.contains("inf")
        || is_unseen(&lower)
}

/// A coordinate by which cameras of NDI say that they did not see a marker: the largest number of a DEC computer.
fn is_unseen(lower: &str) -> bool {
    lower.starts_with("-3.6973") && lower.ends_with("28") && lower.contains('e')
}

/// Whether a cell holds a number, be it a finite one or not.
#[must_use]
pub fn is_number(cell: &str, decimal_comma: bool) -> bool {
    parsed(cell.trim(), decimal_comma).is_some()
}

/// The finite number that a cell holds.
pub(super) fn number(text: &str, decimal_comma: bool) -> Result<f64, NoNumber> {
    /// Larger ones may be signs for something else.
    const LARGE: f64 = 1e28;
    let text = text.trim();
    if text.is_empty() {
        return Err(NoNumber::Empty);
    }
    match parsed(text, decimal_comma) {
        Some(value) if value.abs() < LARGE => Ok(value),
        Some(value) if value.is_finite() && !is_missing(&text.replacen(',', ".", 1)) => Ok(value),
        Some(_) => Err(NoNumber::NotFinite),
        // What other programs write for it.
        None if ["nan", "inf", "1.#"].iter().any(|sign| {
            let bare = text.trim_start_matches(['+', '-', '#']);
            bare.get(..sign.len()).is_some_and(|start| start.eq_ignore_ascii_case(sign))
        }) =>
        {
            Err(NoNumber::NotFinite)
        }
        None => Err(NoNumber::Text),
    }
}

fn parsed(text: &str, decimal_comma: bool) -> Option<f64> {
    let plain = if decimal_comma { with_comma(text) } else { text.parse().ok() };
    plain.or_else(|| with_d(text, decimal_comma))
}

/// A number with a decimal comma. A point in it would be one between thousands, or a sign that the comma is not what it
/// is taken for: then it is none.
fn with_comma(text: &str) -> Option<f64> {
    if text.contains('.') {
        return None;
    }
    let Some((whole, fraction)) = text.split_once(',') else { return text.parse().ok() };
    // More digits than any double needs, and no allocation for each cell.
    let mut buffer = [0_u8; 64];
    let (at, length) = (whole.len(), text.len());
    if length > buffer.len() || !fraction.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    buffer[..length].copy_from_slice(text.as_bytes());
    buffer[at] = b'.';
    std::str::from_utf8(&buffer[..length]).ok()?.parse().ok()
}

/// A number with D before its power of ten, as Fortran writes doubles.
fn with_d(text: &str, decimal_comma: bool) -> Option<f64> {
    let (digits, power) = text.split_once(['D', 'd'])?;
    let is_power = !power.is_empty() && power.trim_start_matches(['+', '-']).bytes().all(|b| b.is_ascii_digit());
    let is_digits = digits.bytes().all(|b| b.is_ascii_digit() || b"+-.,".contains(&b));
    if !is_power || !is_digits {
        return None;
    }
    let text = format!("{digits}e{power}");
    if decimal_comma { with_comma(&text) } else { text.parse().ok() }
}
