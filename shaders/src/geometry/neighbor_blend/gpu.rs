//! The kernels of blends, weights and frames.

#[cfg(test)]
#[path = "gpu_tests.rs"]
mod tests;

use super::Neighbors;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, columns_for, lanes_for, uniforms};
use crate::tape::{Real, Tensor};

const NEAREST: Kernel = Kernel { name: "nearest nodes", text: include_str!("nearest.wgsl") };
const NEAREST_ANY: Kernel = Kernel { name: "nearest nodes, any", text: include_str!("nearest_any.wgsl") };

const BLEND: Kernel = Kernel { name: "neighbor blend", text: include_str!("neighbor_blend.wgsl") };
const BLEND_WEIGHTS: Kernel =
    Kernel { name: "neighbor blend backward, weights", text: include_str!("neighbor_blend_weights_bwd.wgsl") };
const BLEND_VALUES: Kernel = Kernel { name: "neighbor blend backward", text: include_str!("neighbor_blend_bwd.wgsl") };

const WEIGHTS: Kernel = Kernel { name: "neighbor weights", text: include_str!("weights.wgsl") };
const WEIGHTS_POINTS: Kernel = Kernel { name: "neighbor weights backward", text: include_str!("weights_bwd.wgsl") };
const WEIGHTS_NODES: Kernel =
    Kernel { name: "neighbor weights backward, nodes", text: include_str!("weights_nodes_bwd.wgsl") };

const FRAMES: Kernel = Kernel { name: "blend frames", text: include_str!("frames.wgsl") };
const FRAMES_POINTS: Kernel = Kernel { name: "blend frames backward", text: include_str!("frames_bwd.wgsl") };
const FRAMES_NODES: Kernel =
    Kernel { name: "blend frames backward, nodes", text: include_str!("frames_nodes_bwd.wgsl") };

/// The most axes that an invocation keeps in registers, for the point whose nodes it searches and for gradients.
const MAX_AXES: usize = 32;
/// The most nodes per point that an invocation keeps in registers.
const MAX_KEPT: usize = 32;

uniforms! {
    struct NearestBlock as "Nearest" {
        points: u32,
        nodes: u32,
        axes: u32,
        kept: u32,
    }
}

uniforms! {
    struct BlendBlock as "Blend" {
        points: u32,
        per_point: u32,
        columns: u32,
        nodes: u32,
    }
}

uniforms! {
    struct WeightsBlock as "Weights" {
        points: u32,
        per_point: u32,
        axes: u32,
        nodes: u32,
    }
}

uniforms! {
    struct FramesBlock as "Frames" {
        points: u32,
        per_point: u32,
        nodes: u32,
    }
}

/// The nearest nodes of every point.
pub(super) fn nearest<T: Real>(
    gpu: Gpu,
    points: &Tensor<T>,
    nodes: &Tensor<T>,
    per_point: usize,
    others: bool,
) -> GpuArray {
    let axes = nodes.row_len();
    let node_of_item = GpuArray::new(gpu, points.rows() * per_point);
    let [points_read, nodes_read] = read(gpu, [points, nodes]);
    let arrays = [points_read, nodes_read, Binding::Write(&node_of_item)];
    let (others, groups) = (("OTHERS", u32::from(others)), Groups::Over(points.rows()));
    let sizes = [points.rows(), nodes.rows(), axes, per_point].map(|size| size as u32);
    let block = NearestBlock { points: sizes[0], nodes: sizes[1], axes: sizes[2], kept: sizes[3] };
    if (1..=MAX_AXES).contains(&axes) && per_point <= MAX_KEPT {
        let specialisation = [("AXES", axes as u32), ("KEPT", per_point as u32), others];
        NEAREST.launch(gpu, &specialisation, &block, &arrays, groups);
    } else {
        let distances = GpuArray::new(gpu, node_of_item.len());
        NEAREST_ANY.launch(gpu, &[others], &block, &[&arrays[..], &[Binding::Write(&distances)]].concat(), groups);
    }
    node_of_item
}

impl Neighbors {
    /// Points, nodes of each, nodes.
    fn sizes(&self) -> [u32; 3] {
        [self.points(), self.per_point(), self.nodes()].map(|size| size as u32)
    }

