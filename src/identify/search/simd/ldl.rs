//! `G = L D Lᵀ` without pivoting, of several positive definite matrices side by side.

use super::lanes::{Packed, Real};
use pulp::Simd;

/// Numbers of several problems, side by side.
pub(crate) trait Lanes: Copy {
    /// `self b`.
    fn times(self, b: Self) -> Self;
    /// `c − self b`.
    fn times_from(self, b: Self, c: Self) -> Self;
    /// `self / b`.
    fn over(self, b: Self) -> Self;
    /// `then` where this is above `limit`, else (and where it is no number) `otherwise`.
    fn where_above(self, limit: Self, then: Self, otherwise: Self) -> Self;
}

impl<S: Simd, N: Real> Lanes for Packed<S, N> {
    #[inline(always)]
    fn times(self, b: Self) -> Self {
        self * b
    }
    #[inline(always)]
    fn times_from(self, b: Self, c: Self) -> Self {
        Self::times_from(self, b, c)
    }
    #[inline(always)]
    fn over(self, b: Self) -> Self {
        Self::over(self, b)
    }
    #[inline(always)]
    fn where_above(self, limit: Self, then: Self, otherwise: Self) -> Self {
        Self::where_above(self, limit, then, otherwise)
    }
}

/// A square matrix, of a size that the compiler knows or not.
pub(crate) trait Square<V> {
    fn at(&self, row: usize, column: usize) -> V;
    fn put(&mut self, row: usize, column: usize, value: V);
}

impl<V: Copy, const M: usize> Square<V> for [[V; M]; M] {
    #[inline(always)]
    fn at(&self, row: usize, column: usize) -> V {
        self[row][column]
    }
    #[inline(always)]
    fn put(&mut self, row: usize, column: usize, value: V) {
        self[row][column] = value;
    }
}

/// Looks at the pivots as they come.
pub(crate) trait Pivots<V> {
    /// What is kept as the inverse of a pivot, which the diagonal has become.
    fn inverse(&mut self, reciprocal: V, pivot: V, diagonal: V) -> V;
}

/// The determinant of G scaled to unit diagonal.
pub(crate) struct Determinant<V>(pub V);

impl<V: Lanes> Pivots<V> for Determinant<V> {
    #[inline(always)]
    fn inverse(&mut self, reciprocal: V, pivot: V, diagonal: V) -> V {
        self.0 = self.0.times(pivot.over(diagonal));
        reciprocal
    }
}

/// Where a pivot is not above the least, its inverse is infinite, and so is whatever comes of it, or no number.
pub(crate) struct Above<V> {
    pub least: V,
    pub infinity: V,
}

impl<V: Lanes> Pivots<V> for Above<V> {
    #[inline(always)]
    fn inverse(&mut self, reciprocal: V, pivot: V, _: V) -> V {
        pivot.where_above(self.least, reciprocal, self.infinity)
    }
}

/// The matrix by its lower triangle, and then its factors: L below the diagonal, L D above; the diagonal stays what it
/// was.
#[derive(Clone, Copy)]
pub(crate) struct Ldl<G, I> {
    pub gram: G,
    /// The inverse of D.
    pub inverse: I,
}

/// Of a size that the compiler knows, or with room for that.
pub(crate) type Half<V, const M: usize> = Ldl<[[V; M]; M], [V; M]>;

impl<V: Copy, const M: usize> Half<V, M> {
    #[inline(always)]
    pub(crate) fn new(zero: V) -> Self {
        Self { gram: [[zero; M]; M], inverse: [zero; M] }
    }
}

