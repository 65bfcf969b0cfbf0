use super::lookup::Lookup;
use super::{Field, PAIRS};
use crate::tape::Real;

/// Features of `positions` [n, 3] into `out` [n, C·scales]: the definition, six bilinear lookups per scale.
pub(super) fn forward<T: Real>(field: &Field<T>, positions: &[T], out: &mut [T]) {
    let channels = field.channels();
    for (point, out) in positions.chunks_exact(3).zip(out.chunks_exact_mut(channels * field.scales())) {
        for (scale, out) in out.chunks_exact_mut(channels).enumerate() {
            let lookups = lookups(field, scale, point);
            for (channel, out) in out.iter_mut().enumerate() {
                *out =
                    (0..6).map(|plane| sample(field, scale, plane, &lookups, channel).value).fold(T::ONE, |a, b| a * b);
            }
        }
    }
}

/// Adds the gradients of `dy` [n, C·scales] to those of the positions [n, 3] and of the planes.
pub(super) fn backward<T: Real>(
    field: &Field<T>,
    positions: &[T],
    dy: &[T],
    position_gradients: &mut [T],
    plane_gradients: &mut [&mut [T]],
) {
    let (channels, scales) = (field.channels(), field.scales());
    for (n, dy) in dy.chunks_exact(channels * scales).enumerate() {
        for (index, &dy) in dy.iter().enumerate() {
            let (scale, channel) = (index / channels, index % channels);
            let lookups = lookups(field, scale, &positions[3 * n..3 * n + 3]);
            let samples: [Sample<T>; 6] = std::array::from_fn(|plane| sample(field, scale, plane, &lookups, channel));
            for (plane, &(a, b)) in PAIRS.iter().enumerate() {
                // The gradient of this plane's value is dy times the product of the other five.
                let others = (0..6).filter(|&other| other != plane).map(|other| samples[other].value);
                let dvalue = others.fold(dy, |product, value| product * value);
                for (texel, weight) in samples[plane].taps {
                    plane_gradients[6 * scale + plane][texel * channels + channel] += weight * dvalue;
                }
                for (axis, derivative) in [(a, samples[plane].d_a), (b, samples[plane].d_b)] {
                    if axis < 3 {
                        position_gradients[3 * n + axis] += dvalue * derivative;
                    }
                }
            }
        }
    }
}

fn lookups<T: Real>(field: &Field<T>, scale: usize, point: &[T]) -> [Lookup<T>; 4] {
    let resolution = field.resolution(scale);
    std::array::from_fn(|axis| Lookup::new(if axis < 3 { point[axis] } else { field.time }, resolution[axis]))
}

/// One channel of one plane at one point.
struct Sample<T> {
    value: T,
    /// (texel, weight) of the four neighbours.
    taps: [(usize, T); 4],
    /// Derivatives with respect to the two coordinates.
    d_a: T,
    d_b: T,
}

fn sample<T: Real>(
    field: &Field<T>,
    scale: usize,
    plane: usize,
    lookups: &[Lookup<T>; 4],
    channel: usize,
) -> Sample<T> {
    let tensor = field.planes[6 * scale + plane];
    let (width, channels) = (tensor.shape()[1], tensor.shape()[2]);
    let (x, y) = (&lookups[PAIRS[plane].0], &lookups[PAIRS[plane].1]);
    let (fx, fy) = (x.fraction, y.fraction);
    let taps = [
        (y.low * width + x.low, (T::ONE - fy) * (T::ONE - fx)),
        (y.low * width + x.high, (T::ONE - fy) * fx),
        (y.high * width + x.low, fy * (T::ONE - fx)),
        (y.high * width + x.high, fy * fx),
    ];
    let [p00, p01, p10, p11] = taps.map(|(texel, _)| tensor.as_slice()[texel * channels + channel]);
    let [w00, w01, w10, w11] = taps.map(|(_, weight)| weight);
    Sample {
        value: w00 * p00 + w01 * p01 + w10 * p10 + w11 * p11,
        taps,
        d_a: x.slope * ((T::ONE - fy) * (p01 - p00) + fy * (p11 - p10)),
        d_b: y.slope * ((T::ONE - fx) * (p10 - p00) + fx * (p11 - p01)),
    }
}
