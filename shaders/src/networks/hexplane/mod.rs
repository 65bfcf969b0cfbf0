//! Hexplane field: features of a point in space and time from six planes per scale (Cao and Johnson 2023; Wu et al. 2024).
//!
//! For each scale, the pairs (a, b) of the axes x, y, z, t in the order xy, xz, xt, yz, yt, zt each have a plane of shape
//! [resolution b, resolution a, C] with the channels innermost. A point reads every plane by bilinear interpolation, the
//! six values are multiplied channel by channel, and the products of all scales are concatenated to [N, C·scales].
//!
//! Coordinates lie in [−1, 1] with the first and last texel centres at −1 and 1 (align-corners). Outside, the border value
//! holds and the gradient with respect to the coordinate is zero. All points of a call share one time, so a time plane
//! is blended once into a row, which every point then reads by linear interpolation.

mod cpu;
mod gpu;
#[cfg(test)]
mod gpu_tests;
mod lookup;
mod order;
mod plane_means;
mod reference;
mod scales;
#[cfg(test)]
mod tests;

pub use plane_means::{PlaneMean, plane_means};

use crate::gpu::Gpu;
use crate::tape::chunks::chunked;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// The axes (a, b) of the six planes of a scale; axis 3 is time.
pub const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

const TIME: usize = 3;

/// Points per chunk of the forward pass.
const POINTS_PER_CHUNK: usize = 512;

/// The sizes of a field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HexplaneShape {
    /// Features per texel of every plane.
    pub channels: usize,
    /// Texels along x, y, z and t at multiplier 1.
    pub resolution: [usize; 4],
    /// One scale per entry; multiplies the spatial resolutions only.
    pub multipliers: Vec<usize>,
}

impl HexplaneShape {
    /// [resolution b, resolution a, channels] of every plane, scale by scale in the order of [`PAIRS`].
    pub fn plane_shapes(&self) -> Vec<[usize; 3]> {
        let shapes_at = |&multiplier: &usize| {
            let texels = move |axis: usize| self.resolution[axis] * if axis == TIME { 1 } else { multiplier };
            PAIRS.map(|(a, b)| [texels(b), texels(a), self.channels])
        };
        self.multipliers.iter().flat_map(shapes_at).collect()
    }

    /// Features per point: channels times scales.
    pub fn features(&self) -> usize {
        self.channels * self.multipliers.len()
    }
}

/// Whether plane `index` of [`HexplaneShape::plane_shapes`] has time as its height axis.
pub fn is_time_plane(index: usize) -> bool {
    PAIRS[index % 6].1 == TIME
}

/// Features [N, C·scales] of `positions` [N, 3] at `time`, all in [−1, 1] coordinates.
///
/// Gradients flow to the positions and to the planes, given in the order of [`HexplaneShape::plane_shapes`].
pub fn hexplane<T: Real>(tape: &mut Tape<T>, planes: &[Var], positions: Var, time: f64) -> Var {
    let shapes: Vec<&[usize]> = planes.iter().map(|&plane| tape.value(plane).shape()).collect();
    assert_eq!(tape.value(positions).row_len(), 3, "hexplane: positions must be [N, 3]");
    assert!(!planes.is_empty() && planes.len().is_multiple_of(6), "hexplane: six planes per scale");
    assert!(shapes.chunks(6).all(is_consistent), "hexplane: plane shapes do not fit together: {shapes:?}");
    assert!(shapes.iter().all(|shape| shape[2] == shapes[0][2]), "hexplane: planes differ in channels");
    let inputs: Vec<Var> = [positions].iter().chain(planes).copied().collect();
    tape.apply_one(Hexplane { time: T::from_f64(time) }, &inputs)
}

/// Whether the six planes of a scale agree on the resolution of every axis.
fn is_consistent(shapes: &[&[usize]]) -> bool {
    let resolution = [shapes[0][1], shapes[0][0], shapes[1][0], shapes[2][0]];
    PAIRS.iter().zip(shapes).all(|(&(a, b), shape)| shape[..2] == [resolution[b], resolution[a]])
}

/// The planes of all scales and the time at which they are read.
pub(crate) struct Field<'a, T: Real> {
    planes: &'a [&'a Tensor<T>],
    time: T,
}

impl<T: Real> Field<'_, T> {
    fn channels(&self) -> usize {
        self.planes[0].shape()[2]
    }

    fn scales(&self) -> usize {
        self.planes.len() / 6
    }

    /// Texels along x, y, z and t at a scale.
    fn resolution(&self, scale: usize) -> [usize; 4] {
        let height = |plane: usize| self.planes[6 * scale + plane].shape()[0];
        [self.planes[6 * scale].shape()[1], height(0), height(1), height(2)]
    }
}

struct Hexplane<T> {
    time: T,
}

impl<T: Real> Op<T> for Hexplane<T> {
    fn name(&self) -> &'static str {
        "hexplane"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let (positions, field) = (inputs[0], Field { planes: &inputs[1..], time: self.time });
        let features = field.channels() * field.scales();
        let fast = cpu::Forward::new(&field);
        let out = chunked(positions.rows() * features, POINTS_PER_CHUNK * features, |first, out| {
            let first_point = first / features;
            let positions = &positions.as_slice()[3 * first_point..3 * (first_point + out.len() / features)];
            match (&fast, T::as_f32(positions), T::as_f32_mut(out)) {
                (Some(fast), Some(positions), Some(out)) => fast.run(positions, out),
                _ => reference::forward(&field, positions, out),
            }
        });
        vec![Tensor::from_vec([positions.rows(), features], out)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        pass.summed_from_zero(|totals| self.accumulate(pass, totals))
    }

    fn accumulate(&mut self, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        let Backward { inputs, needs, .. } = pass;
        let dy = pass.dy();
        let field = Field { planes: &inputs[1..], time: self.time };
        let start = |(total, input): (&mut Option<Tensor<T>>, &&Tensor<T>)| {
            total.take().unwrap_or_else(|| Tensor::zeros(input.shape()))
        };
        let mut sums: Vec<Tensor<T>> = totals.iter_mut().zip(inputs).map(start).collect();
        let mut gradients = sums.iter_mut().map(Tensor::make_mut);
        let positions = gradients.next().expect("positions come first");
        let mut planes: Vec<&mut [T]> = gradients.collect();
        if !cpu::backward(&field, inputs[0].as_slice(), dy.as_slice(), positions, &mut planes) {
            reference::backward(&field, inputs[0].as_slice(), dy.as_slice(), positions, &mut planes);
        }
        for ((total, sum), &needed) in totals.iter_mut().zip(sums).zip(needs) {
            *total = needed.then_some(sum);
        }
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Hexplane<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::forward(gpu, &Field { planes: &inputs[1..], time: self.time }, inputs[0])])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        pass.summed_from_zero(|totals| self.accumulate_gpu(gpu, pass, totals))
    }

    fn accumulate_gpu(&mut self, gpu: Gpu, pass: Backward<T>, totals: &mut [Option<Tensor<T>>]) {
        let Backward { inputs, needs, .. } = pass;
        let dy = pass.dy();
        let field = Field { planes: &inputs[1..], time: self.time };
        gpu::add_gradients(gpu, &field, inputs[0], dy, totals);
        totals.iter_mut().zip(needs).filter(|(_, needed)| !**needed).for_each(|(total, _)| *total = None);
    }
}
