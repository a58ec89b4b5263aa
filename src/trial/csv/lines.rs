//! Lines of a table, and their cells.

use super::{Delimiter, MAX_LINE_BYTES};
use crate::trial::error::ReadError;
use std::io::{BufRead, BufReader, Read};

/// A record and the line on which it begins.
pub(super) struct Record {
    pub(super) line: u64,
    pub(super) text: Vec<u8>,
}

/// Records of a text: a line, or several where a quoted cell holds line ends.
pub(super) struct Lines<R> {
    source: BufReader<R>,
    line: u64,
    bytes_left: u64,
    max_bytes: u64,
}

impl<R: Read> Lines<R> {
    pub(super) fn new(source: R, max_bytes: u64) -> Self {
        Self { source: BufReader::with_capacity(64 * 1024, source), line: 0, bytes_left: max_bytes, max_bytes }
    }

    /// Passes over lines that are no records, until the next one has this number.
    pub(super) fn pass_to(&mut self, line: u64) -> Result<(), ReadError> {
        let mut text = Vec::new();
        while self.line + 1 < line {
            text.clear();
            if !self.append_line(self.line + 1, &mut text)? {
                break;
            }
        }
        Ok(())
    }

    /// The next record, in the memory of one that is not needed any more.
    pub(super) fn next_record(&mut self, spare: Vec<u8>) -> Result<Option<Record>, ReadError> {
        let line = self.line + 1;
        let mut text = spare;
        text.clear();
        let mut quotes;
        loop {
            let began = text.len();
            if !self.append_line(line, &mut text)? {
                return if text.is_empty() { Ok(None) } else { Err(ReadError::Quotes { line }) };
            }
            if line == 1 && began == 0 && text.starts_with(b"\xef\xbb\xbf") {
                text.drain(..3);
            }
            quotes = text.iter().filter(|byte| **byte == b'"').count();
            if quotes % 2 == 0 {
                break;
            }
            debug_assert!(text.len() > began, "a line has at least its line end");
        }
        if text.ends_with(b"\n") {
            text.pop();
        }
        // Text mode of Windows makes two of one carriage return.
        while text.ends_with(b"\r") {
            text.pop();
        }
        if quotes == 0 && text.contains(&b'\r') {
            return Err(ReadError::CarriageReturn { line });
        }
        if let Err(error) = std::str::from_utf8(&text) {
            return Err(ReadError::NotUtf8 { line, byte: error.valid_up_to() + 1 });
        }
        Ok(Some(Record { line, text }))
    }

    /// Appends the next line with its line end; false at the end of the text.
    fn append_line(&mut self, record_line: u64, text: &mut Vec<u8>) -> Result<bool, ReadError> {
        let room = (MAX_LINE_BYTES + 1).saturating_sub(text.len()) as u64;
        let allowed = room.min(self.bytes_left.saturating_add(1));
        let count = self.source.by_ref().take(allowed).read_until(b'\n', text)?;
        if count as u64 > self.bytes_left {
            return Err(ReadError::TooManyBytes { limit: self.max_bytes });
        }
        self.bytes_left -= count as u64;
        if text.len() > MAX_LINE_BYTES {
            return Err(ReadError::LineTooLong { line: record_line, limit: MAX_LINE_BYTES });
        }
        self.line += u64::from(count > 0);
        Ok(count > 0)
    }
}

/// The cells of a record; quotes are resolved as RFC 4180 has it.
pub(super) fn cells(record: &Record, delimiter: Delimiter) -> Result<Vec<String>, ReadError> {
    let quotes = || ReadError::Quotes { line: record.line };
    let text = std::str::from_utf8(&record.text).map_err(|_| ReadError::NotUtf8 { line: record.line, byte: 1 })?;
    split(text, delimiter).ok_or_else(quotes)
}

/// The cells of a line; `None` where its quotes do not pair up. Between spaces there are no quotes: names in them lose
/// them.
#[must_use]
pub fn split(text: &str, delimiter: Delimiter) -> Option<Vec<String>> {
    let Some(character) = delimiter.character() else {
        return Some(text.split_ascii_whitespace().map(|cell| cell.trim_matches('"').to_owned()).collect());
    };
    if !text.contains('"') {
        return Some(text.split(character).map(str::to_owned).collect());
    }
    // All delimiters are ASCII.
    let byte = character as u8;
    check_quotes(text.as_bytes(), byte)?;
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).delimiter(byte).from_reader(text.as_bytes());
    let mut cells = csv::StringRecord::new();
    reader.read_record(&mut cells).ok()?.then(|| cells.iter().map(str::to_owned).collect())
}

/// `None` unless every quoted cell is quoted from its first to its last character. The csv crate would accept more, and
/// guess.
fn check_quotes(text: &[u8], delimiter: u8) -> Option<()> {
    let mut i = 0;
    loop {
        if text.get(i) == Some(&b'"') {
            i += 1;
            loop {
                i += text[i..].iter().position(|byte| *byte == b'"')? + 1;
                match text.get(i) {
                    Some(b'"') => i += 1,
                    Some(byte) if *byte == delimiter => break,
                    None => break,
                    Some(_) => return None,
                }
            }
        } else {
            let end = text[i..].iter().position(|byte| *byte == delimiter).map_or(text.len(), |n| i + n);
            if text[i..end].contains(&b'"') {
                return None;
            }
            i = end;
        }
        if i >= text.len() {
            return Some(());
        }
        i += 1;
    }
}
