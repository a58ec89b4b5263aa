//! Rules for names, texts and attributes.

use crate::analysis::{Code, Problem};
use serde_json::Value;

/// Characters of a name, code or group at most.
pub(crate) const MAX_NAME: usize = 200;
/// Characters of a description at most.
pub(crate) const MAX_DESCRIPTION: usize = 20_000;
/// Characters of a reason at most.
pub(crate) const MAX_REASON: usize = 1000;
/// Bytes of a subject's attributes, as compact JSON, at most.
pub(crate) const MAX_ATTRIBUTES: usize = 64 << 10;
/// What a name looks like, for the OpenAPI document: something visible, and no control character.
pub(crate) const NAME_PATTERN: &str = r"^[^\x00-\x1f\x7f-\x9f]*[^\x00-\x1f\x7f-\x9f\s][^\x00-\x1f\x7f-\x9f]*$";

/// What a text looks like, for the OpenAPI document.
pub(crate) const TEXT_PATTERN: &str = r"^[^\x00]*$";

/// A name without the spaces around it.
///
/// # Errors
/// `invalid` for an empty or overlong name and for one with control characters.
pub(crate) fn name(text: &str, pointer: &str) -> Result<String, Problem> {
    let bad = |why: String| Problem::new(Code::Invalid, "bad name", why).at(pointer);
    if let Some(c) = text.chars().find(|c| c.is_control()) {
        return Err(bad(format!("the control character U+{:04X} is in it", u32::from(c)))
            .mend("Leave out line breaks, tabs and other control characters."));
    }
    let trimmed = text.trim();
    if trimmed.is_empty() {
        return Err(bad("it is empty".to_owned()).mend(format!("Give 1 to {MAX_NAME} characters.")));
    }
    let count = text.chars().count();
    if count > MAX_NAME {
        return Err(bad(format!("it has {count} characters")).mend(format!("Give 1 to {MAX_NAME} characters.")));
    }
    Ok(trimmed.to_owned())
}

/// A text of several lines.
///
/// # Errors
/// `invalid` for an overlong text and for one with a NUL.
pub(crate) fn description(text: &str, pointer: &str) -> Result<String, Problem> {
    let count = text.chars().count();
    let why = if count > MAX_DESCRIPTION {
        format!("it has {count} characters, and {MAX_DESCRIPTION} are taken at most")
    } else if text.contains('\0') {
        "the control character U+0000 is in it".to_owned()
    } else {
        return Ok(text.to_owned());
    };
    Err(Problem::new(Code::Invalid, "bad description", why).at(pointer))
}

/// A sentence that says why.
///
/// # Errors
/// `invalid` for an empty or overlong one and for one with control characters.
pub(crate) fn reason(text: &str, pointer: &str) -> Result<String, Problem> {
    let trimmed = text.trim();
    let count = trimmed.chars().count();
    if (1..=MAX_REASON).contains(&count) && !trimmed.chars().any(char::is_control) {
        return Ok(trimmed.to_owned());
    }
    Err(Problem::new(Code::Invalid, "bad reason", format!("it has {count} characters, or control characters"))
        .at(pointer)
        .mend(format!("Say why in 1 to {MAX_REASON} characters, on one line.")))
}

/// A display limit.
///
/// # Errors
/// `invalid` unless it is positive and finite.
pub(crate) fn display_limit(limit: f64, pointer: &str) -> Result<f64, Problem> {
    if limit > 0.0 && limit.is_finite() {
        return Ok(limit);
    }
    Err(Problem::new(Code::Invalid, "bad display limit", format!("it is {limit}, and must be positive and finite"))
        .at(pointer)
        .mend("Give the largest |y| that the subject's display shows, or null where there is no limit."))
}

/// A subject's attributes.
///
/// # Errors
/// `invalid` unless they are an object of at most [`MAX_ATTRIBUTES`] bytes.
pub(crate) fn attributes(value: Value, pointer: &str) -> Result<Value, Problem> {
    let bad = |why: String| Problem::new(Code::Invalid, "bad attributes", why).at(pointer);
    if !value.is_object() {
        return Err(bad("they are not an object".to_owned()).mend("Give an object such as {\"handedness\": \"left\"}."));
    }
    let bytes = value.to_string().len();
    if bytes > MAX_ATTRIBUTES {
        return Err(bad(format!("they take {bytes} bytes, and {MAX_ATTRIBUTES} are kept at most")));
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn names_are_trimmed_and_bounded() {
        assert_eq!(name(" gm 1 ", "/name").unwrap(), "gm 1");
        assert_eq!(name(&"ä".repeat(200), "/name").unwrap().chars().count(), 200);
        for bad in ["", "   ", "a\nb", "a\u{0}", "\u{85}", &"x".repeat(201)] {
            let problem = name(bad, "/name").unwrap_err();
            assert_eq!((problem.code, problem.location.as_deref()), (Code::Invalid, Some("/name")), "{bad:?}");
        }
    }

    #[test]
    fn limits_and_attributes() {
        assert!(display_limit(5.0, "/x").is_ok());
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(display_limit(bad, "/x").unwrap_err().code, Code::Invalid, "{bad}");
        }
        assert!(attributes(json!({"age": 23}), "/x").is_ok());
        for bad in [json!([]), json!({"x": "y".repeat(MAX_ATTRIBUTES)})] {
            assert_eq!(attributes(bad, "/x").unwrap_err().code, Code::Invalid);
        }
        assert!(description("two\nlines", "/x").is_ok());
        assert_eq!(description("\0", "/x").unwrap_err().code, Code::Invalid);
    }
}
