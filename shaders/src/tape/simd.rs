//! Wider vector instructions where the processor has them.

/// Defines a function that runs `$body`, an `#[inline(always)]` function, compiled for AVX2 where the processor has it.
///
/// The compiler vectorises plain loops and never contracts `a * b + c`, so the result has the same bits with and
/// without. The body must consist of loops and `#[inline(always)]` functions: functions that are not inlined are
/// compiled for the baseline. AVX-512 was measured and is slower for these memory-bound loops.
macro_rules! multiversion {
    ($(#[$meta:meta])* fn $name:ident $(<const $L:ident: usize>)? ($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? = $body:ident) => {
        $(#[$meta])*
        fn $name$(<const $L: usize>)?($($argument: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                fn avx2$(<const $L: usize>)?($($argument: $type),*) $(-> $result)? {
                    $body$(::<$L>)?($($argument),*)
                }
                if is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor has the feature.
                    return unsafe { avx2$(::<$L>)?($($argument),*) };
                }
            }
            $body$(::<$L>)?($($argument),*)
        }
    };
}

pub(crate) use multiversion;
