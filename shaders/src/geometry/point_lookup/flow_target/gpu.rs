//! The kernel of targets.

use super::{DEPTH_TOLERANCE, FlowMaps};
use crate::geometry::point_lookup::PinholeCamera;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor};

pub(super) const TARGETS: Kernel = Kernel { name: "flow targets", text: include_str!("flow_target.wgsl") };

uniforms! {
    pub(super) struct FlowBlock as "Flow" {
        rows: [[f32; 4]; 3],
        rows_to: [[f32; 4]; 3],
        focal: [f32; 2],
        center: [f32; 2],
        focal_to: [f32; 2],
        center_to: [f32; 2],
        size: [u32; 2],
        size_to: [u32; 2],
        count: u32,
        depth_tolerance: f32,
        padding: [u32; 2],
    }
}

/// Rows of camera_from_world, with the translation last.
fn rows(camera: &PinholeCamera) -> [[f32; 4]; 3] {
    let row = |axis: usize| {
        let [x, y, z] = camera.rotation[axis];
        [x, y, z, camera.translation[axis]].map(|value| value as f32)
    };
    [row(0), row(1), row(2)]
}

fn block<T: Real>(maps: &FlowMaps<T>, count: usize) -> FlowBlock {
    let FlowMaps { camera, depth, camera_to, depth_to, .. } = maps;
    let single = |values: [f64; 2]| values.map(|value| value as f32);
    let size = |map: &Tensor<T>| [map.shape()[1] as u32, map.shape()[0] as u32];
    FlowBlock {
        rows: rows(camera),
        rows_to: rows(camera_to),
        focal: single(camera.focal),
        center: single(camera.center),
        focal_to: single(camera_to.focal),
        center_to: single(camera_to.center),
        size: size(depth),
        size_to: depth_to.as_ref().map_or([0; 2], size),
        count: count as u32,
        depth_tolerance: DEPTH_TOLERANCE as f32,
        padding: [0; 2],
    }
}

/// Target positions, unconstrained directions, and visibility.
pub(super) fn targets<T: Real>(gpu: Gpu, maps: &FlowMaps<T>, points: &Tensor<T>) -> Vec<Tensor<T>> {
    let count = points.rows();
    let [positions, free, seen] = [3, 3, 1].map(|columns| GpuArray::new(gpu, columns * count));
    let depth_to = maps.depth_to.as_ref().unwrap_or(&maps.depth);
    let views = [&maps.depth, &maps.flow, depth_to].map(|map| Binding::Read(map.on_gpu(gpu)));
    let written = [&positions, &free, &seen].map(Binding::Write);
    let arrays = [&[Binding::Read(points.on_gpu(gpu))][..], &views, &written].concat();
    let knows_arrival = ("KNOWS_ARRIVAL", u32::from(maps.depth_to.is_some()));
    TARGETS.launch(gpu, &[knows_arrival], &block(maps, count), &arrays, Groups::Over(count));
    let of_three = [positions, free].map(|array| Tensor::from_gpu([count, 3], array));
    of_three.into_iter().chain([Tensor::from_gpu([count, 1], seen)]).collect()
}
