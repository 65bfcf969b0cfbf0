//! Points carried by the moving frames of their nodes.

use super::{Neighbors, for_each_row, gpu};
use crate::geometry::algebra::{
    Mat3, Quaternion, Vec3, apply, combine, dot, normalised, normalised_backward, rotation, rotation_backward,
    transposed,
};
use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// Positions and motions of the nodes of [`blend_frames`].
#[derive(Clone, Copy, Debug)]
pub struct Frames {
    /// [M, 3].
    pub positions: Var,
    /// [M, 3].
    pub translations: Var,
    /// [M, 4] quaternions (w, x, y, z), normalised here.
    pub rotations: Var,
}

/// Σₖ wₙₖ·(Rₖ(xₙ − pₖ) + pₖ + tₖ) over the nodes k of point n (Sumner et al. 2007, equation 3): weights [N, K] and points x
/// [N, 3] → [N, 3].
pub fn blend_frames<T: Real>(
    tape: &mut Tape<T>,
    weights: Var,
    points: Var,
    frames: Frames,
    neighbors: &Neighbors,
) -> Var {
    assert_eq!(tape.value(weights).shape(), [neighbors.points(), neighbors.per_point()], "blend_frames: weights");
    let Frames { positions, translations, rotations } = frames;
    for (var, columns) in [(positions, 3), (translations, 3), (rotations, 4)] {
        assert_eq!(tape.value(var).shape(), [neighbors.nodes(), columns], "blend_frames: one row per node");
    }
    tape.apply_one(BlendFrames { neighbors: neighbors.clone() }, &[weights, points, positions, translations, rotations])
}

struct BlendFrames {
    neighbors: Neighbors,
}

/// One node's frame.
struct Frame<T> {
    position: Vec3<T>,
    translation: Vec3<T>,
    rotation: Mat3<T>,
    unit: Quaternion<T>,
    inverse_norm: T,
}

impl<T: Real> Frame<T> {
    fn all(inputs: &[&Tensor<T>]) -> Vec<Self> {
        let frame = |node: usize| {
            let raw = inputs[4].row(node);
            let (unit, inverse_norm) = normalised([raw[0], raw[1], raw[2], raw[3]]);
            let [position, translation] = [2, 3].map(|input| vector(inputs[input].row(node)));
            Self { position, translation, rotation: rotation(unit), unit, inverse_norm }
        };
        (0..inputs[2].rows()).map(frame).collect()
    }

    /// R(x − p) + p + t.
    fn carry(&self, x: Vec3<T>) -> Vec3<T> {
        let turned = apply(&self.rotation, self.arm(x));
        [0, 1, 2].map(|axis| turned[axis] + self.position[axis] + self.translation[axis])
    }

    /// x − p.
    fn arm(&self, x: Vec3<T>) -> Vec3<T> {
        combine(T::ONE, x, -T::ONE, self.position)
    }
}

fn vector<T: Real>(row: &[T]) -> Vec3<T> {
    [row[0], row[1], row[2]]
}

impl<T: Real> Op<T> for BlendFrames {
    fn name(&self) -> &'static str {
        "blend_frames"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let (weights, points, frames) = (inputs[0], inputs[1], Frame::all(inputs));
        let mut out = vec![T::ZERO; points.len()];
        for_each_row(&mut out, 3, |point, out| {
            for (&node, &weight) in self.neighbors.of_point(point).iter().zip(weights.row(point)) {
                let carried = frames[node as usize].carry(vector(points.row(point)));
                out.iter_mut().zip(carried).for_each(|(out, carried)| *out += weight * carried);
            }
        });
        vec![Tensor::from_vec(points.shape(), out)]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let inputs = pass.inputs;
        let dy = pass.dy();
        let (weights, points, frames) = (inputs[0], inputs[1], Frame::all(inputs));
        let mut to_weights = vec![T::ZERO; weights.len()];
        for_each_row(&mut to_weights, weights.row_len(), |point, out| {
            for (out, &node) in out.iter_mut().zip(self.neighbors.of_point(point)) {
                *out = dot(frames[node as usize].carry(vector(points.row(point))), vector(dy.row(point)));
            }
        });
        let mut to_points = vec![T::ZERO; points.len()];
        for_each_row(&mut to_points, 3, |point, out| {
            for (&node, &weight) in self.neighbors.of_point(point).iter().zip(weights.row(point)) {
                let back = apply(&transposed(&frames[node as usize].rotation), vector(dy.row(point)));
                out.iter_mut().zip(back).for_each(|(out, back)| *out += weight * back);
            }
        });
        let mut gradients = vec![
            Some(Tensor::from_vec(weights.shape(), to_weights)),
            Some(Tensor::from_vec(points.shape(), to_points)),
        ];
        gradients.extend(self.to_nodes(weights, points, dy, &frames).map(Some));
        gradients
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for BlendFrames {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![gpu::blend_frames(gpu, &self.neighbors, inputs)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        gpu::blend_frames_backward(gpu, &self.neighbors, pass.inputs, pass.dy())
    }
}

/// Columns of position, translation and rotation.
const NODE_COLUMNS: [usize; 3] = [3, 3, 4];

impl BlendFrames {
    /// The gradients of positions, translations and rotations.
    fn to_nodes<T: Real>(
        &self,
        weights: &Tensor<T>,
        points: &Tensor<T>,
        dy: &Tensor<T>,
        frames: &[Frame<T>],
    ) -> [Tensor<T>; 3] {
        let columns = NODE_COLUMNS.iter().sum();
        let mut joined = vec![T::ZERO; frames.len() * columns];
        for_each_row(&mut joined, columns, |node, out| {
            let frame = &frames[node];
            let (mut total, mut to_matrix) = ([T::ZERO; 3], [[T::ZERO; 3]; 3]);
            for (point, rank) in self.neighbors.followers(node) {
                let pulled = vector(dy.row(point)).map(|dy| weights.row(point)[rank] * dy);
                let arm = frame.arm(vector(points.row(point)));
                for row in 0..3 {
                    total[row] += pulled[row];
                    to_matrix[row] = combine(T::ONE, to_matrix[row], pulled[row], arm);
                }
            }
            let of_unit = rotation_backward(frame.unit, &to_matrix);
            out[..3].copy_from_slice(&combine(T::ONE, total, -T::ONE, apply(&transposed(&frame.rotation), total)));
            out[3..6].copy_from_slice(&total);
            out[6..].copy_from_slice(&normalised_backward(frame.unit, frame.inverse_norm, of_unit));
        });
        [0, 1, 2].map(|part| {
            let first: usize = NODE_COLUMNS[..part].iter().sum();
            let range = first..first + NODE_COLUMNS[part];
            let rows = joined.chunks_exact(columns).flat_map(|row| &row[range.clone()]).copied().collect();
            Tensor::from_vec([frames.len(), NODE_COLUMNS[part]], rows)
        })
    }
}
