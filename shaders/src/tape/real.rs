use std::fmt::{Debug, Display};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// The two scalar types that every kernel is written for: `f32` to run, `f64` to be checked against finite differences.
pub trait Real:
    Copy
    + Send
    + Sync
    + 'static
    + PartialOrd
    + Default
    + Debug
    + Display
    + Sum
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
{
    /// `"f32"` or `"f64"`.
    const NAME: &'static str;
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;

    /// The nearest number of this type.
    fn from_f64(value: f64) -> Self;
    /// The number as an f64, exactly.
    fn to_f64(self) -> f64;

    /// eˣ.
    fn exp(self) -> Self;
    /// The natural logarithm.
    fn ln(self) -> Self;
    /// The square root.
    fn sqrt(self) -> Self;
    /// The absolute value.
    fn abs(self) -> Self;
    /// The sine of an angle in radians.
    fn sin(self) -> Self;
    /// The cosine of an angle in radians.
    fn cos(self) -> Self;
    /// The angle in radians with this cosine.
    fn acos(self) -> Self;
    /// The largest integer that is not above the number.
    fn floor(self) -> Self;
    /// The nearest integer; halves are rounded away from zero.
    fn round(self) -> Self;
    /// The power with an integer exponent.
    fn powi(self, exponent: i32) -> Self;
    /// self · factor + summand with one rounding.
    fn mul_add(self, factor: Self, summand: Self) -> Self;
    /// The larger operand; the other one if one is NaN.
    fn max(self, other: Self) -> Self;
    /// The smaller operand; the other one if one is NaN.
    fn min(self, other: Self) -> Self;
    /// Whether the number is neither infinite nor NaN.
    fn is_finite(self) -> bool;

    /// The slice itself if this type is `f32`, otherwise `None`. With it, generic kernels dispatch to optimised f32
    /// code.
    fn as_f32(slice: &[Self]) -> Option<&[f32]>;
    /// The slice itself, mutable, if this type is `f32`.
    fn as_f32_mut(slice: &mut [Self]) -> Option<&mut [f32]>;
}

macro_rules! impl_real {
    ($float:ident, $as_f32:expr, $as_f32_mut:expr) => {
        impl Real for $float {
            const NAME: &'static str = stringify!($float);
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as $float
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                self as f64
            }
            impl_real!(@forward $float: exp ln sqrt abs sin cos acos floor round);
            #[inline(always)]
            fn powi(self, exponent: i32) -> Self {
                $float::powi(self, exponent)
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, summand: Self) -> Self {
                $float::mul_add(self, factor, summand)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                $float::max(self, other)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                $float::min(self, other)
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                $float::is_finite(self)
            }
            fn as_f32(slice: &[Self]) -> Option<&[f32]> {
                $as_f32(slice)
            }
            fn as_f32_mut(slice: &mut [Self]) -> Option<&mut [f32]> {
                $as_f32_mut(slice)
            }
        }
    };
    (@forward $float:ident: $($name:ident)*) => {
        $(#[inline(always)]
        fn $name(self) -> Self {
            $float::$name(self)
        })*
    };
}

impl_real!(f32, Some, Some);
impl_real!(f64, |_| None, |_| None);
