//! The two precisions that the bounds are computed in, and vectors of them.

use pulp::Simd;
use std::fmt::Debug;
use std::ops::{Add, Mul, Sub};

/// Single or double precision.
pub(crate) trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + 'static
{
    /// As many as an instruction takes.
    type Vector<S: Simd>: Copy;
    /// The largest relative error of a rounded number.
    const ROUNDOFF: f64;
    /// The smallest number of full precision.
    const SMALLEST: f64;
    const INFINITY: Self;

    fn nearest(x: f64) -> Self;
    /// The next number that is not below.
    fn above(x: f64) -> Self;
    fn value(self) -> f64;
    fn magnitude(self) -> Self;
    /// A whole number from 0 to 255.
    fn byte(self) -> u8;
    fn vectors<S: Simd>(x: &[Self]) -> &[Self::Vector<S>];
    fn vectors_mut<S: Simd>(x: &mut [Self]) -> &mut [Self::Vector<S>];
    fn splat<S: Simd>(simd: S, x: Self) -> Self::Vector<S>;
    fn add<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn sub<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn mul<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn div<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    /// `a b + c`.
    fn mul_add<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>, c: Self::Vector<S>) -> Self::Vector<S>;
    /// `c − a b`.
    fn mul_sub<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>, c: Self::Vector<S>) -> Self::Vector<S>;
    fn root<S: Simd>(simd: S, a: Self::Vector<S>) -> Self::Vector<S>;
    fn modulus<S: Simd>(simd: S, a: Self::Vector<S>) -> Self::Vector<S>;
    /// The smaller (larger) one; b where a is no number.
    fn min<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn max<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    /// One vector where a is above b, else the other; that is also where either is no number.
    fn where_above<S: Simd>(
        simd: S,
        a: Self::Vector<S>,
        b: Self::Vector<S>,
        then: Self::Vector<S>,
        otherwise: Self::Vector<S>,
    ) -> Self::Vector<S>;
    /// The smallest of a vector that holds numbers.
    fn smallest<S: Simd>(simd: S, a: Self::Vector<S>) -> Self;
}

/// Functions and no closures: closures that capture the token are not inlined where the instructions are known.
macro_rules! real {
    ($real:ident, $vector:ident, $roundoff:expr, $smallest:expr, $as:ident, $as_mut:ident, $splat:ident, $add:ident,
     $sub:ident, $mul:ident, $div:ident, $mul_add:ident, $mul_sub:ident, $root:ident, $abs:ident, $min:ident,
     $max:ident, $greater:ident, $select:ident, $least:ident) => {
        impl Real for $real {
            type Vector<S: Simd> = S::$vector;
            const ROUNDOFF: f64 = $roundoff;
            const SMALLEST: f64 = $smallest;
            const INFINITY: Self = $real::INFINITY;

            #[inline(always)]
            fn nearest(x: f64) -> Self {
                x as $real
            }
            #[inline(always)]
            fn above(x: f64) -> Self {
                let near = x as $real;
                if f64::from(near) < x { near.next_up() } else { near }
            }
            #[inline(always)]
            fn value(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn magnitude(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn byte(self) -> u8 {
                // Where a unit is the last bit: quicker than a conversion.
                (self + 0.5 / $real::EPSILON * 2.0).to_bits() as u8
            }
            #[inline(always)]
            fn vectors<S: Simd>(x: &[Self]) -> &[S::$vector] {
                S::$as(x).0
            }
            #[inline(always)]
            fn vectors_mut<S: Simd>(x: &mut [Self]) -> &mut [S::$vector] {
                S::$as_mut(x).0
            }
            #[inline(always)]
            fn splat<S: Simd>(simd: S, x: Self) -> S::$vector {
                simd.$splat(x)
            }
            #[inline(always)]
            fn add<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$add(a, b)
            }
            #[inline(always)]
            fn sub<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$sub(a, b)
            }
            #[inline(always)]
            fn mul<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$mul(a, b)
            }
            #[inline(always)]
            fn div<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$div(a, b)
            }
            #[inline(always)]
            fn mul_add<S: Simd>(simd: S, a: S::$vector, b: S::$vector, c: S::$vector) -> S::$vector {
                simd.$mul_add(a, b, c)
            }
            #[inline(always)]
            fn mul_sub<S: Simd>(simd: S, a: S::$vector, b: S::$vector, c: S::$vector) -> S::$vector {
                simd.$mul_sub(a, b, c)
            }
            #[inline(always)]
            fn root<S: Simd>(simd: S, a: S::$vector) -> S::$vector {
                simd.$root(a)
            }
            #[inline(always)]
            fn modulus<S: Simd>(simd: S, a: S::$vector) -> S::$vector {
                simd.$abs(a)
            }
            #[inline(always)]
            fn min<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$min(a, b)
            }
            #[inline(always)]
            fn max<S: Simd>(simd: S, a: S::$vector, b: S::$vector) -> S::$vector {
                simd.$max(a, b)
            }
            #[inline(always)]
            fn where_above<S: Simd>(
                simd: S,
                a: S::$vector,
                b: S::$vector,
                then: S::$vector,
                otherwise: S::$vector,
            ) -> S::$vector {
                simd.$select(simd.$greater(a, b), then, otherwise)
            }
            #[inline(always)]
            fn smallest<S: Simd>(simd: S, a: S::$vector) -> Self {
                simd.$least(a)
            }
        }
    };
}

