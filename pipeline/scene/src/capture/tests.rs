use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::*;
use crate::cloud::PointCloud;
use crate::image_file::{GrayImage, RgbImage};
use crate::maps::{DepthMap, FlowMap, LabelMap, VelocityMap};
use crate::{Intrinsics, Result};

const SIZE: (u32, u32) = (6, 4);

fn info() -> CaptureInfo {
    let text = |value: &str| value.to_owned();
    CaptureInfo {
        name: text("tiny"),
        pose_source: text("analytic"),
        protocol: Protocol {
            dataset: text("synthetic"),
            split: text("generated"),
            width: SIZE.0,
            height: SIZE.1,
            resize: text("none"),
            background: text("white"),
            time: text("seconds"),
        },
        background: [1.0; 3],
        time_map: TimeMap { start_secs: 0.0, end_secs: 2.0, frame_secs: 0.5 },
        class_names: vec![text("ball")],
        bounds_world: Some([[-1.0, -2.0, -2.0], [1.0, 2.0, 2.0]]),
    }
}

/// A small view with all maps, whose camera is at distance 2 from the origin, at an angle given by its index.
fn frame(name: &str, split: Split, index: u32, time_secs: f64) -> Frame {
    let (width, height) = SIZE;
    let intrinsics = Intrinsics { width, height, focal_x: 6.0, focal_y: 6.0, center_x: 3.0, center_y: 2.0 };
    let angle = f64::from(index) * 0.7;
    let position = DVec3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 0.0);
    let pixels = 0..width * height;
    Frame {
        name: name.into(),
        split,
        camera: Camera::look_at(intrinsics, position, DVec3::ZERO, DVec3::Z),
        camera_index: index,
        frame_index: 0,
        time_secs,
        image: RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8 * 40, y as u8 * 60, index as u8])),
        alpha: Some(GrayImage::from_fn(width, height, |x, _| image::Luma([x as u8 * 50]))),
        depth: Some(DepthMap { width, height, depth_view: pixels.clone().map(|at| at as f32 * 0.1).collect() }),
        flow: Some(FlowMap { width, height, flow_px: pixels.clone().map(|at| [at as f32, f32::NAN]).collect() }),
        mask: Some(LabelMap { width, height, labels: pixels.clone().map(|at| (at % 2) as u8).collect() }),
        velocity: Some(VelocityMap {
            width,
            height,
            velocity_world: pixels.map(|at| [at as f32, 1.0, -2.0]).collect(),
        }),
    }
}

/// Translates a camera in the world.
fn moved(camera: &mut Camera, by_world: DVec3) {
    let pose = &mut camera.camera_from_world;
    pose.translation -= pose.rotation * by_world;
}

fn frames() -> Vec<Frame> {
    vec![
        frame("test_0", Split::Test, 3, 1.0),
        frame("train_1", Split::Train, 1, 2.0),
        frame("train_0", Split::Train, 0, 0.0),
        frame("val_0", Split::Val, 2, 0.5),
    ]
}

fn write(dir: &Path, frames: &[Frame]) -> Result<Capture> {
    let mut writer = CaptureWriter::create(dir, info())?;
    frames.iter().try_for_each(|frame| writer.write_view(frame))?;
    writer.write_points(&PointCloud { positions: vec![[0.0, 1.0, 2.0]], colors: vec![[9, 8, 7]] })?;
    writer.finish()
}

fn all_bytes(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![dir.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.insert(path.strip_prefix(dir).unwrap().into(), std::fs::read(&path).unwrap());
            }
        }
    }
    files
}

