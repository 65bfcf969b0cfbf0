//! Files of benchmarks, where `PIPELINE_DATA` names a folder that holds them.

use std::path::Path;

use glam::{DMat3, DVec3};
use scene::{Camera, Intrinsics, RigidTransform};

use crate::depth::depth_view;
use crate::flow::{believed, flow_map, known_share, rigid};
use crate::formats::{Content, read};
use crate::params::{DepthParams, FlowParams};
use needs::data;

#[test]
fn ground_truth_flow_of_middlebury_and_kitti() {
    let Some(dir) = data("flow_gt_kitti_middlebury/data/example") else { return };
    let rubber_whale = read(&dir.join("Middlebury/flow_gt.flo"), Content::Flow).unwrap();
    assert_eq!((rubber_whale.width, rubber_whale.height), (584, 388));
    let lengths = |values: &[f32]| -> Vec<f32> {
        values.chunks_exact(2).map(|flow| flow[0].hypot(flow[1])).filter(|length| length.is_finite()).collect()
    };
    let known = lengths(&rubber_whale.values);
    let largest = known.iter().copied().fold(0.0, f32::max);
    eprintln!("Middlebury: {} of {} pixels known, at most {largest} px", known.len(), 584 * 388);
    assert!(known.len() as f32 >= 0.95 * 584.0 * 388.0 && (2.0..8.0).contains(&largest));

    let kitti = read(&dir.join("KITTI/flow_gt.png"), Content::Flow).unwrap();
    assert_eq!((kitti.width, kitti.height), (1242, 375));
    let known = lengths(&kitti.values);
    let largest = known.iter().copied().fold(0.0, f32::max);
    eprintln!("KITTI: {} of {} pixels known, at most {largest} px", known.len(), 1242 * 375);
    // Laser points cover a part of the image, and the car drives.
    assert!((0.1..0.9).contains(&(known.len() as f32 / (1242.0 * 375.0))) && (5.0..300.0).contains(&largest));
}

#[test]
fn forward_and_backward_flow_of_flying_chairs_agree_where_nothing_is_hidden() {
    let Some(dir) = data("mmflow_tests/tests/data") else { return };
    let map = |name: &str| flow_map(&read(&dir.join(name), Content::Flow).unwrap(), [1.0; 2]);
    let (forward, backward) = (map("0000000-flow_01.flo"), map("0000000-flow_10.flo"));
    let believed_share = |backward| known_share(&believed(&forward, Some(backward), &FlowParams::default()));
    let unrelated = map("00001_flow.flo");
    let (right, wrong) = (believed_share(&backward), believed_share(&unrelated));
    eprintln!("{}×{}: {right:.3} returns, {wrong:.3} by another pair's flow", forward.width, forward.height);
    assert!(right > 2.0 * wrong && right > 0.3, "{right} {wrong}");
    let weights = read(&dir.join("0000000-occ_weights_01.pfm"), Content::Depth).unwrap();
    assert_eq!((weights.width, weights.height), (forward.width, forward.height));
    assert!(weights.values.iter().all(|value| value.is_finite()));
}

/// Camera-to-world poses of a `.log` file.
fn trajectory(path: &Path) -> Vec<RigidTransform> {
    let text = std::fs::read_to_string(path).unwrap();
    let numbers: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
    let pose = |pose: &[f64]| {
        let row = |at: usize| DVec3::new(pose[3 + 4 * at], pose[4 + 4 * at], pose[5 + 4 * at]);
        let rotation = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        RigidTransform { rotation, translation: DVec3::new(pose[6], pose[10], pose[14]) }
    };
    numbers.chunks_exact(19).map(pose).collect()
}

#[test]
fn depth_of_a_sensor_reprojects_into_the_next_frame() {
    let Some(dir) = data("rgbd_open3d/examples/TestData/RGBD") else { return };
    let intrinsics =
        Intrinsics { width: 640, height: 480, focal_x: 525.0, focal_y: 525.0, center_x: 320.0, center_y: 240.0 };
    let millimetres = DepthParams { units_per_value: Some(0.001), ..DepthParams::default() };
    let cameras: Vec<Camera> = trajectory(&dir.join("trajectory.log"))
        .iter()
        .map(|world_from_camera| Camera { intrinsics, camera_from_world: world_from_camera.inverse() })
        .collect();
    let depth = |at: usize| {
        let path = dir.join(format!("depth/{at:05}.png"));
        depth_view(&read(&path, Content::Depth).unwrap(), &cameras[at], &millimetres, None, &path).unwrap().0
    };
    let (first, next) = (depth(0), depth(4));
    // Medians of the relative difference between the depth that arrives and the depth that is there, with the right and
    // with exchanged poses.
    let error = |from: &Camera, to: &Camera| {
        let flow = rigid(&first, from, to);
        let mut errors = Vec::new();
        for ((center, flow), z) in crate::raster::pixel_centers(640, 480).zip(&flow.flow_px).zip(&first.depth_view) {
            let arrival = center + glam::DVec2::new(flow[0].into(), flow[1].into());
            if !(arrival.x >= 0.0 && arrival.y >= 0.0 && arrival.x < 640.0 && arrival.y < 480.0) {
                continue;
            }
            let there = next.depth_view[arrival.y as usize * 640 + arrival.x as usize];
            let point = from.camera_from_world.inverse().apply(from.ray_view(center) * f64::from(*z));
            let arrives = to.project(point).unwrap().1;
            if there > 0.0 {
                errors.push((f64::from(there) / arrives - 1.0).abs());
            }
        }
        crate::alignment::median(errors.into_iter()).unwrap()
    };
    let (right, wrong) = (error(&cameras[0], &cameras[4]), error(&cameras[4], &cameras[0]));
    eprintln!("median depth error after reprojection {right:.4}, with exchanged poses {wrong:.4}");
    assert!(right <= 0.02 && right < 0.5 * wrong, "{right} {wrong}");
}
