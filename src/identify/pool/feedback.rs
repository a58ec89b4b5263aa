//! The feedback controllers of a pool: a table that is walked, never stored.

use super::factor::Factor;
use super::feedback_lists::{FeedbackLists, MappedPlant, Normalisation};
use super::routh;
use super::scan::{self, Extremes, Gains, Numerators, Scan};
use crate::ctl::{Ctl, Stopped};
use crate::identify::time::multiply;
use rayon::prelude::*;

/// Blocks that the table is cut into, if it has so many rows.
const BLOCKS: usize = 4096;

/// With so many denominators, no block needs to hold a part of one.
const ENOUGH: usize = 256;

/// Raw gains tested between two looks at the stop flag (about 20 ms).
const TESTS_PER_CHECK: usize = 1 << 20;

/// One feedback controller of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feedback {
    /// Position of its denominator.
    pub denominator: usize,
    /// Position of its numerator; `None` for zero feedback.
    pub numerator: Option<usize>,
    /// The factor in front of that numerator; 0 for zero feedback.
    pub gain: f64,
    /// Position of the gain in the list; `None` for zero feedback.
    pub gain_position: Option<usize>,
}

/// Stable controllers that share denominator and numerator, in order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row<'a> {
    /// Position of the denominator.
    pub denominator: usize,
    /// Position of the numerator; `None` for zero feedback.
    pub numerator: Option<usize>,
    /// What turns a listed gain into the factor in front of the numerator.
    pub unit: f64,
    /// The factors in front of the numerator; a single 0 for zero feedback.
    pub gains: &'a [f64],
    /// Their positions in the list of gains; empty for zero feedback.
    positions: &'a [usize],
}

impl Row<'_> {
    /// The positions of the gains in the list of gains; empty for zero feedback.
    #[must_use]
    pub fn positions(&self) -> &[usize] {
        self.positions
    }

    /// The controllers, in order.
    pub fn controllers(&self) -> impl Iterator<Item = Feedback> {
        (0..self.gains.len()).filter_map(|i| self.get(i))
    }

    fn get(&self, i: usize) -> Option<Feedback> {
        let gain = *self.gains.get(i)?;
        let Self { denominator, numerator, .. } = *self;
        Some(Feedback { denominator, numerator, gain, gain_position: self.positions.get(i).copied() })
    }
}

/// The feedback part of a pool, on a plant: every `gain · numerator / denominator` whose closed loop is stable.
///
/// # Order
/// The denominator is outermost; within it zero feedback comes first (once, where the gains hold zero), then the
/// numerators, and within a numerator the gains in listed order. Controllers whose closed loop is not stable within the
/// margin are left out and not counted.
#[derive(Debug, Clone)]
pub struct FeedbackTable {
    lists: FeedbackLists,
    plant: MappedPlant,
    /// The plant's numerator times each feedback numerator: what a gain multiplies in the closed-loop polynomial.
    steps: Vec<Vec<f64>>,
    /// For loops of degree four: the numerators side by side, and the gains in order.
    scan: Option<(Numerators, Gains)>,
    /// Moduli and positions of the listed gains by increasing modulus, positive and negative.
    by_modulus: [Vec<(f64, usize)>; 2],
    /// Rows (denominator, zero or numerator) per block.
    rows_per_block: usize,
    /// Number of controllers before each block, and in all.
    before: Vec<u64>,
}

/// A denominator of a table; see [`FeedbackTable::open`].
#[derive(Debug)]
pub struct Opened<'a> {
    table: &'a FeedbackTable,
    denominator: usize,
    /// The closed-loop polynomial without feedback.
    base: Vec<f64>,
}

impl Opened<'_> {
    /// Visits the stable controllers with this numerator whose factor in front of it has this sign and a modulus within
    /// these bounds (ends included), by increasing modulus.
    pub fn visit(&self, numerator: usize, negative: bool, [low, high]: [f64; 2], mut visit: impl FnMut(Feedback)) {
        let Self { table, denominator, base } = self;
        let Some(unit) = table.unit(*denominator, numerator) else { return };
        let listed = &table.by_modulus[usize::from(negative)];
        let first = listed.partition_point(|(modulus, _)| modulus * unit < low);
        let last = listed.partition_point(|(modulus, _)| modulus * unit <= high).max(first);
        let padding = table.plant.padding;
        for some in listed[first..last].chunks(scan::LANES) {
            let mut gains = [0.0; scan::LANES];
            for (gain, (_, position)) in gains.iter_mut().zip(some) {
                *gain = table.lists.gains[*position] * unit;
            }
            routh::stable_gains(&base[padding..], &table.steps[numerator][padding..], &gains[..some.len()], |i| {
                let (gain, gain_position) = (gains[i], Some(some[i].1));
                visit(Feedback { denominator: *denominator, numerator: Some(numerator), gain, gain_position });
            });
        }
    }
}

