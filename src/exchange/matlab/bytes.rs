//! Bytes in either order, taken one by one.

use super::error::MatError;

/// A part of a file that is read from its start.
#[derive(Clone, Copy)]
pub(super) struct Bytes<'a> {
    left: &'a [u8],
    pub(super) is_big_endian: bool,
}

impl<'a> Bytes<'a> {
    pub(super) fn new(left: &'a [u8], is_big_endian: bool) -> Self {
        Self { left, is_big_endian }
    }

    pub(super) fn len(&self) -> usize {
        self.left.len()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.left.is_empty()
    }

    pub(super) fn take(&mut self, count: usize, what: &'static str) -> Result<&'a [u8], MatError> {
        let (taken, left) = self.left.split_at_checked(count).ok_or(MatError::Truncated(what))?;
        self.left = left;
        Ok(taken)
    }

    /// Passes over so many bytes, or what is left.
    pub(super) fn pass(&mut self, count: usize) {
        self.left = &self.left[count.min(self.left.len())..];
    }

    pub(super) fn u32(&mut self, what: &'static str) -> Result<u32, MatError> {
        let bytes = self.take(4, what)?;
        let mut four = [0; 4];
        four.copy_from_slice(bytes);
        Ok(if self.is_big_endian { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) })
    }
}
