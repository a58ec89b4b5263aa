//! Minima of smooth functions of a few variables, by Newton's method with analytic gradients.

use nalgebra::{DMatrix, DVector};

const STEPS: usize = 200;
/// Step of the differences of gradients, relative to 1 + |x|.
const DIFFERENCE: f64 = 1e-4;
/// A step this small relative to 1 + |x| is rounding.
const SMALL: f64 = 1e-11;

/// A minimum.
#[derive(Debug, Clone)]
pub(crate) struct Minimum {
    pub at: Vec<f64>,
    pub value: f64,
    /// The matrix of second derivatives there.
    pub hessian: DMatrix<f64>,
}

/// A local minimum of `f`, which gives value and gradient, or `None` outside of its domain (where steps do not go).
///
/// Second derivatives are differences of the gradient, shifted until they are positive definite (Levenberg). `None`
/// where the gradient did not vanish within the steps, or where the start is outside of the domain.
pub(crate) fn minimise(start: &[f64], f: impl Fn(&[f64]) -> Option<(f64, Vec<f64>)>) -> Option<Minimum> {
    let n = start.len();
    let evaluate = |x: &DVector<f64>| {
        let (value, gradient) = f(x.as_slice())?;
        let finite = value.is_finite() && gradient.iter().all(|g| g.is_finite());
        finite.then(|| (value, DVector::from_vec(gradient)))
    };
    let second = |x: &DVector<f64>| {
        let mut hessian = DMatrix::zeros(n, n);
        for i in 0..n {
            let step = DIFFERENCE * (1.0 + x[i].abs());
            let (mut up, mut down) = (x.clone(), x.clone());
            up[i] += step;
            down[i] -= step;
            let slope = (evaluate(&up)?.1 - evaluate(&down)?.1) / (2.0 * step);
            hessian.set_column(i, &slope);
        }
        Some((&hessian + hessian.transpose()) * 0.5)
    };
    let mut x = DVector::from_column_slice(start);
    let (mut value, mut gradient) = evaluate(&x)?;
    let mut shift = 0.0_f64;
    for _ in 0..STEPS {
        let hessian = second(&x)?;
        let size = hessian.amax().max(f64::MIN_POSITIVE);
        let mut moved = None;
        // Larger shifts give shorter steps along the gradient, so that one of them goes down.
        for _ in 0..60 {
            let shifted = &hessian + DMatrix::identity(n, n) * shift;
            let step = shifted.cholesky().map(|factor| factor.solve(&gradient));
            let next = step.map(|step| (&x - &step, step));
            if let Some((to, step)) = next
                && let Some((lower, slope)) = evaluate(&to)
                && lower <= value + 1e-13 * (1.0 + value.abs())
            {
                moved = Some((to, step, lower, slope));
                break;
            }
            shift = if shift == 0.0 { 1e-6 * size } else { 4.0 * shift };
        }
        let Some((to, step, lower, slope)) = moved else { break };
        let relative = step.iter().zip(&x).fold(0.0_f64, |most, (s, x)| most.max(s.abs() / (1.0 + x.abs())));
        (x, value, gradient) = (to, lower, slope);
        shift = if shift <= 1e-6 * size { 0.0 } else { 0.1 * shift };
        if relative < SMALL {
            let hessian = second(&x)?;
            return Some(Minimum { at: x.as_slice().to_vec(), value, hessian });
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::minimise;

    #[test]
    fn a_curved_valley_is_followed_to_its_lowest_point() {
        let rosenbrock = |x: &[f64]| {
            let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
            Some((a * a + 100.0 * b * b, vec![-2.0 * a - 400.0 * x[0] * b, 200.0 * b]))
        };
        let found = minimise(&[-1.2, 1.0], rosenbrock).unwrap();
        assert!(found.at.iter().all(|x| (x - 1.0).abs() < 1e-10) && found.value < 1e-18, "{found:?}");
        assert!((found.hessian[(1, 1)] - 200.0).abs() < 1e-4);
    }

    #[test]
    fn without_a_minimum_there_is_none() {
        assert!(minimise(&[0.0], |x| Some((-x[0], vec![-1.0]))).is_none());
        assert!(minimise(&[0.0], |_| None).is_none());
    }
}