impl FeedbackTable {
    /// Counts the stable controllers, unless their numbers are known from an earlier table of the same lists on the
    /// same plant, and makes the table.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(super) fn new(
        lists: FeedbackLists,
        plant: MappedPlant,
        known: Option<&[u64]>,
        ctl: &Ctl,
    ) -> Result<Self, Stopped> {
        let steps: Vec<Vec<f64>> = lists.numerators.iter().map(|n| multiply(&plant.numerator, &n.mapped)).collect();
        let scan = (plant.padding == 0 && steps.iter().all(|step| step.len() == scan::LENGTH)).then(|| {
            let squares = match &lists.normalisation {
                Normalisation::None => None,
                Normalisation::Peak { numerators, .. } => Some(numerators.as_slice()),
            };
            (Numerators::new(&steps, squares), Gains::new(&lists.gains))
        });
        let by_modulus = [false, true].map(|negative| {
            let listed = lists.gains.iter().enumerate().filter(|(_, gain)| (**gain < 0.0) == negative);
            let mut moduli: Vec<(f64, usize)> = listed.map(|(at, gain)| (gain.abs(), at)).collect();
            moduli.sort_by(|a, b| a.0.total_cmp(&b.0));
            moduli
        });
        let mut table = Self { lists, plant, steps, scan, by_modulus, rows_per_block: 1, before: vec![0] };
        let rows = table.rows();
        table.rows_per_block = rows.div_ceil(BLOCKS).max(1);
        let per_denominator = table.rows_per_denominator();
        if table.lists.denominators.len() >= ENOUGH {
            // Whole denominators, which are counted several rows at a time.
            table.rows_per_block = table.rows_per_block.next_multiple_of(per_denominator);
        }
        let blocks = rows.div_ceil(table.rows_per_block);
        if let Some(known) = known.filter(|known| table.may_have(known, blocks)) {
            table.before = known.to_vec();
            return Ok(table);
        }
        ctl.set_total(rows as u64);
        let counts =
            (0..blocks).into_par_iter().map(|block| table.count(block, ctl)).collect::<Result<Vec<u64>, Stopped>>()?;
        for count in counts {
            table.before.push(table.before[table.before.len() - 1] + count);
        }
        Ok(table)
    }

    /// Whether these can be the numbers of controllers before each block.
    fn may_have(&self, before: &[u64], blocks: usize) -> bool {
        let most = (self.rows_per_block * self.lists.gains.len().max(1)) as u64;
        let each = |pair: &[u64]| pair[1].checked_sub(pair[0]).is_some_and(|count| count <= most);
        before.len() == blocks + 1 && before[0] == 0 && before.windows(2).all(each)
    }

    /// The number of controllers before each block, and in all: what takes long to find out about a large table.
    #[must_use]
    pub fn counts(&self) -> &[u64] {
        &self.before
    }

    /// Counts the stable controllers of a block.
    fn count(&self, block: usize, ctl: &Ctl) -> Result<u64, Stopped> {
        let rows = self.block(block);
        let per_denominator = self.rows_per_denominator();
        let mut count = 0;
        if rows.start.is_multiple_of(per_denominator) && rows.end.is_multiple_of(per_denominator) {
            for denominator in rows.start / per_denominator..rows.end / per_denominator {
                count += self.scan(denominator, None, ctl)?;
            }
        } else {
            self.walk(block, ctl, |row| {
                count += row.gains.len() as u64;
                Ok(())
            })?;
        }
        ctl.advance(rows.len() as u64);
        Ok(count)
    }

    /// The number of stable controllers with this denominator, zero feedback included. `into` takes in the moduli of
    /// the stable gains of each numerator, times the first scale and that numerator's own.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    ///
    /// # Panics
    /// If there are fewer scales or extremes than numerators, which is a mistake of the caller.
    pub fn scan(
        &self,
        denominator: usize,
        mut into: Option<(&mut Extremes, f64, &[f64])>,
        ctl: &Ctl,
    ) -> Result<u64, Stopped> {
        let first = denominator * self.rows_per_denominator();
        let own = first..first + self.rows_per_denominator();
        let zero = usize::from(self.lists.zero);
        let mut count = 0;
        let mut rest = own;
        if let Some((numerators, gains)) = &self.scan {
            let product = multiply(&self.plant.denominator, &self.lists.denominators[denominator].mapped);
            let base = std::array::from_fn(|i| product[i]);
            let (peak, vanishes) = match &self.lists.normalisation {
                Normalisation::None => (None, false),
                Normalisation::Peak { denominators, band, .. } => {
                    let (square, vanishes) = denominators[denominator];
                    (Some((square, *band)), vanishes)
                }
            };
            if !vanishes {
                let into = into.as_mut().map(|(extremes, scale, scales)| (&mut **extremes, *scale, *scales));
                count += pulp::Arch::new().dispatch(Scan { numerators, gains, base, peak, into });
            }
            rest.start += zero + numerators.len();
            if zero == 1 && routh::stable(&product[self.plant.padding..]) {
                count += 1;
            }
        }
        self.walk_rows(rest, ctl, |row| {
            count += row.gains.len() as u64;
            if let (Some((extremes, scale, scales)), Some(numerator)) = (&mut into, row.numerator) {
                row.gains.iter().for_each(|gain| extremes.take(numerator, gain * (*scale * scales[numerator])));
            }
            Ok(())
        })?;
        Ok(count)
    }

    /// The number of stable controllers.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.before[self.before.len() - 1]
    }

    /// Whether no controller is stable.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The number of blocks, the units of parallel work.
    #[must_use]
    pub fn blocks(&self) -> usize {
        self.before.len() - 1
    }

    /// The number of controllers before a block (or in all, for the block after the last).
    #[must_use]
    pub fn before(&self, block: usize) -> u64 {
        self.before[block]
    }

    /// The denominators, in order.
    #[must_use]
    pub fn denominators(&self) -> &[Factor] {
        &self.lists.denominators
    }

    /// The numerators at gain one, in order.
    #[must_use]
    pub fn numerators(&self) -> &[Factor] {
        &self.lists.numerators
    }

    /// The listed gains other than zero, in order.
    #[must_use]
    pub fn gains(&self) -> &[f64] {
        &self.lists.gains
    }

    /// The controller at a position.
    ///
    /// # Panics
    /// If there is none, which is a mistake of the caller.
    #[must_use]
    pub fn get(&self, index: u64) -> Feedback {
        assert!(index < self.len(), "feedback {index} of {}", self.len());
        let block = self.before.partition_point(|b| *b <= index) - 1;
        let mut left = index - self.before[block];
        let mut found = None;
        let never = Ctl::new();
        // The walk ends early by the only error that it knows.
        let _ = self.walk(block, &never, |row| {
            if let Some(feedback) = row.get(left as usize) {
                found = Some(feedback);
                return Err(Stopped(crate::ctl::StopReason::Cancelled));
            }
            left -= row.gains.len() as u64;
            Ok(())
        });
        match found {
            Some(feedback) => feedback,
            None => unreachable!("block {block} has fewer controllers than were counted"),
        }
    }

    /// The position of a controller of the table: the inverse of [`FeedbackTable::get`].
    ///
    /// # Panics
    /// If there is none, which is a mistake of the caller.
    #[must_use]
    pub fn index(&self, feedback: Feedback) -> u64 {
        let row = self.row(feedback.denominator, feedback.numerator);
        let block = row / self.rows_per_block;
        let mut index = self.before[block];
        let mut found = None;
        let never = Ctl::new();
        // Rows are visited without a stop flag, so there is no error to lose.
        let _ = self.walk_rows(block * self.rows_per_block..row + 1, &never, |visited| {
            if visited.denominator == feedback.denominator && visited.numerator == feedback.numerator {
                let within = match feedback.gain_position {
                    None => Some(0),
                    Some(position) => visited.positions.iter().position(|p| *p == position),
                };
                found = within.map(|within| index + within as u64);
            }
            index += visited.gains.len() as u64;
            Ok(())
        });
        match found {
            Some(index) => index,
            None => unreachable!("{feedback:?} is not a stable controller of the table"),
        }
    }

    /// The row of a numerator (or zero feedback) over a denominator.
    fn row(&self, denominator: usize, numerator: Option<usize>) -> usize {
        let zero = usize::from(self.lists.zero);
        denominator * self.rows_per_denominator() + numerator.map_or(0, |n| n + zero)
    }

    /// A denominator, to look at with some of the numerators and gains.
    #[must_use]
    pub fn open(&self, denominator: usize) -> Opened<'_> {
        let base = multiply(&self.plant.denominator, &self.lists.denominators[denominator].mapped);
        Opened { table: self, denominator, base }
    }

    /// Visits the rows of a denominator in order, without those that have no stable controller.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` or the visitor says so.
    pub fn walk_denominator<F>(&self, denominator: usize, ctl: &Ctl, visit: F) -> Result<(), Stopped>
    where
        F: FnMut(Row<'_>) -> Result<(), Stopped>,
    {
        let first = denominator * self.rows_per_denominator();
        self.walk_rows(first..first + self.rows_per_denominator(), ctl, visit)
    }

    /// The gains with which a numerator (or zero feedback) over a denominator makes a stable loop, in order.
    ///
    /// # Panics
    /// If a position is outside its list.
    #[must_use]
    pub fn gains_of(&self, denominator: usize, numerator: Option<usize>) -> Vec<f64> {
        assert!(denominator < self.lists.denominators.len(), "denominator {denominator}");
        assert!(numerator.is_none_or(|n| n < self.lists.numerators.len()), "numerator {numerator:?}");
        let mut gains = Vec::new();
        if numerator.is_none() && !self.lists.zero {
            return gains;
        }
        let row = self.row(denominator, numerator);
        // Rows are visited without a stop flag, so there is no error to lose.
        let _ = self.walk_rows(row..row + 1, &Ctl::new(), |found| {
            gains.extend_from_slice(found.gains);
            Ok(())
        });
        gains
    }

    /// Visits the rows of a block in order, without those that have no stable controller.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` or the visitor says so.
    pub fn walk<F>(&self, block: usize, ctl: &Ctl, visit: F) -> Result<(), Stopped>
    where
        F: FnMut(Row<'_>) -> Result<(), Stopped>,
    {
        self.walk_rows(self.block(block), ctl, visit)
    }

    /// The rows of a block.
    fn block(&self, block: usize) -> std::ops::Range<usize> {
        let first = block * self.rows_per_block;
        first..(first + self.rows_per_block).min(self.rows())
    }

    fn rows_per_denominator(&self) -> usize {
        self.lists.numerators.len() + usize::from(self.lists.zero)
    }

    fn walk_rows<F>(&self, rows: std::ops::Range<usize>, ctl: &Ctl, mut visit: F) -> Result<(), Stopped>
    where
        F: FnMut(Row<'_>) -> Result<(), Stopped>,
    {
        let per_denominator = self.rows_per_denominator();
        let mut opened = None;
        let mut base = Vec::new();
        let mut tests = 0;
        let mut scaled = vec![0.0; self.lists.gains.len()];
        let mut gains = Vec::with_capacity(self.lists.gains.len());
        let mut positions = Vec::with_capacity(self.lists.gains.len());
        for row in rows {
            let (denominator, slot) = (row / per_denominator, row % per_denominator);
            if opened != Some(denominator) {
                base = multiply(&self.plant.denominator, &self.lists.denominators[denominator].mapped);
                opened = Some(denominator);
            }
            if self.lists.zero && slot == 0 {
                if routh::stable(&base[self.plant.padding..]) {
                    visit(Row { denominator, numerator: None, unit: 1.0, gains: &[0.0], positions: &[] })?;
                }
                continue;
            }
            let numerator = slot - usize::from(self.lists.zero);
            let Some(unit) = self.unit(denominator, numerator) else { continue };
            let step = &self.steps[numerator];
            scaled.iter_mut().zip(&self.lists.gains).for_each(|(scaled, gain)| *scaled = gain * unit);
            gains.clear();
            positions.clear();
            routh::stable_gains(&base[self.plant.padding..], &step[self.plant.padding..], &scaled, |i| {
                gains.push(scaled[i]);
                positions.push(i);
            });
            if !gains.is_empty() {
                visit(Row { denominator, numerator: Some(numerator), unit, gains: &gains, positions: &positions })?;
            }
            tests += self.lists.gains.len();
            if tests > TESTS_PER_CHECK {
                tests = 0;
                ctl.check()?;
            }
        }
        ctl.check()
    }

    fn rows(&self) -> usize {
        self.lists.denominators.len() * self.rows_per_denominator()
    }

    /// The factor that turns a listed gain into the numerator's; `None` where the peak is infinite.
    fn unit(&self, denominator: usize, numerator: usize) -> Option<f64> {
        match &self.lists.normalisation {
            Normalisation::None => Some(1.0),
            Normalisation::Peak { denominators, numerators, band } => {
                let (d, vanishes) = &denominators[denominator];
                if *vanishes {
                    return None;
                }
                let peak = super::peak::largest_ratio(&numerators[numerator], d, band[0], band[1]).sqrt();
                (peak.is_finite() && peak > 0.0).then(|| 1.0 / peak)
            }
        }
    }
}
