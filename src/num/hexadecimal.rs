//! Bytes as text, two digits a byte.

use std::fmt::Write as _;

/// Bytes in lower-case hexadecimal.
#[must_use]
pub fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// The bytes of a text that [`hexadecimal`] wrote; `None` where it is no such text.
#[must_use]
pub fn bytes(text: &str) -> Option<Vec<u8>> {
    let digit = |c: u8| match c {
        b'0'..=b'9' => Some(c - b'0'),
        b'a'..=b'f' => Some(c - b'a' + 10),
        _ => None,
    };
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    if !rest.is_empty() {
        return None;
    }
    pairs.iter().map(|[high, low]| Some(16 * digit(*high)? + digit(*low)?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_survive_and_other_text_is_refused() {
        let all: Vec<u8> = (0..=255).collect();
        assert_eq!(&hexadecimal(&all)[..8], "00010203");
        assert_eq!(bytes(&hexadecimal(&all)), Some(all));
        assert_eq!(bytes(""), Some(vec![]));
        for bad in ["0", "0g", "0A", "é0", "+1"] {
            assert_eq!(bytes(bad), None, "{bad}");
        }
    }
}
