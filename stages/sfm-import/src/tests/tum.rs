//! Sequences in the layout of TUM's RGB-D benchmark: cameras that look at the wall z = 4.

use std::path::Path;

use glam::{DMat4, DQuat, DVec3};
use image::{ImageBuffer, Luma, Rgb, RgbImage};
use scene::{Camera, Intrinsics, RigidTransform, Split, facts};
use tempfile::TempDir;

use super::estimators::{assert_points_on_the_wall, camera_between, known_share, params, wall};
use super::support::*;
use crate::lens::Distortion;
use crate::oddities::UNTESTED;
use crate::recognise::read;
use crate::{Format, Params};

/// Time of the first image, in seconds since 1970.
const START_SECS: f64 = 1_305_031_102.175;
/// Images per second.
const FPS: f64 = 30.0;
/// How much later a depth map is taken than its image.
const DEPTH_DELAY_SECS: f64 = 0.011;

/// The pinhole of the images.
fn intrinsics() -> Intrinsics {
    Intrinsics { width: 48, height: 32, focal_x: 60.0, focal_y: 58.0, center_x: 25.0, center_y: 15.5 }
}

/// Writes a depth map of the wall, in stored units.
pub(super) fn write_depth(path: &Path, camera: &Camera, per_metre: f64) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let values = wall(camera).iter().map(|depth| (f64::from(*depth) * per_metre).round() as u16).collect();
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    ImageBuffer::<Luma<u16>, Vec<u16>>::from_raw(width, height, values).unwrap().save(path).unwrap();
}

/// Writes an image of one grey level.
pub(super) fn write_grey(path: &Path, (width, height): (u32, u32), level: u8) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    RgbImage::from_pixel(width, height, Rgb([level; 3])).save(path).unwrap();
}

fn time_of(frame: usize) -> f64 {
    START_SECS + frame as f64 / FPS
}

/// The line of a pose.
fn pose_line(time_secs: f64, pose: &RigidTransform) -> String {
    let [x, y, z] = pose.translation.to_array();
    let [qx, qy, qz, qw] = DQuat::from_mat3(&pose.rotation).to_array();
    format!("{time_secs:.6} {x} {y} {z} {qx} {qy} {qz} {qw}\n")
}

/// The poses of the camera that moves from view to view, every hundredth of a second, if `is_kept` returns true for its time
/// in seconds after the first image.
fn poses(count: usize, is_kept: impl Fn(f64) -> bool) -> String {
    let times =
        (-2..=(count as i32 * 100 / 30)).map(|step| f64::from(step) / 100.0 + 0.003).filter(|time| is_kept(*time));
    let line =
        |time: f64| pose_line(START_SECS + time, &camera_between(time * FPS, intrinsics()).camera_from_world.inverse());
    format!("# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n{}", times.map(line).collect::<String>())
}

/// A sequence of this many images with their lens.
fn sequence(count: usize) -> TempDir {
    let dir = TempDir::new().unwrap();
    let (mut images, mut depths) =
        (String::from("# color images\n# timestamp filename\n"), String::from("# depth maps\n"));
    let k = intrinsics();
    for frame in 0..count {
        let (time, later) = (time_of(frame), time_of(frame) + DEPTH_DELAY_SECS);
        images += &format!("{time:.6} rgb/{time:.6}.png\n");
        depths += &format!("{later:.6} depth/{later:.6}.png\n");
        write_grey(&dir.path().join(format!("rgb/{time:.6}.png")), (k.width, k.height), (40 + 20 * frame) as u8);
        let camera = camera_between(frame as f64, k);
        write_depth(&dir.path().join(format!("depth/{later:.6}.png")), &camera, 5000.0);
    }
    let lens = format!("{} {} {} {}\n", k.focal_x, k.focal_y, k.center_x - 0.5, k.center_y - 0.5);
    let files = [
        ("rgb.txt", images),
        ("depth.txt", depths),
        ("calibration.txt", lens),
        ("groundtruth.txt", poses(count, |_| true)),
    ];
    files.iter().for_each(|(name, text)| std::fs::write(dir.path().join(name), text).unwrap());
    dir
}