    fn node_of_item_on_gpu(&self, gpu: Gpu) -> Binding<'_> {
        Binding::Read(&self.node_of_item().on_gpu(gpu).row_of_item)
    }

    /// The items of every node, and where they begin.
    fn followers_on_gpu(&self, gpu: Gpu) -> [Binding<'_>; 2] {
        let followers = self.node_of_item().on_gpu(gpu).sorted();
        [&followers.items, &followers.starts].map(Binding::Read)
    }

    /// Invocations that share the followers of a node, and the workgroups for all nodes.
    fn lanes(&self) -> (usize, Groups<'static>) {
        let lanes = lanes_for(self.points() * self.per_point() / self.nodes().max(1));
        (lanes, Groups::Over(self.nodes() * lanes))
    }
}

fn read<'a, T: Real, const N: usize>(gpu: Gpu, tensors: [&'a Tensor<T>; N]) -> [Binding<'a>; N] {
    tensors.map(|tensor| Binding::Read(tensor.on_gpu(gpu)))
}

fn blend_block(neighbors: &Neighbors, columns: usize) -> BlendBlock {
    let [points, per_point, nodes] = neighbors.sizes();
    BlendBlock { points, per_point, columns: columns as u32, nodes }
}

pub(super) fn blend<T: Real>(gpu: Gpu, neighbors: &Neighbors, [weights, values]: [&Tensor<T>; 2]) -> Tensor<T> {
    let (points, columns) = (weights.rows(), values.row_len());
    let y = GpuArray::new(gpu, points * columns);
    let arrays =
        [&read(gpu, [weights, values])[..], &[neighbors.node_of_item_on_gpu(gpu), Binding::Write(&y)]].concat();
    BLEND.launch(gpu, &[], &blend_block(neighbors, columns), &arrays, Groups::Over(y.len()));
    Tensor::from_gpu([points, columns], y)
}

/// The requested gradients of weights and values.
pub(super) fn blend_backward<T: Real>(
    gpu: Gpu,
    neighbors: &Neighbors,
    [weights, values]: [&Tensor<T>; 2],
    dy: &Tensor<T>,
    needs: &[bool],
) -> Vec<Option<Tensor<T>>> {
    let (columns, block) = (values.row_len(), blend_block(neighbors, values.row_len()));
    let to_weights = || {
        let gradient = GpuArray::new(gpu, weights.len());
        let [values, dy] = read(gpu, [values, dy]);
        let arrays = [values, neighbors.node_of_item_on_gpu(gpu), dy, Binding::Write(&gradient)];
        BLEND_WEIGHTS.launch(gpu, &[], &block, &arrays, Groups::Over(gradient.len()));
        Tensor::from_gpu(weights.shape(), gradient)
    };
    let to_values = || {
        let gradient = GpuArray::new(gpu, values.len());
        let ([weights, dy], [items, starts]) = (read(gpu, [weights, dy]), neighbors.followers_on_gpu(gpu));
        let tile = columns_for(columns);
        let groups = neighbors.nodes() * columns.div_ceil(tile);
        let arrays = [weights, items, starts, dy, Binding::Write(&gradient)];
        BLEND_VALUES.launch(gpu, &[("COLUMNS", tile as u32)], &block, &arrays, groups);
        Tensor::from_gpu(values.shape(), gradient)
    };
    vec![needs[0].then(to_weights), needs[1].then(to_values)]
}

/// Bindings of points, nodes, radii and gates; radii are the placeholder of missing gates.
fn placed<'a, T: Real>(gpu: Gpu, inputs: &[&'a Tensor<T>]) -> ([Binding<'a>; 4], (&'static str, u32)) {
    let gates = inputs.get(3).unwrap_or(&inputs[2]);
    (read(gpu, [inputs[0], inputs[1], inputs[2], gates]), ("GATED", u32::from(inputs.len() == 4)))
}

fn weights_block<T: Real>(neighbors: &Neighbors, points: &Tensor<T>) -> WeightsBlock {
    let [points_len, per_point, nodes] = neighbors.sizes();
    WeightsBlock { points: points_len, per_point, axes: points.row_len() as u32, nodes }
}

pub(super) fn weights<T: Real>(gpu: Gpu, neighbors: &Neighbors, inputs: &[&Tensor<T>]) -> Tensor<T> {
    let shape = [neighbors.points(), neighbors.per_point()];
    let weights = GpuArray::new(gpu, shape[0] * shape[1]);
    let (placed, gated) = placed(gpu, inputs);
    let arrays = [&placed[..], &[neighbors.node_of_item_on_gpu(gpu), Binding::Write(&weights)]].concat();
    let block = weights_block(neighbors, inputs[0]);
    WEIGHTS.launch(gpu, &[gated], &block, &arrays, Groups::Over(neighbors.points()));
    Tensor::from_gpu(shape, weights)
}