#[test]
fn a_written_capture_is_read_back() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &frames()).unwrap();
    let capture = Capture::open(dir.path()).unwrap();
    capture.check().unwrap();
    let names: Vec<_> = capture.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["train_0", "train_1", "val_0", "test_0"]);
    assert_eq!(capture.views_of(Split::Val).map(|(index, _)| index).collect::<Vec<_>>(), [2]);
    let (expected, view) = (frame("train_1", Split::Train, 1, 2.0), &capture.views[1]);
    assert_eq!((view.camera, view.time_secs), (expected.camera, 2.0), "poses keep every digit");
    assert_eq!(capture.load_image(view).unwrap(), expected.image);
    assert_eq!(capture.load_alpha(view).unwrap(), expected.alpha);
    assert_eq!(capture.load_depth(view).unwrap(), expected.depth);
    assert_eq!(capture.load_mask(view).unwrap(), expected.mask);
    assert_eq!(capture.load_velocity(view).unwrap(), expected.velocity);
    let flow = capture.load_flow(view).unwrap().unwrap();
    assert!(flow.flow_px.iter().enumerate().all(|(at, [x, y])| *x == at as f32 && y.is_nan()));
    assert_eq!(capture.load_points().unwrap().unwrap().colors, [[9, 8, 7]]);
}

#[test]
fn the_order_of_writing_changes_no_byte() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut frames = frames();
    write(a.path(), &frames).unwrap();
    frames.reverse();
    write(b.path(), &frames).unwrap();
    assert!(all_bytes(a.path()) == all_bytes(b.path()));
    frames[0].image.put_pixel(0, 0, image::Rgb([1, 2, 3]));
    write(b.path(), &frames).unwrap();
    assert!(all_bytes(a.path()) != all_bytes(b.path()), "the comparison is blind");
}

#[test]
fn absent_maps_have_no_files() {
    let dir = tempfile::tempdir().unwrap();
    let bare =
        Frame { alpha: None, depth: None, flow: None, mask: None, velocity: None, ..frame("a", Split::Train, 0, 0.0) };
    let writer = CaptureWriter::create(dir.path(), info()).unwrap();
    writer.write_view(&bare).unwrap();
    let capture = writer.finish().unwrap();
    let files: Vec<_> = all_bytes(dir.path()).into_keys().collect();
    assert_eq!(files, [PathBuf::from("capture.json"), PathBuf::from("images/a.png")]);
    assert!(capture.load_flow(&capture.views[0]).unwrap().is_none() && capture.load_points().unwrap().is_none());
}

#[test]
fn every_damage_is_reported_with_its_file() {
    type Damage = fn(&mut Capture);
    let cases: [(Damage, &str, &str); 17] = [
        (|capture| capture.views[1].name = "train_0".into(), "two views have the name train_0", "capture.json"),
        (|capture| capture.views[1].name = "../up".into(), "not safe as a file name", "capture.json"),
        (|capture| capture.views.swap(0, 1), "train_0 comes after train_1", "capture.json"),
        (|capture| capture.views.retain(|view| view.split != Split::Train), "none of the 2 views", "capture.json"),
        (|capture| capture.views[0].time_secs = f64::NAN, "view train_0: time NaN s", "capture.json"),
        (|capture| capture.views[1].time_secs = 2.1, "time 2.1 s is outside the range 0 to 2 s", "capture.json"),
        (|capture| capture.views[2].camera.intrinsics.focal_x = -1.0, "focal lengths", "capture.json"),
        (|capture| capture.views[2].camera.camera_from_world.rotation *= 1.1, "not orthonormal", "capture.json"),
        (|capture| capture.protocol.width = 7, "6×4 pixels, but the protocol has 7×4", "capture.json"),
        (|capture| capture.time_map.frame_secs = 0.0, "are not ordered and finite", "capture.json"),
        (|capture| capture.background[1] = f32::NAN, "not a colour", "capture.json"),
        (|capture| capture.bounds_world = Some([[1.0; 3], [0.0; 3]]), "bounds are not ordered", "capture.json"),
        (
            |capture| capture.views.iter_mut().for_each(|view| moved(&mut view.camera, DVec3::splat(1e7))),
            "subtract the offset",
            "capture.json",
        ),
        (|capture| capture.views[0].image = "images/none.png".into(), "cannot read the image", "none.png"),
        (|capture| capture.views[0].image = "../outside.png".into(), "leads outside", "outside.png"),
        (|capture| capture.views[0].mask = Some("depth/train_0.exr".into()), "not a readable PNG", "depth/train_0.exr"),
        (
            |capture| capture.views[0].velocity = Some("depth/train_0.exr".into()),
            "but X is required",
            "depth/train_0.exr",
        ),
    ];
    let dir = tempfile::tempdir().unwrap();
    let capture = write(dir.path(), &frames()).unwrap();
    for (damage, reason, file) in cases {
        let mut damaged = capture.clone();
        damage(&mut damaged);
        let Err(error) = damaged.check() else { panic!("accepted: {reason}") };
        let error = error.to_string();
        assert!(error.contains(reason) && error.ends_with(file), "{error}\ninstead of {reason} … {file}");
    }
}