#[test]
fn sequences_have_interpolated_poses_depth_and_points() {
    let dir = sequence(4);
    let (_root, capture) = run(dir.path(), &params()).unwrap();
    assert_eq!(
        (capture.views.len(), capture.pose_source.as_str(), capture.protocol.dataset.as_str()),
        (4, "tum", "tum")
    );
    for (frame, view) in capture.views.iter().enumerate() {
        let expected = camera_between(frame as f64, intrinsics());
        let (found, expected_pose) = (view.camera.camera_from_world, expected.camera_from_world);
        let turned = DQuat::from_mat3(&(found.rotation * expected_pose.rotation.transpose())).to_scaled_axis().length();
        let moved = (found.translation - expected_pose.translation).length();
        assert!(moved < 1e-4 && turned < 1e-5, "{frame}: {moved} {turned}");
        assert_eq!(view.camera.intrinsics, expected.intrinsics);
        assert!((view.time_secs - frame as f64 / FPS).abs() < 1e-6 && view.frame_index == frame as u32);
        assert_eq!(capture.load_image(view).unwrap().get_pixel(3, 3).0[0], 40 + 20 * frame as u8);
    }
    assert!((capture.time_map.frame_secs - 1.0 / FPS).abs() < 1e-6, "{:?}", capture.time_map);
    assert_eq!(known_share(&capture), 1.0);
    assert_points_on_the_wall(&capture);
    let text = crate::inspect::inspect(dir.path()).unwrap().text();
    for part in ["RGB-D sequence of TUM", "4 maps", "1, moving", "ready to import"] {
        assert!(text.contains(part), "{part:?} is not in\n{text}");
    }
    assert!(!text.contains("ignored"), "{text}");
    let known = crate::facts::of_capture(dir.path(), &params());
    assert_eq!(
        (known.count(facts::TIMES), known.flag(facts::DEPTH), known.flag(facts::POINTS)),
        (Some(4), Some(true), Some(true))
    );
}

#[test]
fn images_in_gaps_of_the_trajectory_are_skipped() {
    let dir = sequence(12);
    // Poses from 0.1 s to 0.26 s are lost. The images at 0.1 s and 0.267 s have a pose within 0.02 s.
    std::fs::write(dir.path().join("groundtruth.txt"), poses(12, |time| !(0.1..0.26).contains(&time))).unwrap();
    let capture = read(dir.path(), &Params { every_nth: 4, ..Params::default() }).unwrap();
    let found: Vec<u32> = capture.frames.iter().map(|frame| frame.frame_index).collect();
    assert_eq!(found, [0, 1, 2, 3, 8, 9, 10, 11], "the gap remains a gap in time");
    assert_eq!(capture.count(Split::Test), 2);
    assert!((capture.frames[4].time_secs - 8.0 / FPS).abs() < 1e-6);
    let expected = "4 of 12 images are skipped: groundtruth.txt has no pose at their time (e.g. 1305031102.308333.png)";
    assert_eq!(capture.warnings, [expected]);
    assert!(capture.problems().is_empty(), "{:?}", capture.problems());
}

#[test]
fn sequences_without_all_depth_maps_have_points_of_the_others() {
    let dir = sequence(4);
    let path = dir.path().join("depth.txt");
    let depths = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, depths.lines().take(3).collect::<Vec<_>>().join("\n")).unwrap();
    let capture = read(dir.path(), &params()).unwrap();
    assert_eq!(
        capture.frames.iter().map(|frame| frame.depth.is_some()).collect::<Vec<_>>(),
        [true, true, false, false]
    );
    assert_eq!(capture.warnings, ["2 of 4 images have no depth: depth.txt has no map within 0.02 s", UNTESTED]);
    std::fs::remove_file(&path).unwrap();
    let capture = read(dir.path(), &params()).unwrap();
    assert!(capture.cloud.is_none() && capture.points.is_empty());
    assert!(capture.warnings[0].starts_with("depth.txt is missing"), "{:?}", capture.warnings);
}

/// A sequence of one blank image without calibration, in a folder of this name.
fn published(root: &Path, name: &str) -> std::path::PathBuf {
    let dir = root.join(name);
    write_grey(&dir.join("rgb/1.png"), (640, 480), 90);
    std::fs::write(dir.join("rgb.txt"), "1.0 rgb/1.png\n").unwrap();
    let pose = RigidTransform { rotation: glam::DMat3::from_rotation_y(0.4), translation: DVec3::new(0.2, -1.5, 1.9) };
    std::fs::write(dir.join("groundtruth.txt"), pose_line(1.01, &pose)).unwrap();
    dir
}

