//! What is kept of clusters against every member, in double precision.

use super::cluster::Cluster;
use super::deviations::{Directions, Measure, PER_CHUNK, Scratch, Split, along, crude_logarithms, fill};
use super::extent::{Extent, Widest};
use super::line_lanes::{LineLanes, Pair, Rows, pairs};
use super::members::{GAIN_BITS, Row, Table};
use super::sample::{Sample, Splitter};
use super::size::{ALL, DIRECTIONS};
use crate::num::rng;
use num_complex::Complex64;
use pulp::{Simd, WithSimd};
use rand::RngExt;

/// Controllers of 8 denominators, 4 numerators and 16 gains.
struct Pool {
    rows: Vec<Row>,
    gains: Vec<f64>,
    denominators: [Vec<Vec<Complex64>>; 2],
    packed: [Rows; 2],
}

impl Pool {
    /// Around a loop, by factors that differ from one by so much.
    fn around(of: &[Complex64], spread: f64, seed: u64) -> Self {
        let mut rng = rng::stream(seed, "deviations");
        let mut draw = || spread * (2.0 * rng.random::<f64>() - 1.0);
        let mut factors = |count: usize, of: &[Complex64]| -> Vec<Vec<Complex64>> {
            (0..count).map(|_| of.iter().map(|l| l * (1.0 + Complex64::new(draw(), draw()))).collect()).collect()
        };
        let all = [factors(8, of), factors(4, &vec![Complex64::ONE; of.len()])];
        let gains = (0..16).map(|_| 1.0 + 0.5 * draw()).collect();
        Self::new(all, gains, of.len())
    }

    fn new(denominators: [Vec<Vec<Complex64>>; 2], gains: Vec<f64>, lines: usize) -> Self {
        let packed = denominators.each_ref().map(|rows| Rows::new(lines, rows));
        let rows = (0..32).map(|i| Row { denominator: i / 4, numerator: i % 4, unit: 1.0 }).collect();
        Self { rows, gains, denominators, packed }
    }

    fn members(&self) -> Vec<u32> {
        (0..self.rows.len() as u32).flat_map(|row| (0..16).map(move |gain| row << GAIN_BITS | gain)).collect()
    }

    fn table(&self) -> Table<'_> {
        Table::new(&self.rows, &self.gains, &self.packed[0], &self.packed[1])
    }

    /// `1 + L`.
    fn response(&self, member: u32) -> Vec<Complex64> {
        let row = &self.rows[(member >> GAIN_BITS) as usize];
        let gain = self.gains[(member & ((1 << GAIN_BITS) - 1)) as usize];
        let [d, n] = &self.denominators;
        let (d, n) = (&d[row.denominator as usize], &n[row.numerator as usize]);
        d.iter().zip(n).map(|(d, n)| 1.0 + gain * (d * n)).collect()
    }
}

/// What a pass makes of the members.
struct Passed {
    widest: Widest,
    codes: Vec<u8>,
    along: Vec<LineLanes<f32>>,
}

struct Run<'a> {
    split: &'a Split,
    table: &'a Table<'a>,
    members: &'a [u32],
}

impl WithSimd for Run<'_> {
    type Output = Passed;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Passed {
        let Self { split, table, members } = self;
        let (mut widest, mut codes, mut scratch) = (Widest::none(split.centre.len()), Vec::new(), Scratch::default());
        let directions = || Directions::new(split);
        let measure = Measure {
            split: directions(),
            table,
            members,
            scratch: &mut scratch,
            widest: &mut widest,
            codes: &mut codes,
        };
        measure.with_simd(simd);
        let inverse: Vec<_> = pairs(&split.inverse, 1.0).collect();
        let mut along_all = Vec::new();
        for members in members.chunks(PER_CHUNK) {
            let mut deviations = vec![Pair::default(); members.len() * inverse.len()];
            let mut some = vec![LineLanes::default(); members.len()];
            fill::<S>(table, members, &inverse, 1.0, &mut deviations);
            along(simd, &split.columns, &deviations, &mut some);
            along_all.extend(some);
        }
        Passed { widest, codes, along: along_all }
    }
}

