//! Power on the lines of a periodic signal, and the noise beside it.

use crate::ctl::{Ctl, Stopped};
use crate::num::Complex64;
use crate::num::fourier;

/// A line counts as excited by chance with this probability at most, over all lines together.
const FALSE_ALARM: f64 = 0.01;

/// Powers below this share of the largest, 0 Hz included, are rounding of the transform.
const ROUNDING: f64 = 1e-26;

/// The spectrum of a periodic signal from one or more whole periods of N samples: lines `n/(N T)`, n = 0 … ⌊N/2⌋.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Time between samples, s.
    pub sample_time_s: f64,
    /// Samples of a period, N.
    pub samples: usize,
    /// Periods that were averaged, P.
    pub periods: usize,
    /// The mean transform of a period, `X̄_n = (1/P) Σ_p Σ_k x_{pk} e^{−2πj n k/N}`.
    pub mean: Vec<Complex64>,
    /// `|X̄_n|²`.
    pub power: Vec<f64>,
    /// `s_n² = Σ_p |X_pn − X̄_n|²/(P − 1)`: the noise power of one period; `None` of a single one.
    pub noise: Option<Vec<f64>>,
}

impl Spectrum {
    /// From a record of whole periods.
    ///
    /// What is left over at the end is not looked at.
    ///
    /// # Errors
    /// [`Stopped`].
    ///
    /// # Panics
    /// If the record is shorter than a period of at least two samples, which is a mistake of the caller.
    pub fn new(record: &[f64], samples: usize, sample_time_s: f64, ctl: &Ctl) -> Result<Self, Stopped> {
        assert!(samples >= 2 && record.len() >= samples, "a record of {} samples", record.len());
        let periods = record.len() / samples;
        let lines = samples / 2 + 1;
        let mut mean = vec![Complex64::new(0.0, 0.0); lines];
        let mut spread = vec![0.0; lines];
        for (p, period) in record.chunks_exact(samples).enumerate() {
            let count = p as f64 + 1.0;
            let lines = fourier::real_transform_in_parts(period, ctl)?;
            for ((mean, spread), x) in mean.iter_mut().zip(&mut spread).zip(lines) {
                // Welford's recurrence loses nothing where the noise is small.
                let step = x - *mean;
                *mean += step / count;
                *spread += (step * (x - *mean).conj()).re;
            }
        }
        let noise =
            (periods >= 2).then(|| spread.iter().map(|s| s.max(0.0) / (periods as f64 - 1.0)).collect::<Vec<_>>());
        let power = mean.iter().map(Complex64::norm_sqr).collect();
        Ok(Self { sample_time_s, samples, periods, mean, power, noise })
    }

    /// The distance of lines, Hz.
    #[must_use]
    pub fn spacing_hz(&self) -> f64 {
        (self.samples as f64 * self.sample_time_s).recip()
    }

    /// The angular frequency of a line, rad/s.
    #[must_use]
    pub fn omega_rad_s(&self, line: usize) -> f64 {
        2.0 * std::f64::consts::PI * line as f64 / (self.samples as f64 * self.sample_time_s)
    }

    /// The part of the mean square that a line carries: `2|X̄|²/N²`, or half of that at 0 Hz and at the Nyquist
    /// frequency.
    #[must_use]
    pub fn share(&self, line: usize) -> f64 {
        let doubled = if line == 0 || 2 * line == self.samples { 1.0 } else { 2.0 };
        doubled * self.power[line] / (self.samples as f64).powi(2)
    }

    /// All lines but 0 Hz below the Nyquist frequency.
    #[must_use]
    pub fn all_lines(&self) -> Vec<usize> {
        (1..self.samples.div_ceil(2)).collect()
    }

    /// The lines below the Nyquist frequency that carry power: `threshold` of the strongest one's, and, of several
    /// periods, more than noise alone brings about once in a hundred records (`P |X̄|²/s²` has the F distribution with
    /// 2 and 2P − 2 degrees of freedom without a signal, whose tail is `(1 + F/(P − 1))^{−(P−1)}`; Bonferroni's
    /// correction for the number of lines).
    #[must_use]
    pub fn excited(&self, threshold: f64) -> Vec<usize> {
        let lines = self.all_lines();
        let rounding = ROUNDING * self.power.iter().copied().fold(0.0, f64::max);
        let least = (threshold * lines.iter().map(|n| self.power[*n]).fold(0.0, f64::max)).max(rounding);
        let has_power = least > 0.0;
        if !has_power {
            return Vec::new();
        }
        let degrees = self.periods as f64 - 1.0;
        let chance = FALSE_ALARM / lines.len() as f64;
        let above_noise = |n: usize| {
            self.noise.as_ref().is_none_or(|noise| {
                let f = self.periods as f64 * self.power[n] / noise[n];
                // Without any noise f is infinite, and the tail zero.
                (1.0 + f / degrees).powf(-degrees) <= chance
            })
        };
        lines.into_iter().filter(|n| self.power[*n] >= least && above_noise(*n)).collect()
    }

