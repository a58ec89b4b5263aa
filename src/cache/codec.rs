//! Numbers as bytes: little-endian, in pieces of a megabyte or so, and no length believed beyond what is there.
//!
//! What is read may be damaged: whether it is shows at its end, after all of it has been taken in. Until then a wrong
//! length costs no more memory than the file is long, and nothing panics.

use crate::ctl::{Ctl, Stopped};
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use std::io::{self, Read, Write};

/// Values, and bytes, between two looks at the stop flag.
const PIECE: usize = 1 << 18;

/// Records in a block, and blocks that are read, or written, at a time: some megabytes, while the threads work on those
/// before.
const BLOCK: usize = 1024;
const BLOCKS: usize = 16;

/// Longer blocks make no sense.
const LONGEST_BLOCK: u64 = 1 << 28;

/// The bytes make no sense.
pub(crate) fn invalid(what: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

fn stopped(stopped: Stopped) -> io::Error {
    io::Error::new(io::ErrorKind::Interrupted, stopped)
}

/// A value of fixed size.
pub(crate) trait Pod: Copy {
    const BYTES: usize;

    fn put(self, into: &mut Vec<u8>);

    /// From exactly so many bytes.
    fn get(from: &[u8]) -> Self;
}

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Pod for $number {
            const BYTES: usize = size_of::<$number>();

            #[inline(always)]
            fn put(self, into: &mut Vec<u8>) {
                into.extend_from_slice(&self.to_le_bytes());
            }

            #[inline(always)]
            fn get(from: &[u8]) -> Self {
                let mut bytes = [0; size_of::<$number>()];
                bytes.copy_from_slice(from);
                Self::from_le_bytes(bytes)
            }
        }
    )*};
}

numbers!(u8, i16, u32, u64, f32, f64);

impl<T: Pod, const N: usize> Pod for [T; N] {
    const BYTES: usize = N * T::BYTES;

    #[inline(always)]
    fn put(self, into: &mut Vec<u8>) {
        self.into_iter().for_each(|value| value.put(into));
    }

    #[inline(always)]
    fn get(from: &[u8]) -> Self {
        std::array::from_fn(|i| T::get(&from[i * T::BYTES..(i + 1) * T::BYTES]))
    }
}

macro_rules! complex {
    ($($complex:ident of $part:ty),*) => {$(
        impl Pod for $complex {
            const BYTES: usize = 2 * <$part>::BYTES;

            #[inline(always)]
            fn put(self, into: &mut Vec<u8>) {
                [self.re, self.im].put(into);
            }

            #[inline(always)]
            fn get(from: &[u8]) -> Self {
                let [re, im] = Pod::get(from);
                Self { re, im }
            }
        }
    )*};
}

complex!(Complex32 of f32, Complex64 of f64);

/// A value of its own size.
pub(crate) trait Record: Sized {
    fn put(&self, into: &mut Vec<u8>);

    /// # Errors
    /// [`io::ErrorKind::InvalidData`] where the bytes are none.
    fn get(from: &mut Slice<'_>) -> io::Result<Self>;
}

/// Values one after another, with their number before them.
pub(crate) fn put_all<T: Pod>(values: &[T], into: &mut Vec<u8>) {
    (values.len() as u32).put(into);
    into.reserve(values.len() * T::BYTES);
    values.iter().for_each(|value| value.put(into));
}

/// Bytes of a block that are still to be read.
pub(crate) struct Slice<'a>(&'a [u8]);

impl Slice<'_> {
    fn bytes(&mut self, count: usize) -> io::Result<&[u8]> {
        let (taken, left) = self.0.split_at_checked(count).ok_or_else(|| invalid("a block ends early"))?;
        self.0 = left;
        Ok(taken)
    }

    pub(crate) fn pod<T: Pod>(&mut self) -> io::Result<T> {
        self.bytes(T::BYTES).map(T::get)
    }

    /// What [`put_all`] wrote.
    pub(crate) fn all<T: Pod, C: FromIterator<T>>(&mut self) -> io::Result<C> {
        let count = self.pod::<u32>()? as usize;
        let bytes = self.bytes(count.checked_mul(T::BYTES).ok_or_else(|| invalid("a list is too long"))?)?;
        Ok(bytes.chunks_exact(T::BYTES).map(T::get).collect())
    }
}

