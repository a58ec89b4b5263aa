//! Climbing without derivatives, within a box.

/// Steps at most, in few unknowns, and for each of more.
const STEPS: [usize; 2] = [400, 150];

/// When a climb ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ending {
    /// The last simplex is as good as a point when it is this small, in the logarithms of the unknowns.
    pub small: f64,
    /// The sizes that the simplex begins with, one after the other, as shares of the one that is given, and at which
    /// each ends, in the logarithms of the unknowns.
    pub sizes: &'static [[f64; 2]],
    /// Whether the edge that a climb runs along is followed from where it was last.
    pub is_local: bool,
}

/// Which hill it is that a start lies on.
pub(super) const COARSE: Ending = Ending { small: 1e-3, sizes: &[[1.0, 1e-3]], is_local: false };
/// Its top, from where the coarse climb ended.
pub(super) const FINE: Ending = Ending { small: 1e-7, sizes: &[[0.2, 1e-5], [0.01, 1e-7]], is_local: true };

/// The method of Nelder and Mead (Computer Journal 7, 1965) for a maximum within a box, from a simplex of the given
/// size; points outside the box are moved to its nearest point, and values of −∞ mark what may not be taken.
///
/// Restarted from its answer with every size of the ending.
pub(super) fn climb(
    f: &mut impl FnMut(&[f64]) -> f64,
    start: &[f64],
    size: &[f64],
    bounds: &[[f64; 2]],
    ending: Ending,
) -> (Vec<f64>, f64) {
    let (mut x, mut value) = (start.to_vec(), f(start));
    for [shrink, small] in ending.sizes {
        let scaled: Vec<f64> = size.iter().map(|s| s * shrink).collect();
        let (found, reached) = once(f, &x, &scaled, bounds, *small);
        if reached > value {
            (x, value) = (found, reached);
        }
    }
    (x, value)
}

fn once(
    f: &mut impl FnMut(&[f64]) -> f64,
    start: &[f64],
    size: &[f64],
    bounds: &[[f64; 2]],
    small: f64,
) -> (Vec<f64>, f64) {
    let n = start.len();
    let inside = |x: &mut Vec<f64>| x.iter_mut().zip(bounds).for_each(|(x, [low, high])| *x = x.clamp(*low, *high));
    let mut simplex: Vec<(Vec<f64>, f64)> = Vec::with_capacity(n + 1);
    simplex.push((start.to_vec(), f(start)));
    for j in 0..n {
        let mut corner = start.to_vec();
        // Into the box, where the start lies on its edge.
        corner[j] += if corner[j] + size[j] > bounds[j][1] { -size[j] } else { size[j] };
        inside(&mut corner);
        let value = f(&corner);
        simplex.push((corner, value));
    }
    for _ in 0..STEPS[0].max(STEPS[1] * n) {
        simplex.sort_by(|a, b| b.1.total_cmp(&a.1));
        let spread = (0..n)
            .map(|j| simplex[1..].iter().map(|(x, _)| (x[j] - simplex[0].0[j]).abs()).fold(0.0, f64::max))
            .fold(0.0, f64::max);
        if spread < small {
            break;
        }
        let centre: Vec<f64> = (0..n).map(|j| simplex[..n].iter().map(|(x, _)| x[j]).sum::<f64>() / n as f64).collect();
        let worst = simplex[n].clone();
        let mut along = |factor: f64| {
            let mut x: Vec<f64> = centre.iter().zip(&worst.0).map(|(c, w)| c + factor * (c - w)).collect();
            inside(&mut x);
            let value = f(&x);
            (x, value)
        };
        let reflected = along(1.0);
        let next = if reflected.1 > simplex[0].1 {
            let expanded = along(2.0);
            Some(if expanded.1 > reflected.1 { expanded } else { reflected })
        } else if reflected.1 > simplex[n - 1].1 {
            Some(reflected)
        } else {
            let contracted = along(if reflected.1 > worst.1 { 0.5 } else { -0.5 });
            (contracted.1 > worst.1.max(reflected.1)).then_some(contracted)
        };
        match next {
            Some(next) => simplex[n] = next,
            None => {
                let best = simplex[0].0.clone();
                for (x, value) in &mut simplex[1..] {
                    x.iter_mut().zip(&best).for_each(|(x, b)| *x = b + 0.5 * (*x - b));
                    *value = f(x);
                }
            }
        }
    }
    simplex.sort_by(|a, b| b.1.total_cmp(&a.1));
    simplex.swap_remove(0)
}

#[cfg(test)]
mod tests {
    use super::{COARSE, Ending, FINE};

    fn climb(f: &mut impl FnMut(&[f64]) -> f64, start: &[f64], size: &[f64], bounds: &[[f64; 2]]) -> (Vec<f64>, f64) {
        let two = |f: &mut _, start: &[f64], ending: Ending| super::climb(f, start, size, bounds, ending);
        let (coarse, _) = two(f, start, COARSE);
        two(f, &coarse, FINE)
    }

    #[test]
    fn it_finds_the_top_of_a_hill_and_the_edge_of_a_slope() {
        let mut hill = |x: &[f64]| -(x[0] - 1.0).powi(2) - 10.0 * (x[1] - x[0] * x[0]).powi(2);
        let (x, _) = climb(&mut hill, &[-1.0, 2.0], &[0.3, 0.3], &[[-5.0, 5.0]; 2]);
        assert!((x[0] - 1.0).abs() < 1e-6 && (x[1] - 1.0).abs() < 1e-6, "{x:?}");
        let mut slope = |x: &[f64]| x[0] - (x[1] - 0.5).powi(2);
        let (x, _) = climb(&mut slope, &[0.0, 0.0], &[0.3, 0.3], &[[-1.0, 2.0]; 2]);
        assert!((x[0] - 2.0).abs() < 1e-6 && (x[1] - 0.5).abs() < 1e-4, "{x:?}");
        let mut fenced = |x: &[f64]| if x[0] > 0.7 { f64::NEG_INFINITY } else { x[0] };
        let (x, _) = climb(&mut fenced, &[0.0], &[0.3], &[[-1.0, 2.0]]);
        assert!((x[0] - 0.7).abs() < 1e-6 && x[0] <= 0.7, "{x:?}");
    }
}
