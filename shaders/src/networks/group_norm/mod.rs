//! Group normalisation of an image (Wu and He 2018): y = γ·(x − μ)/√(σ² + ε) + β, with mean μ and variance σ² over all
//! pixels and the channels of a group.
//!
//! x [H, W, C], γ `[C]`, β `[C]` → y [H, W, C]. Unlike batch normalisation, it is the same function in training and at test
//! time. Sums run over chunks of fixed size, on the CPU in f64 and on a GPU in f32.

mod gpu;
#[cfg(test)]
mod tests;

use crate::gpu::Gpu;
use crate::tape::chunks::{chunked, map_chunks};
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};
use gpu::GpuStatistics;

/// ε of Wu and He 2018.
const EPSILON: f64 = 1e-5;
/// Pixels per partial sum.
const PIXELS_PER_CHUNK: usize = 1024;

/// y [H, W, C] for x [H, W, C], scale γ `[C]` and shift β `[C]`; `groups` divides C.
pub fn group_norm<T: Real>(tape: &mut Tape<T>, x: Var, scale: Var, shift: Var, groups: usize) -> Var {
    let &[_, _, channels] = tape.value(x).shape() else { panic!("group_norm: x must be [H, W, C]") };
    assert!(channels.is_multiple_of(groups), "group_norm: {groups} groups do not divide {channels} channels");
    for var in [scale, shift] {
        assert_eq!(tape.value(var).len(), channels, "group_norm: scale and shift need one value per channel");
    }
    tape.apply_one(GroupNorm { channels, groups, statistics: Vec::new(), on_gpu: None }, &[x, scale, shift])
}

struct GroupNorm {
    channels: usize,
    groups: usize,
    /// Per group: mean and 1/√(σ² + ε).
    statistics: Vec<[f64; 2]>,
    /// The statistics, if a GPU computed them.
    on_gpu: Option<GpuStatistics>,
}

impl GroupNorm {
    /// Per channel Σ over pixels of each of the terms, which depend on the values of the pixel and channel in `images`.
    fn channel_sums<T: Real, const I: usize, const N: usize>(
        &self,
        images: [&[T]; I],
        terms: impl Fn([f64; I], usize) -> [f64; N] + Sync + Send,
    ) -> Vec<[f64; N]> {
        let channels = self.channels;
        let partial = map_chunks(images[0].len() / channels, PIXELS_PER_CHUNK, |range| {
            let mut sums = vec![[0.0; N]; channels];
            for pixel in range {
                let pixels = images.map(|image| &image[pixel * channels..][..channels]);
                for (channel, sum) in sums.iter_mut().enumerate() {
                    let terms = terms(pixels.map(|pixel| pixel[channel].to_f64()), channel);
                    (0..N).for_each(|term| sum[term] += terms[term]);
                }
            }
            sums
        });
        let mut total = vec![[0.0; N]; channels];
        for sums in partial {
            total.iter_mut().zip(sums).for_each(|(total, sum)| (0..N).for_each(|term| total[term] += sum[term]));
        }
        total
    }

    /// Sums of channels to sums of groups.
    fn group_sums<const N: usize>(&self, channels: &[[f64; N]]) -> Vec<[f64; N]> {
        let sum = |group: &[[f64; N]]| std::array::from_fn(|term| group.iter().map(|sums| sums[term]).sum());
        channels.chunks_exact(self.channels / self.groups).map(sum).collect()
    }

    /// Values of groups, repeated for every channel of the group.
    fn per_channel<V: Copy>(&self, groups: &[V]) -> Vec<V> {
        groups.iter().flat_map(|&value| std::iter::repeat_n(value, self.channels / self.groups)).collect()
    }
}