#[test]
fn unnamed_labels_and_wrong_sizes_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let mut capture = write(dir.path(), &frames()).unwrap();
    capture.class_names.clear();
    let error = capture.load_mask(&capture.views[0]).unwrap_err().to_string();
    assert!(error.contains("label 1 in the mask of train_0, but only 0 class names"), "{error}");
    let wrong = Frame { image: RgbImage::new(5, 4), ..frame("a", Split::Train, 0, 0.0) };
    let error = write(dir.path(), &[wrong]).unwrap_err().to_string();
    assert!(error.contains("5×4 pixels, but the camera has 6×4") && error.ends_with("images/a.png"), "{error}");
}

#[test]
fn the_extent_follows_the_training_cameras() {
    let dir = tempfile::tempdir().unwrap();
    let capture = write(dir.path(), &frames()).unwrap();
    // Two training cameras at distance 2 from the origin, 0.7 rad apart: half their chord.
    let expected = 1.1 * 2.0 * (0.35_f64).sin();
    assert!((capture.scale().extent - expected).abs() <= 1e-12);
    let mut single = capture.clone();
    single.views.remove(1);
    assert_eq!(single.scale().extent, 3.0, "half the diagonal of the bounds");
    single.bounds_world = None;
    assert_eq!(single.scale().extent, 1.0);
}

#[test]
fn captures_of_an_arbitrary_unit_are_scaled_to_the_typical_distance() {
    let dir = tempfile::tempdir().unwrap();
    let mut capture = write(dir.path(), &frames()).unwrap();
    let mut unit_at = |distance: f64, dataset: &str| {
        capture.protocol.dataset = dataset.into();
        for view in &mut capture.views {
            let pose = &mut view.camera.camera_from_world;
            pose.translation *= distance / pose.translation.length();
        }
        capture.scale().unit
    };
    let near = |found: f64, expected: f64| assert!((found - expected).abs() <= 0.1 * expected, "{found}, {expected}");
    for (distance, own, published) in [(1.5, 0.375, 1.0), (4.0, 1.0, 1.0), (32.0, 8.0, 1.0), (60.0, 15.0, 15.0)] {
        near(unit_at(distance, "colmap"), own);
        near(unit_at(distance, "n3v"), published);
    }
}

#[test]
fn maps_of_another_capture_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let capture = write(dir.path(), &frames()).unwrap();
    let mut names: Vec<&str> = capture.views.iter().map(|view| view.name.as_str()).collect();
    capture.check_names(names.iter().copied()).unwrap();
    names.swap(0, 1);
    let error = capture.check_names(names.iter().copied()).unwrap_err().to_string();
    assert!(error.contains("maps of view train_1 instead of train_0"), "{error}");
    let error = capture.check_names(names[1..].iter().copied()).unwrap_err().to_string();
    assert!(error.contains("for a capture of") && error.contains("another capture"), "{error}");
}

#[test]
fn names_of_splits_are_those_in_files() {
    for split in Split::ALL {
        assert_eq!(serde_json::to_value(split).unwrap(), split.name());
    }
}