/// The gradients of all inputs.
pub(super) fn weights_backward<T: Real>(
    gpu: Gpu,
    neighbors: &Neighbors,
    inputs: &[&Tensor<T>],
    [weights, dweights]: [&Tensor<T>; 2],
) -> Vec<Option<Tensor<T>>> {
    let (placed, gated) = placed(gpu, inputs);
    let (block, nodes) = (weights_block(neighbors, inputs[0]), neighbors.nodes());
    let unnormalised = GpuArray::new(gpu, weights.len());
    let [to_points, to_nodes, to_radii, to_gates] =
        [inputs[0].len(), inputs[1].len(), nodes, nodes].map(|len| GpuArray::new(gpu, len));

    let [weights, dweights] = read(gpu, [weights, dweights]);
    let written = [&unnormalised, &to_points].map(Binding::Write);
    let of_points = [&placed[..], &[neighbors.node_of_item_on_gpu(gpu), weights, dweights], &written].concat();
    WEIGHTS_POINTS.launch(gpu, &[gated], &block, &of_points, Groups::Over(neighbors.points()));

    let (lanes, groups) = neighbors.lanes();
    let written = [&to_nodes, &to_radii, &to_gates].map(Binding::Write);
    let followers = neighbors.followers_on_gpu(gpu);
    let of_nodes = [&placed[..], &followers, &[Binding::Read(&unnormalised)], &written].concat();
    let specialisation = [gated, ("LANES", lanes as u32), ("AXES", inputs[0].row_len().clamp(1, MAX_AXES) as u32)];
    WEIGHTS_NODES.launch(gpu, &specialisation, &block, &of_nodes, groups);

    let gradients = [to_points, to_nodes, to_radii, to_gates].into_iter().zip(inputs);
    gradients.map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
}

fn frames_block(neighbors: &Neighbors) -> FramesBlock {
    let [points, per_point, nodes] = neighbors.sizes();
    FramesBlock { points, per_point, nodes }
}

/// Weights, points, positions, translations and rotations.
fn frames_inputs<'a, T: Real>(gpu: Gpu, inputs: &[&'a Tensor<T>]) -> Vec<Binding<'a>> {
    inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu))).collect()
}

pub(super) fn blend_frames<T: Real>(gpu: Gpu, neighbors: &Neighbors, inputs: &[&Tensor<T>]) -> Tensor<T> {
    let y = GpuArray::new(gpu, inputs[1].len());
    let mut arrays = frames_inputs(gpu, inputs);
    arrays.extend([neighbors.node_of_item_on_gpu(gpu), Binding::Write(&y)]);
    FRAMES.launch(gpu, &[], &frames_block(neighbors), &arrays, Groups::Over(neighbors.points()));
    Tensor::from_gpu(inputs[1].shape(), y)
}

/// The gradients of all inputs.
pub(super) fn blend_frames_backward<T: Real>(
    gpu: Gpu,
    neighbors: &Neighbors,
    inputs: &[&Tensor<T>],
    dy: &Tensor<T>,
) -> Vec<Option<Tensor<T>>> {
    let gradients: Vec<GpuArray> = inputs.iter().map(|input| GpuArray::new(gpu, input.len())).collect();
    let (block, dy) = (frames_block(neighbors), Binding::Read(dy.on_gpu(gpu)));
    let mut of_points = frames_inputs(gpu, inputs);
    of_points.extend([neighbors.node_of_item_on_gpu(gpu), dy]);
    of_points.extend(gradients[..2].iter().map(Binding::Write));
    FRAMES_POINTS.launch(gpu, &[], &block, &of_points, Groups::Over(neighbors.points()));

    let mut of_nodes = frames_inputs(gpu, inputs);
    of_nodes.extend(neighbors.followers_on_gpu(gpu));
    of_nodes.push(dy);
    of_nodes.extend(gradients[2..].iter().map(Binding::Write));
    let (lanes, groups) = neighbors.lanes();
    FRAMES_NODES.launch(gpu, &[("LANES", lanes as u32)], &block, &of_nodes, groups);
    gradients.into_iter().zip(inputs).map(|(array, input)| Some(Tensor::from_gpu(input.shape(), array))).collect()
}