real!(
    f32,
    f32s,
    0.5 * f32::EPSILON as f64,
    f32::MIN_POSITIVE as f64,
    as_simd_f32s,
    as_mut_simd_f32s,
    splat_f32s,
    add_f32s,
    sub_f32s,
    mul_f32s,
    div_f32s,
    mul_add_e_f32s,
    negate_mul_add_e_f32s,
    sqrt_f32s,
    abs_f32s,
    min_f32s,
    max_f32s,
    greater_than_f32s,
    select_f32s,
    reduce_min_f32s
);
real!(
    f64,
    f64s,
    0.5 * f64::EPSILON,
    f64::MIN_POSITIVE,
    as_simd_f64s,
    as_mut_simd_f64s,
    splat_f64s,
    add_f64s,
    sub_f64s,
    mul_f64s,
    div_f64s,
    mul_add_e_f64s,
    negate_mul_add_e_f64s,
    sqrt_f64s,
    abs_f64s,
    min_f64s,
    max_f64s,
    greater_than_f64s,
    select_f64s,
    reduce_min_f64s
);

/// A vector with the token of its instructions, for arithmetic that reads like arithmetic.
pub(crate) struct Packed<S: Simd, N: Real> {
    simd: S,
    pub x: N::Vector<S>,
}

impl<S: Simd, N: Real> Clone for Packed<S, N> {
    #[inline(always)]
    fn clone(&self) -> Self {
        *self
    }
}
impl<S: Simd, N: Real> Copy for Packed<S, N> {}

impl<S: Simd, N: Real> Packed<S, N> {
    #[inline(always)]
    pub(crate) fn new(simd: S, x: N::Vector<S>) -> Self {
        Self { simd, x }
    }
    #[inline(always)]
    pub(crate) fn of(simd: S, x: N) -> Self {
        Self { simd, x: N::splat(simd, x) }
    }
    /// `self b + c`.
    #[inline(always)]
    pub(crate) fn times_plus(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, N::mul_add(self.simd, self.x, b.x, c.x))
    }
    /// `c − self b`.
    #[inline(always)]
    pub(crate) fn times_from(self, b: Self, c: Self) -> Self {
        Self::new(self.simd, N::mul_sub(self.simd, self.x, b.x, c.x))
    }
    #[inline(always)]
    pub(crate) fn over(self, b: Self) -> Self {
        Self::new(self.simd, N::div(self.simd, self.x, b.x))
    }
    #[inline(always)]
    pub(crate) fn root(self) -> Self {
        Self::new(self.simd, N::root(self.simd, self.x))
    }
    #[inline(always)]
    pub(crate) fn modulus(self) -> Self {
        Self::new(self.simd, N::modulus(self.simd, self.x))
    }
    #[inline(always)]
    pub(crate) fn min(self, b: Self) -> Self {
        Self::new(self.simd, N::min(self.simd, self.x, b.x))
    }
    #[inline(always)]
    pub(crate) fn max(self, b: Self) -> Self {
        Self::new(self.simd, N::max(self.simd, self.x, b.x))
    }
    /// One vector where this is above `limit`, else (and where it is no number) the other.
    #[inline(always)]
    pub(crate) fn where_above(self, limit: Self, then: Self, otherwise: Self) -> Self {
        Self::new(self.simd, N::where_above(self.simd, self.x, limit.x, then.x, otherwise.x))
    }
    #[inline(always)]
    pub(crate) fn smallest(self) -> N {
        N::smallest(self.simd, self.x)
    }
}

impl<S: Simd, N: Real> Add for Packed<S, N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self::new(self.simd, <N as Real>::add(self.simd, self.x, b.x))
    }
}
impl<S: Simd, N: Real> Sub for Packed<S, N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self::new(self.simd, <N as Real>::sub(self.simd, self.x, b.x))
    }
}
impl<S: Simd, N: Real> Mul for Packed<S, N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self::new(self.simd, <N as Real>::mul(self.simd, self.x, b.x))
    }
}
