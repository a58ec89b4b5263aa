//! The motion of subjects: the recorded angle, and how far it goes beyond the limits, a draw in every lane.

use super::cost::{Draw, Setting, seen};
use super::lanes::{MOST, lanes, values};
use super::sampled::{Continuous, STATES, WITH_NOISE, acceleration, next, sampled};
use pulp::{Simd, WithSimd};

/// L_a, L_T and L_n of a draw.
pub(super) type Excursions = [f64; 3];

/// The angle of every draw, and what its excursions beyond the limits cost; `None` where the loop is not defined.
pub(super) fn motions(
    setting: &Setting,
    theta: [f64; 4],
    target: &[f64],
    draws: &[Draw],
) -> Vec<Option<(Vec<f64>, Excursions)>> {
    let seen = seen(target, theta[3], setting.time.period_s());
    pulp::Arch::new().dispatch(Motions { setting, gains: [theta[0], theta[1], theta[2]], seen: &seen, draws })
}

struct Motions<'a> {
    setting: &'a Setting,
    gains: [f64; 3],
    /// The target as seen.
    seen: &'a [f64],
    draws: &'a [Draw],
}

impl WithSimd for Motions<'_> {
    type Output = Vec<Option<(Vec<f64>, Excursions)>>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { setting, gains, seen, draws } = self;
        let mut found: Self::Output = draws.iter().map(|_| None).collect();
        let continuous = |draw: &Draw| Continuous::new(gains, setting.body(draw.body), setting.times(), setting.time);
        let defined: Vec<(usize, Continuous)> =
            draws.iter().enumerate().filter_map(|(place, draw)| Some((place, continuous(draw)?))).collect();
        for together in defined.chunks(S::F64_LANES.min(MOST)) {
            let loops: Vec<Continuous> = together.iter().map(|(_, own)| own.clone()).collect();
            let each = motion(simd, setting, seen, draws, together, &loops);
            for ((place, _), motion) in together.iter().zip(each) {
                found[*place] = Some(motion);
            }
        }
        found
    }
}

/// The motions of no more draws than there are lanes.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "chains of iterators are not inlined into code for vectors")]
fn motion<S: Simd>(
    simd: S,
    setting: &Setting,
    seen: &[f64],
    draws: &[Draw],
    together: &[(usize, Continuous)],
    loops: &[Continuous],
) -> Vec<(Vec<f64>, Excursions)> {
    let population = &setting.population;
    let (rows, _) = sampled::<S, WITH_NOISE>(simd, loops, false);
    let acceleration = acceleration(simd, loops);
    // Acceleration, torque and angle, in the order of the weights.
    let limits = [population.acceleration_rad_s2, population.torque_nm, population.angle_rad];
    let zero = simd.splat_f64s(0.0);
    let (mut state, mut beyond) = ([zero; STATES], [zero; 3]);
    let mut angles: Vec<Vec<f64>> = together.iter().map(|_| Vec::with_capacity(seen.len())).collect();
    let mut noises = [&[][..]; MOST];
    for (l, noise) in noises.iter_mut().enumerate() {
        *noise = &draws[together[l.min(together.len() - 1)].0].noise;
    }
    let samples = seen.len().min(together.iter().map(|(place, _)| draws[*place].noise.len()).min().unwrap_or(0));
    for (k, r) in seen[..samples].iter().enumerate() {
        let w = simd.mul_f64s(lanes(simd, |l| noises[l][k]), simd.splat_f64s(population.noise_nm));
        let mut accelerates = simd.mul_f64s(acceleration[STATES], w);
        for j in 0..STATES {
            accelerates = simd.mul_add_f64s(acceleration[j], state[j], accelerates);
        }
        let limited = [accelerates, state[2], state[0]];
        for i in 0..3 {
            let over = simd.sub_f64s(simd.abs_f64s(limited[i]), simd.splat_f64s(limits[i]));
            beyond[i] = simd.add_f64s(beyond[i], simd.max_f64s(over, zero));
        }
        let angle = values(simd, state[0]);
        for (into, angle) in angles.iter_mut().zip(angle) {
            into.push(angle);
        }
        state = next(simd, &rows, &state, &[simd.splat_f64s(*r), w]);
    }
    let beyond = beyond.map(|sums| values(simd, sums));
    let cost = |l: usize| std::array::from_fn(|i| population.weights[i] / limits[i] * beyond[i][l]);
    angles.into_iter().enumerate().map(|(l, angle)| (angle, cost(l))).collect()
}