/// Writes.
pub(crate) struct Sink<'a> {
    to: &'a mut dyn Write,
    ctl: &'a Ctl,
}

impl<'a> Sink<'a> {
    pub(crate) fn new(to: &'a mut dyn Write, ctl: &'a Ctl) -> Self {
        Self { to, ctl }
    }

    pub(crate) fn pod<T: Pod>(&mut self, value: T) -> io::Result<()> {
        let mut bytes = Vec::with_capacity(T::BYTES);
        value.put(&mut bytes);
        self.to.write_all(&bytes)
    }

    pub(crate) fn array<T: Pod>(&mut self, values: &[T]) -> io::Result<()> {
        self.pod(values.len() as u64)?;
        let mut bytes = Vec::with_capacity(T::BYTES * values.len().min(PIECE));
        for piece in values.chunks(PIECE) {
            self.ctl.check().map_err(stopped)?;
            bytes.clear();
            piece.iter().for_each(|value| value.put(&mut bytes));
            self.to.write_all(&bytes)?;
        }
        Ok(())
    }

    pub(crate) fn records<T: Record + Sync>(&mut self, records: &[T]) -> io::Result<()> {
        self.pod(records.len() as u64)?;
        for some in records.chunks(BLOCK * BLOCKS) {
            self.ctl.check().map_err(stopped)?;
            let encode = |block: &[T]| {
                let mut bytes = Vec::new();
                block.iter().for_each(|record| record.put(&mut bytes));
                bytes
            };
            let blocks: Vec<Vec<u8>> = some.par_chunks(BLOCK).map(encode).collect();
            for block in blocks {
                self.pod(block.len() as u64)?;
                self.to.write_all(&block)?;
            }
        }
        Ok(())
    }
}

/// Reads.
pub(crate) struct Source<'a> {
    from: &'a mut (dyn Read + Send),
    /// Bytes that are there.
    left: u64,
    ctl: &'a Ctl,
}

impl<'a> Source<'a> {
    pub(crate) fn new(from: &'a mut (dyn Read + Send), left: u64, ctl: &'a Ctl) -> Self {
        Self { from, left, ctl }
    }

    /// Exactly so many bytes, which are there.
    fn bytes(&mut self, count: u64, into: &mut Vec<u8>) -> io::Result<()> {
        into.clear();
        self.left = self.left.checked_sub(count).ok_or_else(|| invalid("it ends early"))?;
        into.reserve_exact(usize::try_from(count).map_err(|_| invalid("it does not fit into memory"))?);
        let read = (&mut *self.from).take(count).read_to_end(into)?;
        if read as u64 == count { Ok(()) } else { Err(invalid("it ends early")) }
    }

    pub(crate) fn pod<T: Pod>(&mut self) -> io::Result<T> {
        let mut bytes = Vec::new();
        self.bytes(T::BYTES as u64, &mut bytes)?;
        Ok(T::get(&bytes))
    }

    /// A length of values of at least so many bytes, all of which are there.
    fn length(&mut self, each: usize) -> io::Result<usize> {
        let length = self.pod::<u64>()?;
        if length > self.left / each as u64 {
            return Err(invalid("a list is longer than what is there"));
        }
        usize::try_from(length).map_err(|_| invalid("a list does not fit into memory"))
    }

    pub(crate) fn array<T: Pod>(&mut self) -> io::Result<Vec<T>> {
        let length = self.length(T::BYTES)?;
        let mut values = Vec::with_capacity(length);
        let mut bytes = Vec::new();
        while values.len() < length {
            self.ctl.check().map_err(stopped)?;
            let piece = PIECE.min(length - values.len());
            self.bytes((piece * T::BYTES) as u64, &mut bytes)?;
            values.extend(bytes.chunks_exact(T::BYTES).map(T::get));
        }
        Ok(values)
    }

    /// Blocks that are decoded while the next ones are read.
    pub(crate) fn records<T: Record + Send>(&mut self) -> io::Result<Vec<T>> {
        let count = self.length(1)?;
        let mut records: Vec<T> = Vec::new();
        // No more memory than the file is long, whatever it says; more is asked for as records come.
        let believed = count.min(usize::try_from(self.left).unwrap_or(usize::MAX) / size_of::<T>().max(1));
        records.try_reserve_exact(believed).map_err(|_| invalid("a list does not fit into memory"))?;
        let mut blocks = self.blocks(count)?;
        let mut asked = 0;
        while asked < count {
            let many = (BLOCK * BLOCKS).min(count - asked);
            asked += many;
            let (read, next) = rayon::join(|| decode(&blocks, many), || self.blocks(count - asked));
            records.extend(read?.into_iter().flatten());
            blocks = next?;
        }
        Ok(records)
    }