#[test]
fn lenses_of_published_sequences_follow_from_their_names() {
    let root = TempDir::new().unwrap();
    let cases = [
        ("rgbd_dataset_freiburg1_desk", "tum-rgbd", [517.3, 319.1, 255.8], Some((0.2624, 1.1633, 0.0026))),
        ("rgbd_dataset_freiburg2_xyz", "tum-rgbd", [520.9, 325.6, 250.2], Some((0.2312, 0.9172, -0.0001))),
        ("rgbd_dataset_freiburg3_walking_xyz", "tum-rgbd", [535.4, 320.6, 248.1], None),
        ("rgbd_bonn_balloon", "bonn-rgbd", [542.822841, 316.09352, 238.256098], Some((0.039903, 0.0, -0.000144))),
    ];
    for (name, dataset, [focal, x, y], bend) in cases {
        let capture = read(&published(root.path(), name), &params()).unwrap();
        let lens = capture.frames[0].lens;
        let k = lens.intrinsics;
        let error = (k.focal_x - focal).abs() + (k.center_x - x).abs() + (k.center_y - y).abs();
        assert!(error < 1e-9 && (k.width, k.height) == (640, 480), "{name}: {k:?}");
        assert_eq!(capture.dataset, dataset);
        assert_eq!(lens.distortion != Distortion::default(), bend.is_some(), "{name}");
        if let Some((k1, k3, p2)) = bend {
            let text = lens.distortion.to_string();
            assert!(text.contains(&format!("[{k1:?}, ")) && text.contains(&format!(", {k3:?}, 0.0]")), "{text}");
            assert!(text.contains(&format!(", {p2:?}]")), "{text}");
        }
        assert!(capture.problems().is_empty(), "{name}: {:?}", capture.problems());
    }
}