impl<T: Real> Op<T> for GroupNorm {
    fn name(&self) -> &'static str {
        "group_norm"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let [x, scale, shift] = [0, 1, 2].map(|input| inputs[input].as_slice());
        let pixels = x.len() / self.channels;
        let count = (pixels * (self.channels / self.groups)) as f64;
        // Two passes: the variance about the mean does not cancel.
        let sums = self.group_sums(&self.channel_sums([x], |[x], _| [x]));
        let means: Vec<f64> = sums.iter().map(|[sum]| sum / count).collect();
        let mean_by_channel = self.per_channel(&means);
        let squares = self.channel_sums([x], |[x], channel| {
            let difference = x - mean_by_channel[channel];
            [difference * difference]
        });
        let inverse = |[sum]: &[f64; 1]| 1.0 / (sum / count + EPSILON).sqrt();
        self.statistics =
            means.iter().zip(&self.group_sums(&squares)).map(|(&mean, square)| [mean, inverse(square)]).collect();

        // The mean is subtracted first: a factor times a large mean would cancel in f32.
        let statistics = self.per_channel(&self.statistics);
        let of_channel = |([mean, inverse], (scale, shift)): ([f64; 2], (&T, &T))| {
            [mean, scale.to_f64() * inverse, shift.to_f64()].map(T::from_f64)
        };
        let affine: Vec<[T; 3]> = statistics.into_iter().zip(scale.iter().zip(shift)).map(of_channel).collect();
        let y = chunked(x.len(), PIXELS_PER_CHUNK * self.channels, |first, y| {
            for (y, x) in y.chunks_exact_mut(self.channels).zip(x[first..].chunks_exact(self.channels)) {
                for (y, (&x, &[mean, factor, shift])) in y.iter_mut().zip(x.iter().zip(&affine)) {
                    *y = factor * (x - mean) + shift;
                }
            }
        });
        vec![Tensor::from_vec(inputs[0].shape(), y)]
    }

    /// With x̂ = (x − μ)/√(σ² + ε) and g = γ·dy: dx = (g − mean(g) − x̂·mean(g·x̂))/√(σ² + ε), means over the group.
    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, needs, .. } = pass;
        let dy = pass.dy().as_slice();
        let (x, scale) = (inputs[0].as_slice(), inputs[1].as_slice());
        let pixels = x.len() / self.channels;
        let count = (pixels * (self.channels / self.groups)) as f64;
        let statistics = self.per_channel(&self.statistics);
        let normalized = |x: f64, channel: usize| {
            let [mean, inverse] = statistics[channel];
            (x - mean) * inverse
        };
        // Per channel Σ dy and Σ dy·x̂: the gradients of β and γ.
        let sums = self.channel_sums([dy, x], |[dy, x], channel| [dy, dy * normalized(x, channel)]);
        let scaled = |(sums, scale): (&[f64; 2], &T)| sums.map(|sum| sum * scale.to_f64() / count);
        let means = self.per_channel(&self.group_sums(&sums.iter().zip(scale).map(scaled).collect::<Vec<_>>()));
        let dx = || {
            let dx = chunked(x.len(), PIXELS_PER_CHUNK * self.channels, |first, dx: &mut [T]| {
                let inputs = x[first..].chunks_exact(self.channels).zip(dy[first..].chunks_exact(self.channels));
                for (dx, (x, dy)) in dx.chunks_exact_mut(self.channels).zip(inputs) {
                    for (channel, dx) in dx.iter_mut().enumerate() {
                        let [mean, mean_product] = means[channel];
                        let g = scale[channel].to_f64() * dy[channel].to_f64();
                        let x = normalized(x[channel].to_f64(), channel);
                        *dx = T::from_f64((g - mean - x * mean_product) * statistics[channel][1]);
                    }
                }
            });
            Tensor::from_vec(inputs[0].shape(), dx)
        };
        let of_channels =
            |term: usize| Tensor::from_vec([self.channels], sums.iter().map(|sums| T::from_f64(sums[term])).collect());
        vec![needs[0].then(dx), needs[1].then(|| of_channels(1)), needs[2].then(|| of_channels(0))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for GroupNorm {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.forward_on_gpu(gpu, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        self.backward_on_gpu(gpu, pass.inputs, pass.dy())
    }
}
