//! Imports of benchmark files, if the folder named by `PIPELINE_DATA` has them.

use std::path::Path;

use glam::{DMat3, DVec3};
use scene::maps::formats::{Content, read};
use scene::statistics::median;
use scene::{Camera, FlowMap, Intrinsics, RigidTransform, pixels};

use crate::depth::depth_view;
use crate::flow::{consistent, flow_map, known_share};
use crate::params::{DepthParams, FlowParams};
use support::data;

#[test]
fn middlebury_and_kitti_flow_is_decoded() {
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
    // Laser points cover only a part of the image, and the car moves.
    assert!((0.1..0.9).contains(&(known.len() as f32 / (1242.0 * 375.0))) && (5.0..300.0).contains(&largest));
}

#[test]
fn flow_of_flying_chairs_is_consistent_where_visible() {
    let Some(dir) = data("mmflow_tests/tests/data") else { return };
    let map = |name: &str| flow_map(&read(&dir.join(name), Content::Flow).unwrap(), [1.0; 2]);
    let (forward, backward) = (map("0000000-flow_01.flo"), map("0000000-flow_10.flo"));
    let consistent_share = |backward| known_share(&consistent(&forward, Some(backward), &FlowParams::default()));
    let unrelated = map("00001_flow.flo");
    let (right, wrong) = (consistent_share(&backward), consistent_share(&unrelated));
    eprintln!("{}×{}: {right:.3} consistent, {wrong:.3} with the flow of another pair", forward.width, forward.height);
    assert!(right > 2.0 * wrong && right > 0.3, "{right} {wrong}");
    let weights = read(&dir.join("0000000-occ_weights_01.pfm"), Content::Depth).unwrap();
    assert_eq!((weights.width, weights.height), (forward.width, forward.height));
    assert!(weights.values.iter().all(|value| value.is_finite()));
}

/// Camera-to-world poses of an Open3D `.log` file.
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
fn sensor_depth_reprojects_into_a_later_frame() {
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
    // Median relative difference between the reprojected depth and the measured one, for the right and for swapped
    // poses.
    let error = |from: &Camera, to: &Camera| {
        let flow = FlowMap::rigid(&first, from, to);
        let mut errors = Vec::new();
        for ((center, flow), z) in pixels::centers(640, 480).zip(&flow.flow_px).zip(&first.depth_view) {
            let arrival = center + glam::DVec2::new(flow[0].into(), flow[1].into());
            if !(arrival.x >= 0.0 && arrival.y >= 0.0 && arrival.x < 640.0 && arrival.y < 480.0) {
                continue;
            }
            let measured = next.depth_view[arrival.y as usize * 640 + arrival.x as usize];
            let point = from.camera_from_world.inverse().apply(from.ray_view(center) * f64::from(*z));
            let reprojected = to.project(point).unwrap().1;
            if measured > 0.0 {
                errors.push((f64::from(measured) / reprojected - 1.0).abs());
            }
        }
        median(errors.into_iter()).unwrap()
    };
    let (right, wrong) = (error(&cameras[0], &cameras[4]), error(&cameras[4], &cameras[0]));
    eprintln!("median depth error after reprojection {right:.4}, with swapped poses {wrong:.4}");
    assert!(right <= 0.02 && right < 0.5 * wrong, "{right} {wrong}");
}

/// Files that estimators wrote, compared with the stated values.
#[test]
fn real_outputs_of_estimators_are_decoded() {
    let Some(dir) = data("formats/outputs") else { return };
    let files = [
        ("depth/midas/moon.npy", Content::Depth, [640, 640], [-0.517, 1.388]),
        ("depth/midas/moon.png", Content::Depth, [640, 640], [0.0, 65535.0]),
        ("depth/depth_other/joshuaatanu_depth.npy", Content::Depth, [384, 384], [41.0, 1022.0]),
        ("depth/video_depth_anything/vda_relative_480x640.npy", Content::Depth, [640, 480], [0.229, 9.549]),
        ("flow/merl_flow.npy", Content::Flow, [480, 270], [-2.21, 11.08]),
    ];
    for (name, content, size, range) in files {
        let image = read(&dir.join(name), content).unwrap();
        let low = image.values.iter().copied().fold(f32::MAX, f32::min);
        let high = image.values.iter().copied().fold(f32::MIN, f32::max);
        eprintln!("{name}: {}×{}, {low} to {high}", image.width, image.height);
        assert_eq!([image.width, image.height], size, "{name}");
        let tolerance = 0.005 * f32::max(range[1], 1.0);
        assert!((low - range[0]).abs() <= tolerance && (high - range[1]).abs() <= tolerance, "{name}: {low} {high}");
    }
    let flow = read(&dir.join("flow/liteflownet_600x400.flo"), Content::Flow).unwrap();
    assert!((flow.width, flow.height) == (600, 400) && flow.values.iter().all(|value| value.is_finite()));
    let kitti = read(&dir.join("flow/kitti_flow_gt.png"), Content::Flow).unwrap();
    let valid = kitti.values.chunks_exact(2).filter(|flow| flow[0].is_finite()).count();
    assert!((0.1..0.25).contains(&(valid as f64 / (375.0 * 1242.0))), "{valid} pixels");
}