    /// The order of persistent excitation: the number of frequencies in (−1/2T, 1/2T] that carry power, where 0 Hz and
    /// the Nyquist frequency count once and others twice (Ljung 1999, section 13.2). `lines` are those below the
    /// Nyquist frequency, without 0 Hz.
    #[must_use]
    pub fn persistent_excitation_order(&self, lines: &[usize], threshold: f64) -> usize {
        let strongest = lines.iter().map(|n| self.power[*n]).fold(0.0, f64::max);
        let single = |n: usize| usize::from(self.power[n] > threshold * strongest && self.power[n] > 0.0);
        let nyquist = if self.samples.is_multiple_of(2) { single(self.samples / 2) } else { 0 };
        2 * lines.len() + single(0) + nyquist
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::linalg::singular_values;
    use crate::num::rng::stream;
    use nalgebra::DMatrix;
    use rand_distr::{Distribution as _, StandardNormal};

    #[test]
    fn shares_add_up_to_the_mean_square() {
        for n in [16_usize, 15] {
            let x: Vec<f64> = (0..n).map(|k| ((k * k) as f64 * 0.7).sin() + 0.3).collect();
            let spectrum = Spectrum::new(&x, n, 0.1, &Ctl::new()).unwrap();
            let sum: f64 = (0..spectrum.power.len()).map(|k| spectrum.share(k)).sum();
            assert!((sum - x.iter().map(|x| x * x).sum::<f64>() / n as f64).abs() < 1e-14);
        }
    }

    #[test]
    fn noise_is_told_from_signal() {
        let (n, periods, sigma) = (64, 50, 0.5);
        let mut random = stream(11, "noise");
        let mut draw = || {
            let record: Vec<f64> = (0..n * periods)
                .map(|k| {
                    let white: f64 = StandardNormal.sample(&mut random);
                    (2.0 * std::f64::consts::PI * (5 * k) as f64 / n as f64).sin() + sigma * white
                })
                .collect();
            Spectrum::new(&record, n, 0.1, &Ctl::new()).unwrap()
        };
        // One record in a hundred has a false line: of 300 more than ten three times in ten thousand.
        let spectrum = draw();
        let mut false_alarms = 0;
        for _ in 0..300 {
            let excited = draw().excited(1e-6);
            assert!(excited.contains(&5));
            false_alarms += usize::from(excited.len() > 1);
        }
        assert!(false_alarms <= 10, "{false_alarms}");
        // White noise has the power N σ² on every line.
        let noise = spectrum.noise.as_ref().unwrap();
        let mean = noise[1..32].iter().sum::<f64>() / 31.0;
        assert!((mean / (n as f64 * sigma * sigma) - 1.0).abs() < 0.1, "{mean}");
        assert_eq!(spectrum.persistent_excitation_order(&[5], 1e-3), 2);
    }

    #[test]
    fn the_order_is_the_rank_of_the_matrix_of_correlations() {
        let n = 24;
        let wave = |k: usize, line: usize| (2.0 * std::f64::consts::PI * (k * line) as f64 / n as f64 + 0.3).cos();
        let nyquist = |k: usize| if k.is_multiple_of(2) { 0.7 } else { -0.7 };
        for (offset, lines, with_nyquist) in
            [(0.0, vec![2, 5], false), (0.4, vec![1, 3, 11], false), (0.0, vec![7], true)]
        {
            let x: Vec<f64> = (0..n)
                .map(|k| {
                    offset
                        + lines.iter().map(|l| wave(k, *l)).sum::<f64>()
                        + if with_nyquist { nyquist(k) } else { 0.0 }
                })
                .collect();
            let spectrum = Spectrum::new(&x, n, 1.0, &Ctl::new()).unwrap();
            let found = spectrum.excited(1e-9);
            assert_eq!(found, lines);
            let r = super::super::sequence::correlation::periodic_autocorrelation(&x, n, &Ctl::new()).unwrap();
            let matrix = DMatrix::from_fn(n, n, |i, j| r[i.abs_diff(j)]);
            let rank = singular_values(&matrix).unwrap().iter().filter(|s| **s > 1e-9).count();
            assert_eq!(spectrum.persistent_excitation_order(&found, 1e-9), rank);
        }
    }
}
