//! The functions that an expression of [`pointwise!`](crate::pointwise!) may call, under their WGSL names.

macro_rules! functions {
    ($module:ident, $float:ident) => {
        /// The functions for one scalar type.
        pub mod $module {
            /// eˣ.
            #[inline(always)]
            pub fn exp(x: $float) -> $float {
                x.exp()
            }
            /// The natural logarithm.
            #[inline(always)]
            pub fn log(x: $float) -> $float {
                x.ln()
            }
            /// The hyperbolic tangent.
            #[inline(always)]
            pub fn tanh(x: $float) -> $float {
                x.tanh()
            }
            /// The square root.
            #[inline(always)]
            pub fn sqrt(x: $float) -> $float {
                x.sqrt()
            }
            /// The absolute value.
            #[inline(always)]
            pub fn abs(x: $float) -> $float {
                x.abs()
            }
            /// −1, 0 or 1; 0 at ±0 and, as in WGSL's definition by comparison, at NaN.
            #[inline(always)]
            pub fn sign(x: $float) -> $float {
                select(select(0.0, 1.0, x > 0.0), -1.0, x < 0.0)
            }
            /// The smaller operand; the other one if one is NaN.
            #[inline(always)]
            pub fn min(x: $float, y: $float) -> $float {
                x.min(y)
            }
            /// The larger operand; the other one if one is NaN.
            #[inline(always)]
            pub fn max(x: $float, y: $float) -> $float {
                x.max(y)
            }
            /// `if_true` if the condition holds, otherwise `if_false`.
            #[inline(always)]
            pub fn select(if_false: $float, if_true: $float, condition: bool) -> $float {
                if condition { if_true } else { if_false }
            }
        }
    };
}

functions!(f32, f32);
functions!(f64, f64);
