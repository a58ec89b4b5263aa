//! From bytes to text.
//!
//! A byte order mark decides; then zero bytes at every other place, which only UTF-16 has; then whether it is UTF-8.
//! What is none of these is in the encoding of some system: a detector judges by the letters.

use crate::analysis::{Code, Problem};
use chardetng::{EncodingDetector, Iso2022JpDetection, Utf8Detection};
use encoding_rs::{UTF_16BE, UTF_16LE};

/// From so many bytes UTF-16 without a mark is told.
const LOOKED_AT: usize = 4096;

/// How a text is encoded, as its first bytes say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// UTF-8, or one of the encodings of which ASCII is a part.
    Utf8 {
        /// Whether it begins with a byte order mark.
        has_mark: bool,
    },
    /// UTF-16.
    Utf16 {
        /// Whether the low byte comes first.
        is_little_endian: bool,
        /// Whether it begins with a byte order mark.
        has_mark: bool,
    },
    /// No text.
    Binary,
}

/// What the first bytes say.
#[must_use]
pub fn recognise(head: &[u8]) -> Encoding {
    if head.starts_with(b"\xef\xbb\xbf") {
        return Encoding::Utf8 { has_mark: true };
    }
    for (mark, is_little_endian) in [(b"\xff\xfe", true), (b"\xfe\xff", false)] {
        if head.starts_with(mark) {
            return Encoding::Utf16 { is_little_endian, has_mark: true };
        }
    }
    let looked_at = &head[..head.len().min(LOOKED_AT)];
    let zeros = |parity: usize| looked_at.iter().skip(parity).step_by(2).filter(|byte| **byte == 0).count();
    let (even, odd) = (zeros(0), zeros(1));
    if even + odd == 0 {
        return Encoding::Utf8 { has_mark: false };
    }
    // A table is mostly digits, whose high byte is zero.
    let half = looked_at.len() / 2;
    match (10 * even > 9 * half && odd == 0, 10 * odd > 9 * half && even == 0) {
        (false, true) => Encoding::Utf16 { is_little_endian: true, has_mark: false },
        (true, false) => Encoding::Utf16 { is_little_endian: false, has_mark: false },
        _ => Encoding::Binary,
    }
}

/// The text, and the name of its encoding.
///
/// # Errors
/// Where bytes stand for no character.
pub fn decode(bytes: &[u8]) -> Result<(String, String), Problem> {
    let (encoding, named) = match recognise(bytes) {
        Encoding::Utf16 { is_little_endian, has_mark } => {
            let encoding = if is_little_endian { UTF_16LE } else { UTF_16BE };
            let mark = if has_mark { " with byte order mark" } else { "" };
            (encoding, format!("{}{mark}", encoding.name()))
        }
        Encoding::Utf8 { .. } => {
            let mut detector = EncodingDetector::new(Iso2022JpDetection::Deny);
            detector.feed(bytes, true);
            let encoding = detector.guess(None, Utf8Detection::Deny);
            (encoding, encoding.name().to_owned())
        }
        Encoding::Binary => {
            return Err(Problem::new(Code::Malformed, "no text", "the file has zero bytes, and is no UTF-16"));
        }
    };
    let (text, is_damaged) = encoding.decode_with_bom_removal(bytes);
    if is_damaged {
        return Err(Problem::new(
            Code::Malformed,
            "unreadable text",
            format!("the text seems to be in {named}, but some of its bytes stand for no character"),
        )
        .mend("Save the file as UTF-8."));
    }
    Ok((text.into_owned(), named))
}
