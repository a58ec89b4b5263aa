//! Sequences that cannot be made, and why.

use crate::ctl::Stopped;

/// Why a sequence cannot be made. Every error but [`SequenceError::Stopped`] names the field that it is about.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SequenceError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// A shift register of this length has no maximum-length sequence, or too long a one.
    #[error("the order is {order}, and must be from {least} to {most}")]
    Order {
        /// As asked for.
        order: u32,
        /// The least.
        least: u32,
        /// The most.
        most: u32,
    },
    /// A number that must be positive and finite.
    #[error("{field} is {value}, and must be positive and finite")]
    NotPositive {
        /// The field, as a path from the sequence.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A number that is not finite, or outside its range.
    #[error("{field} is {value}, and must be from {least} to {most}")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// The least.
        least: f64,
        /// The most.
        most: f64,
    },
    /// A chip shorter than a sample would be skipped.
    #[error("a chip of {chip_s} s is shorter than the sample time of {sample_time_s} s, so that chips would be lost")]
    ChipBelowSample {
        /// Length of a chip.
        chip_s: f64,
        /// The sample time.
        sample_time_s: f64,
    },
    /// Recurrence coefficients of the wrong number.
    #[error("there are {found} coefficients, and a register of order {order} has {order}")]
    Coefficients {
        /// How many there are.
        found: usize,
        /// The order.
        order: u32,
    },
    /// A coefficient that is no residue.
    #[error("coefficient {index} is {value}, and must be from 0 to {most}")]
    Digit {
        /// Its place, from 0.
        index: usize,
        /// Its value.
        value: u8,
        /// The most.
        most: u8,
    },
    /// Coefficients whose sequence is shorter than the longest.
    #[error(
        "the coefficients {coefficients:?} are not primitive over GF({base}): their sequence repeats before {length} \
         chips"
    )]
    NotPrimitive {
        /// As given.
        coefficients: Vec<u8>,
        /// 2 or 3.
        base: u8,
        /// The length of a maximum-length sequence.
        length: u64,
    },
    /// There are fewer primitive polynomials.
    #[error(
        "there is no primitive polynomial {index} (counted from 0): there are {count} of order {order} over GF({base})"
    )]
    NoSuchPolynomial {
        /// As asked for.
        index: u64,
        /// How many there are.
        count: u64,
        /// The order.
        order: u32,
        /// 2 or 3.
        base: u8,
    },
    /// The phase is past the end of the sequence.
    #[error("the phase is {phase} chips, and the sequence has {length}")]
    Phase {
        /// As asked for.
        phase: u64,
        /// Chips of a period.
        length: u64,
    },
    /// The integral of a sequence whose chips do not sum to zero drifts from period to period.
    #[error(
        "a binary sequence has one chip more of one sign than of the other, so that its integral drifts: only ternary \
         ones are integrated"
    )]
    Integrated,
    /// A frequency that the sample time cannot represent.
    #[error("{field} reaches {frequency_hz} Hz, at or above the Nyquist frequency of {nyquist_hz} Hz")]
    AboveNyquist {
        /// The field.
        field: &'static str,
        /// The frequency.
        frequency_hz: f64,
        /// Half the sampling frequency.
        nyquist_hz: f64,
    },
    /// No line is left.
    #[error("{field} leaves no line: {why}")]
    NoLines {
        /// The field.
        field: &'static str,
        /// What there would have been to choose from.
        why: String,
    },
    /// A list that must increase strictly.
    #[error("{field} does not increase at position {index}")]
    NotIncreasing {
        /// The field.
        field: &'static str,
        /// The first position that is not above the one before, from 0.
        index: usize,
    },
    /// Two lists that must be equally long.
    #[error("{field} has {found} entries for {expected} lines")]
    Entries {
        /// The field.
        field: &'static str,
        /// Its length.
        found: usize,
        /// The number of lines.
        expected: usize,
    },
    /// A band or an interval that is empty.
    #[error("{field} goes from {from} to {to}, which is empty")]
    Empty {
        /// The field.
        field: &'static str,
        /// Its lower end.
        from: f64,
        /// Its upper end.
        to: f64,
    },
    /// The specified filter would be of a higher order than is computed reliably.
    #[error("the filter's edges ask for a Butterworth filter of order {order}, and at most {most} is taken")]
    FilterOrder {
        /// The order.
        order: f64,
        /// The most.
        most: usize,
    },
    /// Two settings of which one must be left out.
    #[error("{field} cannot be given together with {other}")]
    Together {
        /// The field.
        field: &'static str,
        /// The other.
        other: &'static str,
    },
    /// A number of periods of something that has none.
    #[error("periods are counted, but this sequence has no period")]
    NoPeriod,
    /// A sequence of too many samples, or of too few.
    #[error("the sequence would have {samples} samples; from 2 to {most} can be made")]
    Length {
        /// The samples.
        samples: f64,
        /// The most.
        most: usize,
    },
    /// Nothing to scale.
    #[error("the sequence is zero throughout and cannot be scaled")]
    Zero,
}

impl SequenceError {
    /// The path of the field that it is about, within the sequence (`generator/order`); `None` when it was stopped.
    #[must_use]
    pub fn field(&self) -> Option<&'static str> {
        Some(match self {
            Self::Stopped(_) => return None,
            Self::Order { .. } => "generator/order",
            Self::NotPositive { field, .. }
            | Self::OutOfRange { field, .. }
            | Self::AboveNyquist { field, .. }
            | Self::NoLines { field, .. }
            | Self::NotIncreasing { field, .. }
            | Self::Entries { field, .. }
            | Self::Empty { field, .. }
            | Self::Together { field, .. } => field,
            Self::ChipBelowSample { .. } => "generator/chip_s",
            Self::Coefficients { .. }
            | Self::Digit { .. }
            | Self::NotPrimitive { .. }
            | Self::NoSuchPolynomial { .. } => "generator/polynomial",
            Self::Phase { .. } => "generator/phase_chips",
            Self::Integrated => "generator/hold",
            Self::FilterOrder { .. } => "generator/transition_hz",
            Self::NoPeriod => "periods",
            Self::Length { .. } => "sample_time_s",
            Self::Zero => "scale",
        })
    }
}
