use crate::tape::Real;

/// Linear interpolation between neighbouring texels of one axis.
#[derive(Copy, Clone, Debug)]
pub(super) struct Lookup<T> {
    pub low: usize,
    pub high: usize,
    /// Weight of `high`, in [0, 1]; `low` has the rest.
    pub fraction: T,
    /// d(texel coordinate)/d(coordinate): 0 outside [−1, 1].
    pub slope: T,
}

impl<T: Real> Lookup<T> {
    /// `coordinate` in [−1, 1] on an axis whose first and last texel centres are at −1 and 1.
    ///
    /// The last texel is reached exactly, as weight 1 of `high`; an axis of one texel is constant; NaN stays NaN.
    #[inline(always)]
    pub(super) fn new(coordinate: T, texels: usize) -> Self {
        let half_span = T::from_f64((texels - 1) as f64 / 2.0);
        let last = half_span + half_span;
        let unclamped = (coordinate + T::ONE) * half_span;
        let inside = coordinate >= -T::ONE && coordinate <= T::ONE;
        let texel = if unclamped < T::ZERO {
            T::ZERO
        } else if unclamped > last {
            last
        } else {
            unclamped
        };
        let low = (texel.to_f64() as usize).min(texels.saturating_sub(2));
        Self {
            low,
            high: (low + 1).min(texels - 1),
            fraction: texel - T::from_f64(low as f64),
            slope: if inside { half_span } else { T::ZERO },
        }
    }
}
