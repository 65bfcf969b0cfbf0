//! Expressions over the elements of equally shaped tensors, written once and compiled to Rust (f32, f64) and to WGSL; the
//! kernel around the WGSL text is made when it is first launched.

mod adds;
mod expression;
pub mod functions;
mod gpu;
#[cfg(test)]
mod tests;

pub use adds::adds;
pub use expression::{Expression, GradientKernel, ValueKernel};

/// Defines pointwise operations: the value and, for every input, the gradient.
///
/// ```
/// shaders::pointwise! {
///     /// y = factor·x²
///     pub fn scaled_square(x) with(factor) -> y {
///         let square = x * x;
///         return factor * square;
///     }
///     gradients(dy) {
///         x: { return 2.0 * factor * x * dy; }
///     }
/// }
/// # use shaders::tape::{Device, Tape, Tensor};
/// let mut tape = Tape::<f32>::new(Device::Cpu);
/// let x = tape.leaf(Tensor::scalar(3.0));
/// let y = scaled_square(&mut tape, x, 0.5);
/// assert_eq!(tape.value(y).as_slice(), [4.5]);
/// ```
///
/// A body is a sequence of `let name = expression;` and one `return expression;` in the common subset of Rust and WGSL:
/// literals with a decimal point, `+ - * /`, comparisons inside `select(if_false, if_true, condition)`, and the functions
/// of [`functions`]. Gradients may use the inputs, the constants, the output and its gradient. Each definition becomes a
/// function of a tape, the inputs (variables of one shape) and the constants (f64), and the invoking module gets the list
/// `EXPRESSIONS` of all definitions with their WGSL.
#[macro_export]
macro_rules! pointwise {
    // One definition: the expression with its kernels and WGSL text, and the function that applies it.
    (@define ($($doc:tt)*) $visibility:vis $name:ident $inputs:tt $constants:tt $y:ident $dy:ident $value:tt
        $($wrt:ident $gradient:tt)+) => {
        mod $name {
            pub(super) static EXPRESSION: $crate::pointwise::Expression = $crate::pointwise::Expression {
                name: stringify!($name),
                inputs: $crate::pointwise!(@count $inputs),
                constants: $crate::pointwise!(@count $constants),
                wgsl: concat!(
                    "fn ", stringify!($name), $crate::pointwise!(@wgsl $inputs $constants () $value),
                    $("fn ", stringify!($name), "_d_", stringify!($wrt),
                        $crate::pointwise!(@wgsl $inputs $constants ($y, $dy) $gradient),)+
                ),
                value_f32: $crate::pointwise!(@value f32 $inputs $constants $value),
                value_f64: $crate::pointwise!(@value f64 $inputs $constants $value),
                gradients_f32: &[$($crate::pointwise!(@gradient f32 $inputs $constants ($y, $dy) $gradient)),+],
                gradients_f64: &[$($crate::pointwise!(@gradient f64 $inputs $constants ($y, $dy) $gradient)),+],
            };
        }
        $crate::pointwise!(@function ($($doc)*) $visibility $name $inputs $constants);
    };
    (@function ($($doc:tt)*) $visibility:vis $name:ident ($($input:ident),+) [$(($($constant:ident),+))?]) => {
        $($doc)*
        $visibility fn $name<T: $crate::tape::Real>(
            tape: &mut $crate::tape::Tape<T>,
            $($input: $crate::tape::Var,)+
            $($($constant: f64,)+)?
        ) -> $crate::tape::Var {
            $name::EXPRESSION.apply(tape, &[$($input),+], &[$($($constant),+)?])
        }
    };
    (@count []) => { 0 };
    (@count [($($name:ident),+)]) => { $crate::pointwise!(@count ($($name),*)) };
    (@count ($($name:ident),+)) => { [$(stringify!($name)),+].len() };

    // Parameters and body of a WGSL function.
    (@wgsl ($($input:ident),+) [$(($($constant:ident),+))?] ($($extra:ident),*)
        { $(let $local:ident = $bound:expr;)* return $result:expr; }) => {
        concat!(
            "(", $(stringify!($input), ": f32, ",)+ $($(stringify!($constant), ": f32, ",)+)?
            $(stringify!($extra), ": f32, ",)* ") -> f32 {\n",
            $("    let ", stringify!($local), " = ", stringify!($bound), ";\n",)*
            "    return ", stringify!($result), ";\n}\n"
        )
    };

    // A loop over the elements that evaluates the value.
    (@value $float:ident ($($input:ident),+) [$(($($constant:ident),+))?]
        { $(let $local:ident = $bound:expr;)* return $result:expr; }) => {{
        fn kernel(inputs: &[&[$float]], constants: &[$float], out: &mut [$float]) {
            #[allow(unused_imports)]
            use $crate::pointwise::functions::$float::*;
            let &[$($input),+] = inputs else { unreachable!("checked when applied") };
            let &[$($($constant),+)?] = constants else { unreachable!("checked when applied") };
            $(let $input = &$input[..out.len()];)+
            for index in 0..out.len() {
                $(let $input = $input[index];)+
                $(let $local = $bound;)*
                out[index] = $result;
            }
        }
        kernel
    }};

    // A loop over the elements that evaluates one gradient.
    (@gradient $float:ident ($($input:ident),+) [$(($($constant:ident),+))?] ($y:ident, $dy:ident)
        { $(let $local:ident = $bound:expr;)* return $result:expr; }) => {{
        #[allow(unused_variables)]
        fn kernel(inputs: &[&[$float]], constants: &[$float], y: &[$float], dy: &[$float], out: &mut [$float]) {
            #[allow(unused_imports)]
            use $crate::pointwise::functions::$float::*;
            let &[$($input),+] = inputs else { unreachable!("checked when applied") };
            let &[$($($constant),+)?] = constants else { unreachable!("checked when applied") };
            $(let $input = &$input[..out.len()];)+
            let (y, dy) = (&y[..out.len()], &dy[..out.len()]);
            for index in 0..out.len() {
                $(let $input = $input[index];)+
                let ($y, $dy) = (y[index], dy[index]);
                $(let $local = $bound;)*
                out[index] = $result;
            }
        }
        kernel
    }};

    ($($(#[$doc:meta])* $visibility:vis fn $name:ident $inputs:tt $(with $constants:tt)? -> $y:ident $value:tt
        gradients($dy:ident) { $($wrt:ident: $gradient:tt)+ })+) => {
        $($crate::pointwise!(@define ($(#[$doc])*) $visibility $name $inputs [$($constants)?] $y $dy $value
            $($wrt $gradient)+);)+

        /// Every expression of this module.
        pub static EXPRESSIONS: &[&$crate::pointwise::Expression] = &[$(&$name::EXPRESSION),+];
    };
}

pointwise! {
    /// y = a + b
    pub fn add(a, b) -> y {
        return a + b;
    }
    gradients(dy) {
        a: { return dy; }
        b: { return dy; }
    }

    /// y = a − b
    pub fn sub(a, b) -> y {
        return a - b;
    }
    gradients(dy) {
        a: { return dy; }
        b: { return -dy; }
    }

    /// y = a·b
    pub fn mul(a, b) -> y {
        return a * b;
    }
    gradients(dy) {
        a: { return b * dy; }
        b: { return a * dy; }
    }

    /// y = x + term
    pub fn shift(x) with(term) -> y {
        return x + term;
    }
    gradients(dy) {
        x: { return dy; }
    }

    /// y = (1 − share)·a + share·b
    pub fn mix(a, b) with(share) -> y {
        return (1.0 - share) * a + share * b;
    }
    gradients(dy) {
        a: { return (1.0 - share) * dy; }
        b: { return share * dy; }
    }

    /// y = x²
    pub fn square(x) -> y {
        return x * x;
    }
    gradients(dy) {
        x: { return 2.0 * x * dy; }
    }

    /// y = eˣ
    pub fn exponential(x) -> y {
        return exp(x);
    }
    gradients(dy) {
        x: { return y * dy; }
    }

    /// y = e^−x
    pub fn decay(x) -> y {
        return exp(-x);
    }
    gradients(dy) {
        x: { return -y * dy; }
    }

    /// y = tanh x
    pub fn hyperbolic_tangent(x) -> y {
        return tanh(x);
    }
    gradients(dy) {
        x: { return (1.0 - y) * (1.0 + y) * dy; }
    }

    /// y = |x|; the gradient at 0 is 0.
    pub fn magnitude(x) -> y {
        return abs(x);
    }
    gradients(dy) {
        x: { return dy * sign(x); }
    }

    /// y = factor·x
    pub fn scale(x) with(factor) -> y {
        return factor * x;
    }
    gradients(dy) {
        x: { return factor * dy; }
    }

    /// y = max(x, 0); the gradient at 0 is 0. Written so that a NaN stays a NaN.
    pub fn relu(x) -> y {
        return select(x, 0.0, x < 0.0);
    }
    gradients(dy) {
        x: { return select(dy, 0.0, x <= 0.0); }
    }

    /// y = 1 / (1 + e^−x), from the exponential that cannot overflow.
    pub fn sigmoid(x) -> y {
        let decay = exp(-abs(x));
        return select(decay, 1.0, x >= 0.0) / (1.0 + decay);
    }
    gradients(dy) {
        x: { return dy * y * (1.0 - y); }
    }
}