/// Checks the cluster of some members; its reach.
fn check(pool: &Pool, members: &[u32], lines: usize, is_scalar: bool) -> f64 {
    let table = pool.table();
    let mut sample = Sample::default();
    let splitter = Splitter::new(&table, members, members.len().div_ceil(256), lines, &mut sample);
    let split = splitter.by_coordinates(&mut sample, 3);
    let run = Run { split: &split, table: &table, members };
    let Passed { widest, codes, along } =
        if is_scalar { run.with_simd(pulp::Scalar::new()) } else { pulp::Arch::new().dispatch(run) };
    let extent = Extent::new(&widest, &split);
    let cluster = Cluster::new(&split, &extent, 0..members.len() as u32);
    if !is_scalar && members.len() <= 256 {
        // The sample is the whole, and known.
        let (mut again, mut codes_again) = (Widest::none(lines), Vec::new());
        split.widen_known(&sample.deviations, &sample.along, &mut again, &mut codes_again);
        let again = Extent::new(&again, &split);
        assert_eq!(codes, codes_again);
        assert!((again.reach - extent.reach).abs() <= 1e-5 * extent.reach, "{} {}", again.reach, extent.reach);
    }
    let reach = f64::from(cluster.reach);
    if reach.is_infinite() {
        return reach;
    }
    for ((member, along), code) in members.iter().zip(&along).zip(&codes) {
        let ranges = widest.ranges(usize::from(*code));
        for (m, [low, high]) in ranges.into_iter().enumerate() {
            let (t, [from, to]) = (f64::from(along.0[m]), cluster.range(m));
            assert!(low <= t && t <= high && from <= low && high <= to, "{m}: {from} {low} {t} {high} {to}");
        }
        let mut square = 0.0;
        for (k, x) in pool.response(*member).into_iter().enumerate() {
            let mut rest = x / cluster.centre(k) - 1.0;
            let profile = cluster.profile(k);
            assert!(rest.norm() <= profile.radius, "{k}: {} {}", rest.norm(), profile.radius);
            for m in 0..ALL {
                if m == DIRECTIONS {
                    assert!(rest.norm() <= profile.remainder, "{k}: {} {}", rest.norm(), profile.remainder);
                }
                let [re, im] = cluster.directions(k);
                let direction = Complex64::new(re[m], im[m]);
                assert_eq!(direction, split.directions[m * lines + k]);
                rest -= f64::from(along.0[m]) * direction;
            }
            square += (rest.norm() / profile.scale).powi(2);
        }
        assert!(square.sqrt() <= reach, "{} {reach}", square.sqrt());
    }
    reach
}

#[test]
fn clusters_hold_their_members() {
    let mut rng = rng::stream(41, "loops");
    for lines in [1, 13, 16, 31, 40] {
        for (case, spread) in [1e-7, 1e-3, 0.1, 1.0].into_iter().enumerate() {
            let mut of: Vec<Complex64> = (0..lines)
                .map(|_| {
                    let modulus = 10f64.powf(2.0 * rng.random::<f64>() - 1.0);
                    Complex64::from_polar(modulus, std::f64::consts::TAU * rng.random::<f64>())
                })
                .collect();
            for beside in [false, true] {
                if beside {
                    // A pole of the closed loop beside a line, and one of the open loop beside another.
                    of[0] = Complex64::new(-1.0, 1e-6);
                    of[lines - 1] *= if lines > 1 { 1e7 } else { 1.0 };
                }
                let pool = Pool::around(&of, spread, case as u64);
                let members = pool.members();
                for members in [&members[..], &members[..200], &members[..37], &members[..1]] {
                    for is_scalar in [false, true] {
                        let reach = check(&pool, members, lines, is_scalar);
                        assert!(reach.is_finite(), "{lines} {spread} {beside}");
                    }
                }
            }
        }
    }
}

#[test]
fn what_is_no_number_or_too_large_reaches_beyond_everything() {
    for lines in [1, 13, 31] {
        let of = vec![Complex64::new(0.3, 0.4); lines];
        for (line, value) in [(0, f64::NAN), (lines - 1, f64::INFINITY), (lines / 2, 1e200), (0, 1e30)] {
            for is_scalar in [false, true] {
                let mut pool = Pool::around(&of, 0.1, 5);
                // Of one denominator only, so that the others say nothing of it.
                let [mut denominators, numerators] = pool.denominators;
                denominators[6][line] = Complex64::new(value, 0.0);
                pool = Pool::new([denominators, numerators], pool.gains, lines);
                let members = pool.members();
                assert_eq!(check(&pool, &members, lines, is_scalar), f64::INFINITY, "{lines} {line} {value}");
                // Without that one everything is known.
                assert!(check(&pool, &members[..200], lines, is_scalar).is_finite());
            }
        }
    }
}

#[test]
fn crude_logarithms_are_nearly_logarithms() {
    let mut rng = rng::stream(43, "logarithms");
    for _ in 0..200 {
        let mut pair = [Pair::default()];
        let (scale, turn) = (20.0 * rng.random::<f32>() - 10.0, 6.2 * rng.random::<f32>() - 3.1);
        (pair[0].re.0[3], pair[0].im.0[3]) = (scale.exp() * turn.cos(), scale.exp() * turn.sin());
        crude_logarithms(&mut pair);
        assert!((pair[0].re.0[3] - scale).abs() < 0.05, "{scale} {}", pair[0].re.0[3]);
        assert!((pair[0].im.0[3] - turn).abs() < 0.1, "{turn} {}", pair[0].im.0[3]);
    }
}