impl<G, I> Ldl<G, I> {
    /// Factors the first n rows and columns in place.
    #[inline(always)]
    pub(crate) fn factor<V: Lanes>(&mut self, n: usize, one: V, pivots: &mut impl Pivots<V>)
    where
        G: Square<V>,
        I: AsMut<[V]>,
    {
        let Self { gram, inverse } = self;
        let inverse = inverse.as_mut();
        // The index walks through both matrices; n may be less than their size.
        #[allow(clippy::needless_range_loop)]
        for j in 0..n {
            let diagonal = gram.at(j, j);
            let mut pivot = diagonal;
            for k in 0..j {
                pivot = gram.at(j, k).times_from(gram.at(k, j), pivot);
            }
            inverse[j] = pivots.inverse(one.over(pivot), pivot, diagonal);
            for i in j + 1..n {
                let mut entry = gram.at(i, j);
                for k in 0..j {
                    entry = gram.at(i, k).times_from(gram.at(k, j), entry);
                }
                gram.put(j, i, entry);
                gram.put(i, j, entry.times(inverse[j]));
            }
        }
    }

    /// As [`Ldl::factor`]; returns the determinant of G scaled to unit diagonal.
    #[inline(always)]
    pub(crate) fn determinant<V: Lanes>(&mut self, n: usize, one: V) -> V
    where
        G: Square<V>,
        I: AsMut<[V]>,
    {
        let mut determinant = Determinant(one);
        self.factor(n, one, &mut determinant);
        determinant.0
    }

    /// `L⁻¹ r`, in place.
    #[inline(always)]
    pub(crate) fn forward<V: Lanes>(&self, n: usize, r: &mut [V])
    where
        G: Square<V>,
    {
        for i in 0..n {
            for j in 0..i {
                r[i] = self.gram.at(i, j).times_from(r[j], r[i]);
            }
        }
    }

    /// `L⁻ᵀ D⁻¹ r`, in place.
    #[inline(always)]
    pub(crate) fn backward<V: Lanes>(&self, n: usize, r: &mut [V])
    where
        G: Square<V>,
        I: AsRef<[V]>,
    {
        for i in (0..n).rev() {
            r[i] = r[i].times(self.inverse.as_ref()[i]);
            for j in i + 1..n {
                r[i] = self.gram.at(j, i).times_from(r[j], r[i]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng;
    use nalgebra::DMatrix;
    use pulp::WithSimd;
    use rand::RngExt;

    /// The solution and the scaled determinant of `G x = b`, in one lane.
    struct Solve<'a> {
        gram: &'a DMatrix<f64>,
        right: &'a [f64],
    }

    impl WithSimd for Solve<'_> {
        type Output = (Vec<f64>, f64);

        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let n = self.right.len();
            let mut half = Half::<Packed<S, f64>, 6>::new(Packed::of(simd, 0.0));
            let mut r = [Packed::of(simd, 0.0); 6];
            for (i, r) in r.iter_mut().enumerate().take(n) {
                *r = Packed::of(simd, self.right[i]);
                for j in 0..=i {
                    half.gram[i][j] = Packed::of(simd, self.gram[(i, j)]);
                }
            }
            let determinant = half.determinant(n, Packed::of(simd, 1.0));
            half.forward(n, &mut r);
            half.backward(n, &mut r);
            (r[..n].iter().map(|x| x.smallest()).collect(), determinant.smallest())
        }
    }

    #[test]
    fn factors_agree_with_a_library() {
        let mut rng = rng::stream(3, "ldl");
        for n in 1..=6 {
            let a = DMatrix::from_fn(9, n, |_, _| 2.0 * rng.random::<f64>() - 1.0);
            let gram = a.transpose() * &a;
            let right: Vec<f64> = (0..n).map(|_| rng.random::<f64>()).collect();
            let (x, determinant) = pulp::Arch::new().dispatch(Solve { gram: &gram, right: &right });
            let expected = gram.clone().cholesky().unwrap().solve(&nalgebra::DVector::from_vec(right));
            let scaled = gram.determinant() / gram.diagonal().iter().product::<f64>();
            for (x, expected) in x.iter().zip(expected.iter()) {
                assert!((x - expected).abs() < 1e-9 * expected.abs().max(1.0), "{n}: {x} {expected}");
            }
            assert!((determinant - scaled).abs() < 1e-12, "{n}: {determinant} {scaled}");
        }
    }
}
