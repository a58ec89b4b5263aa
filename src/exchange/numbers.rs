//! Numbers as files store them, made doubles.

/// How numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stored {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
    I64,
    U64,
}

impl Stored {
    pub(super) fn width(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 | Self::I64 | Self::U64 => 8,
        }
    }

    /// The numbers as doubles, and whether one had to be rounded to be one.
    pub(super) fn numbers(self, bytes: &[u8], is_big_endian: bool) -> (Vec<f64>, bool) {
        let width = self.width();
        let mut is_rounded = false;
        let values = bytes
            .chunks_exact(width)
            .map(|chunk| {
                // The least significant byte first, filled up on the right.
                let mut eight = [0_u8; 8];
                eight[..width].copy_from_slice(chunk);
                if is_big_endian {
                    eight[..width].reverse();
                }
                let bits = u64::from_le_bytes(eight);
                #[allow(clippy::cast_possible_truncation, reason = "the number has so many bits")]
                match self {
                    Self::I8 => f64::from(bits as u8 as i8),
                    Self::U8 => f64::from(bits as u8),
                    Self::I16 => f64::from(bits as u16 as i16),
                    Self::U16 => f64::from(bits as u16),
                    Self::I32 => f64::from(bits as u32 as i32),
                    Self::U32 => f64::from(bits as u32),
                    Self::F32 => f64::from(f32::from_bits(bits as u32)),
                    Self::F64 => f64::from_bits(bits),
                    Self::I64 => {
                        let value = bits as i64;
                        is_rounded |= value as f64 as i128 != i128::from(value);
                        value as f64
                    }
                    Self::U64 => {
                        is_rounded |= bits as f64 as u128 != u128::from(bits);
                        bits as f64
                    }
                }
            })
            .collect();
        (values, is_rounded)
    }
}
