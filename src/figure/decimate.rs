//! What of a long line a screen can show: in every pixel column the first, the least, the greatest and the last sample.
//!
//! A line through these four is, pixel for pixel, the line through all of them, so that no spike is lost; averages or
//! every n-th sample would lose it.

use std::collections::BTreeSet;

/// Samples that a column keeps at most; with no more than so many a column all are drawn.
pub(super) const KEPT: usize = 4;

/// The places of a line's samples that are drawn.
///
/// `column` gives the pixel column of a sample; samples of a column stand side by side. Where nothing is (`None`), the
/// first place of every gap is kept, so that it still breaks the line.
#[must_use]
pub(super) fn kept(y: &[Option<f64>], column: impl Fn(usize) -> i64) -> Vec<usize> {
    let mut places = Vec::new();
    let mut at = 0;
    while at < y.len() {
        let own = column(at);
        let run = |is_gap: bool| move |i: &usize| y[*i].is_none() == is_gap;
        if y[at].is_none() {
            places.push(at);
            at += (at..y.len()).take_while(run(true)).count();
            continue;
        }
        let end = at + (at..y.len()).take_while(run(false)).take_while(|i| column(*i) == own).count();
        if end - at <= KEPT {
            places.extend(at..end);
        } else {
            let value = |i: &usize| y[*i].unwrap_or(f64::NAN);
            // Of equal ones the first.
            let least = (at..end).min_by(|a, b| value(a).total_cmp(&value(b)).then(a.cmp(b)));
            let greatest = (at..end).max_by(|a, b| value(a).total_cmp(&value(b)).then(b.cmp(a)));
            let four: BTreeSet<usize> = [Some(at), least, greatest, Some(end - 1)].into_iter().flatten().collect();
            places.extend(four);
        }
        at = end;
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng::stream;
    use rand::RngExt;

    #[test]
    fn first_least_greatest_and_last_are_kept() {
        let y = [3.0, 1.0, 2.0, 9.0, 1.0, 4.0, 7.0, 7.5, 8.0].map(Some);
        assert_eq!(kept(&y, |i| i64::from(i >= 6)), [0, 1, 3, 5, 6, 7, 8]);
        assert_eq!(kept(&y, |_| 0), [0, 1, 3, 8]);
        assert_eq!(kept(&[Some(2.0); 6], |_| 0), [0, 5]);
    }

    #[test]
    fn gaps_stay() {
        let y = [Some(1.0), None, None, Some(2.0), Some(3.0), None];
        assert_eq!(kept(&y, |_| 0), [0, 1, 3, 4, 5]);
        assert_eq!(kept(&[None; 4], |_| 0), [0]);
    }

    /// One sample of 10 σ among 40,001 survives wherever it stands, and so does every column's range.
    #[test]
    fn no_spike_is_lost() {
        let mut random = stream(20_261_130, "spikes");
        for case in 0..200 {
            let (samples, columns) = (40_001, 280 + case * 8);
            // Sums of twelve uniform numbers: a deviation of 1, never above 6.
            let mut y: Vec<f64> =
                (0..samples).map(|_| (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0).collect();
            let spike = (random.random::<f64>() * samples as f64) as usize;
            y[spike] = if case % 2 == 0 { 10.0 } else { -10.0 };
            let y: Vec<Option<f64>> = y.into_iter().map(Some).collect();
            let column = |i: usize| (i * columns / samples) as i64;
            let places = kept(&y, column);
            assert!(places.contains(&spike), "case {case}: the spike at {spike} is lost");
            assert!(places.len() <= KEPT * columns && places.is_sorted(), "case {case}");
            let ends = |places: &mut dyn Iterator<Item = usize>| {
                places.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], i| {
                    let value = y[i].unwrap();
                    [low.min(value), high.max(value)]
                })
            };
            for own in [0, column(spike), columns as i64 - 1] {
                let all = ends(&mut (0..samples).filter(|i| column(*i) == own));
                let left = ends(&mut places.iter().copied().filter(|i| column(*i) == own));
                assert_eq!(all, left, "case {case}, column {own}");
            }
        }
    }
}
