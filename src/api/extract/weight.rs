//! What JSON takes in memory once it is read, from a look at its text: `[],` is three bytes and becomes a hundred.

/// A value in a list, with what lists keep in reserve while they grow.
const VALUE: u64 = 64;
/// A list that holds something.
const LIST: u64 = 128;
/// An object that holds something: a node of its tree.
const OBJECT: u64 = 704;
/// A text, beside its bytes.
const TEXT: u64 = 56;

/// Bytes that the JSON takes at most, read as any value; about right for numbers, never far too low.
pub(super) fn in_memory(json: &[u8]) -> u64 {
    let (mut bytes, mut in_text, mut escaped) = (VALUE, false, false);
    let mut before = 0;
    for byte in json {
        if in_text {
            bytes += 1;
            match byte {
                _ if escaped => escaped = false,
                b'\\' => escaped = true,
                b'"' => in_text = false,
                _ => {}
            }
            continue;
        }
        match byte {
            b'"' => {
                in_text = true;
                bytes += TEXT;
            }
            b',' => bytes += VALUE,
            b'[' => bytes += LIST,
            b'{' => bytes += OBJECT,
            // Empty ones take nothing beside their place.
            b']' if before == b'[' => bytes -= LIST,
            b'}' if before == b'{' => bytes -= OBJECT,
            _ => {}
        }
        if !byte.is_ascii_whitespace() {
            before = *byte;
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bombs_weigh_what_they_become() {
        let many = 1_000_u64;
        for (one, least) in [("[],", 32), ("{},", 32), ("[0],", 128), ("{\"\":0},", 600), ("[[[]]],", 200), ("1,", 32)]
        {
            let text = one.repeat(many as usize);
            assert!(in_memory(text.as_bytes()) >= many * least, "{one}");
        }
        // Numbers as they are recorded: no more than eight times their text.
        let text = "-0.123456,".repeat(1000);
        assert!(in_memory(text.as_bytes()) < 8 * text.len() as u64);
        // What stands in a text is text.
        assert!(in_memory(br#""[[[[,,,,{{{{\"[[[,""#) < 200);
    }
}