    /// The next blocks, of so many records that are left.
    fn blocks(&mut self, records: usize) -> io::Result<Vec<Vec<u8>>> {
        self.ctl.check().map_err(stopped)?;
        let count = records.div_ceil(BLOCK).min(BLOCKS);
        let mut blocks = Vec::with_capacity(count);
        for _ in 0..count {
            let length = self.pod::<u64>()?;
            if length > LONGEST_BLOCK {
                return Err(invalid("a block is too long"));
            }
            let mut block = Vec::new();
            self.bytes(length, &mut block)?;
            blocks.push(block);
        }
        Ok(blocks)
    }
}

fn decode<T: Record + Send>(blocks: &[Vec<u8>], records: usize) -> io::Result<Vec<Vec<T>>> {
    let block = |(at, bytes): (usize, &Vec<u8>)| {
        let mut slice = Slice(bytes);
        let count = BLOCK.min(records - at * BLOCK);
        let read = (0..count).map(|_| T::get(&mut slice)).collect::<io::Result<Vec<T>>>()?;
        if slice.0.is_empty() { Ok(read) } else { Err(invalid("a block has something left over")) }
    };
    blocks.par_iter().enumerate().map(block).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ctl::StopReason;

    #[derive(Debug, Clone, PartialEq)]
    struct Word(Vec<f32>, u8);

    impl Record for Word {
        fn put(&self, into: &mut Vec<u8>) {
            put_all(&self.0, into);
            self.1.put(into);
        }

        fn get(from: &mut Slice<'_>) -> io::Result<Self> {
            Ok(Self(from.all()?, from.pod()?))
        }
    }

    type Everything = (u64, Vec<[f32; 3]>, Vec<Complex64>, Vec<Word>);

    fn everything(words: usize) -> Everything {
        let word = |i: usize| Word((0..i % 7).map(|x| x as f32 * 0.3).collect(), i as u8);
        (7, vec![[1.0, f32::NEG_INFINITY, -0.0]; 5], vec![Complex64::new(1e-300, -3.0)], (0..words).map(word).collect())
    }

    fn written(all: &Everything) -> Vec<u8> {
        let (mut bytes, ctl) = (Vec::new(), Ctl::new());
        let mut sink = Sink::new(&mut bytes, &ctl);
        sink.pod(all.0).unwrap();
        sink.array(&all.1).unwrap();
        sink.array(&all.2).unwrap();
        sink.records(&all.3).unwrap();
        bytes
    }

    fn read(bytes: &[u8], ctl: &Ctl) -> io::Result<Everything> {
        let mut reader = bytes;
        let mut source = Source::new(&mut reader, bytes.len() as u64, ctl);
        Ok((source.pod()?, source.array()?, source.array()?, source.records()?))
    }

    #[test]
    fn what_was_written_is_read() {
        for words in [0, 1, BLOCK, 3 * BLOCK * BLOCKS + 5] {
            let all = everything(words);
            assert_eq!(read(&written(&all), &Ctl::new()).unwrap(), all);
        }
    }

    #[test]
    fn damage_is_an_error_or_other_values_but_no_panic_and_no_great_memory() {
        let all = everything(100);
        let bytes = written(&all);
        for cut in 0..bytes.len() {
            let kind = read(&bytes[..cut], &Ctl::new()).unwrap_err().kind();
            assert_eq!(kind, io::ErrorKind::InvalidData, "cut at {cut}");
        }
        for at in 0..bytes.len() {
            for flip in [1, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] ^= flip;
                if let Ok(found) = read(&damaged, &Ctl::new()) {
                    // By their bytes: −0 is equal to 0.
                    assert!(written(&found) != bytes, "byte {at}");
                }
            }
        }
    }

    #[test]
    fn whoever_is_asked_to_stop_says_so() {
        let ctl = Ctl::new();
        ctl.stop(StopReason::Shutdown);
        let error = read(&written(&everything(1)), &ctl).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::Interrupted);
    }
}