/// The published formula maps points of the depth maps to the laser scan: T_ros · T · T_ros · T_m, where T_m has a scale.
#[test]
fn poses_of_bonn_are_those_of_markers() {
    let root = TempDir::new().unwrap();
    let dir = published(root.path(), "rgbd_bonn_balloon");
    std::fs::write(dir.join("depth.txt"), "1.0 depth/1.png\n").unwrap();
    write_depth(
        &dir.join("depth/1.png"),
        &camera_between(0.0, Intrinsics { width: 640, height: 480, ..intrinsics() }),
        5000.0,
    );
    let frame = &read(&dir, &params()).unwrap().frames[0];
    let ros = DMat4::from_cols_array_2d(&[
        [-1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]);
    let markers = DMat4::from_cols_array_2d(&[
        [1.0157, 0.1828, -0.2389, 0.0113],
        [0.0009, -0.8431, -0.6413, -0.0098],
        [-0.3009, 0.6147, -0.8085, 0.0111],
        [0.0, 0.0, 0.0, 1.0],
    ])
    .transpose();
    let stated = DMat4::from_rotation_translation(DQuat::from_rotation_y(0.4), DVec3::new(0.2, -1.5, 1.9));
    let scale = 5000.0 * frame.depth.as_ref().unwrap().units_per_value;
    assert!((scale - 1.0593).abs() < 2e-4, "{scale}");
    for point in [DVec3::new(0.0, 0.0, 1.0), DVec3::new(-0.8, 0.5, 3.0)] {
        let expected = (ros * stated * ros * markers).transform_point3(point);
        let found = frame.camera_from_world.inverse().apply(scale * point);
        assert!(found.distance(expected) < 1e-3, "{found} {expected}");
    }
}

#[test]
fn faulty_sequences_are_refused_with_file_and_line() {
    let mut refusals = Refusals::default();
    let mut add = |damage: &dyn Fn(&Path)| {
        let dir = sequence(2);
        damage(dir.path());
        refusals.add(dir.path(), &params());
    };
    let pose = "1305031102.18 0 0 0 0 0 0 1\n";
    let texts: [(&str, &str); 11] = [
        ("groundtruth.txt", ""),
        ("groundtruth.txt", "1.0 0 0 0 0 0 0 1\n1.01 0 0 0 0 0 0 1\n"),
        ("groundtruth.txt", &format!("# poses\n{pose}1305031102.19 nan 0 0 0 0 0 1\n")),
        ("groundtruth.txt", &format!("{pose}1305031102.19 0 0 0 0 0 0 2\n")),
        ("groundtruth.txt", &format!("{pose}1305031102.19 0 0 0 0 0 1\n")),
        ("rgb.txt", "# nothing\n"),
        ("rgb.txt", "1305031102.18\n"),
        ("rgb.txt", "1305031102.18 ../1.png\n"),
        ("rgb.txt", "1305031102.18 rgb/missing.png\n"),
        ("calibration.txt", "# fx fy cx cy\n60 58 24 15 0.1\n"),
        ("calibration.txt", "525 525 319.5 239.5\n"),
    ];
    for (name, text) in texts {
        add(&|dir| std::fs::write(dir.join(name), text).unwrap());
    }
    add(&|dir| std::fs::remove_file(dir.join("groundtruth.txt")).unwrap());
    add(&|dir| std::fs::remove_file(dir.join("calibration.txt")).unwrap());
    let second = format!("{:.6}.png", time_of(1));
    add(&|dir| write_grey(&dir.join("rgb").join(&second), (24, 16), 0));
    let depth = format!("depth/{:.6}.png", time_of(1) + DEPTH_DELAY_SECS);
    add(&|dir| std::fs::remove_file(dir.join(&depth)).unwrap());
    let square = Intrinsics { height: 48, ..intrinsics() };
    add(&|dir| write_depth(&dir.join(&depth), &camera_between(1.0, square), 5000.0));
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn mangled_sequences_never_panic() {
    let dir = sequence(3);
    for file in ["rgb.txt", "depth.txt", "groundtruth.txt", "calibration.txt"] {
        let refused = support::mangle::refused(&dir.path().join(file), 200, |_| {
            let capture = read(dir.path(), &params())?;
            capture.problems().into_iter().next().map_or(Ok(()), Err)
        });
        assert!(refused > 40, "only {refused} of 200 damaged versions of {file} were refused: is it read at all?");
    }
}

/// Images, depth in millimetres and poses of Open3D's test data, laid out as a sequence: the surface that each depth map shows
/// is the one that the next map shows.
#[test]
fn real_depth_maps_agree_in_the_world() {
    let Some(data) = support::data("rgbd_open3d/examples/TestData") else { return };
    let dir = TempDir::new().unwrap();
    let trajectory = std::fs::read_to_string(data.join("RGBD/trajectory.log")).unwrap();
    let numbers: Vec<f64> = trajectory.split_whitespace().map(|word| word.parse().unwrap()).collect();
    let (mut images, mut depths, mut poses) = (String::new(), String::new(), String::new());
    for (at, entry) in numbers.chunks_exact(19).enumerate() {
        let time = at as f64 / FPS;
        std::fs::copy(data.join(format!("RGBD/color/{at:05}.jpg")), dir.path().join(format!("{at}.jpg"))).unwrap();
        std::fs::copy(data.join(format!("RGBD/depth/{at:05}.png")), dir.path().join(format!("{at}.png"))).unwrap();
        images += &format!("{time} {at}.jpg\n");
        depths += &format!("{time} {at}.png\n");
        poses += &pose_line(time, &crate::matrices::transform(&entry[3..15]));
    }
    for (name, text) in [
        ("rgb.txt", &*images),
        ("depth.txt", &*depths),
        ("groundtruth.txt", &*poses),
        ("calibration.txt", "525 525 319.5 239.5\n"),
    ] {
        std::fs::write(dir.path().join(name), text).unwrap();
    }
    let params = Params { depth_unit: Some(0.001), width: Some(160), ..params() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    assert_eq!((capture.views.len(), read(dir.path(), &params).unwrap().format), (5, Format::Tum));
    for pair in capture.views.windows(2) {
        let (here, there) =
            (capture.load_depth(&pair[0]).unwrap().unwrap(), capture.load_depth(&pair[1]).unwrap().unwrap());
        let (near, far) = (&pair[0].camera, &pair[1].camera);
        let mut errors: Vec<f64> = Vec::new();
        for (depth, center) in here.depth_view.iter().zip(scene::pixels::centers(here.width, here.height)) {
            let world = near.camera_from_world.inverse().apply(near.ray_view(center) * f64::from(*depth));
            let Some((pixel, expected)) = far.project(world).filter(|_| *depth > 0.0) else { continue };
            if pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < f64::from(there.width) && pixel.y < f64::from(there.height)
            {
                let found = f64::from(there.depth_view[pixel.y as usize * there.width as usize + pixel.x as usize]);
                errors.extend((found > 0.0).then(|| (found / expected - 1.0).abs()));
            }
        }
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        assert!(errors.len() > 5000 && median < 0.01, "{median} of {}", errors.len());
    }
}
