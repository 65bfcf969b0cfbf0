//! Blender and D-NeRF captures: cameras, times, splits, pixels, and errors.

use scene::protocol::Preset;
use scene::{Protocol, Split, TimeMap};
use serde_json::json;

use super::support::*;
use crate::recognise::read;
use crate::{Background, Params, Resize, TestSplit};

#[test]
fn cameras_times_and_splits_come_from_the_files() {
    let dir = blender_scene();
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let counts = [Split::Train, Split::Val, Split::Test].map(|split| capture.views_of(split).count());
    assert_eq!(counts, [5, 2, 3]);
    assert_eq!(capture.time_map, TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 0.25 });
    let expected =
        "dnerf · official split · 24×16 · resize none · white background · time (file time - min) / (max - min)";
    assert!(capture.protocol.line().ends_with(expected), "{}", capture.protocol.line());
    for (index, (_, view)) in capture.views_of(Split::Train).enumerate() {
        let focal = 12.0 / 0.35_f64.tan();
        assert!((view.camera.intrinsics.focal_x - focal).abs() <= 1e-12 * focal);
        let position = glam::DVec3::from_array([0, 1, 2].map(|axis| blender_matrix(index)[axis][3]));
        assert!(view.camera.position_world().distance(position) <= 1e-12);
        // The generated cameras look at the origin, which must project to the principal point.
        let (pixel, depth) = view.camera.project(glam::DVec3::ZERO).unwrap();
        assert!(pixel.distance(glam::DVec2::new(12.0, 8.0)) <= 1e-9, "{pixel}");
        assert!((depth - position.length()).abs() <= 1e-9);
        // World z is up, so a point above the origin must be higher in the image.
        assert!(view.camera.project(glam::DVec3::Z).unwrap().0.y < pixel.y);
        assert_eq!(view.time_secs, index as f64 / 4.0);
    }
}

#[test]
fn captures_with_another_protocol_are_refused() {
    let dir = blender_scene();
    let named = |protocol: &str| Params { source: "lego".into(), protocol: protocol.into(), ..Params::default() };
    insta::assert_snapshot!(refusal(dir.path(), &named("dnerf-800-black")));
    let problems = named("dnerf-801").problems();
    assert!(problems.len() == 1 && problems[0].key == "protocol", "{problems:?}");
    assert!(problems[0].hint.as_ref().unwrap().contains("dnerf-800-white"));
    // Only the size of the generated scene differs from the preset.
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let preset = Preset::named("dnerf-800-white").unwrap().protocol();
    assert_eq!(Protocol { width: 800, height: 800, ..capture.protocol }, preset);
    let tested_on_val = Params { test_split: TestSplit::Val, ..Params::default() };
    let (_root, capture) = run(dir.path(), &tested_on_val).unwrap();
    let preset = Preset::named("dnerf-800-white-val").unwrap().protocol();
    assert_eq!(Protocol { width: 800, height: 800, ..capture.protocol }, preset);
}

#[test]
fn alpha_is_composited_once_and_kept() {
    let dir = blender_scene();
    for (background, edge) in [(Background::White, [155, 233, 155]), (Background::Black, [0, 78, 0])] {
        let (_root, capture) = run(dir.path(), &Params { background, ..Params::default() }).unwrap();
        let view = &capture.views[4];
        let image = capture.load_image(view).unwrap();
        let empty = if background == Background::White { 255 } else { 0 };
        // 0.392… · 200 + 0.607… · 255 = 233.3 on white, 78.4 on black.
        assert_eq!([image[(0, 0)].0, image[(10, 3)].0, image[(20, 3)].0], [[empty; 3], edge, [0, 4, 255]]);
        let alpha = capture.load_alpha(view).unwrap().unwrap();
        assert_eq!([alpha[(0, 0)].0, alpha[(10, 3)].0, alpha[(20, 3)].0], [[0], [100], [255]]);
    }
}

#[test]
fn a_capture_that_shows_nothing_is_refused() {
    let dir = blender_scene();
    let clear = image::RgbaImage::from_pixel(24, 16, image::Rgba([9, 9, 9, 0]));
    let paths: Vec<_> = frames(dir.path(), &Params::default()).into_iter().map(|frame| frame.image).collect();
    paths.iter().for_each(|path| clear.save(path).unwrap());
    assert!(refusal(dir.path(), &Params::default()).contains("all 10 images are fully transparent"));
    let mut seen = clear;
    seen.put_pixel(3, 3, image::Rgba([9, 9, 9, 1]));
    seen.save(&paths[4]).unwrap();
    run(dir.path(), &Params::default()).unwrap();
}

#[test]
fn resizing_follows_compositing_and_scales_the_camera() {
    let dir = blender_scene();
    let params = Params { width: Some(12), resize: Some(Resize::Area), ..Params::default() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    let view = &capture.views[0];
    let native = frames(dir.path(), &params)[0].camera().unwrap();
    assert_eq!(view.camera, native.resized(12, 8));
    assert_eq!(capture.load_image(view).unwrap()[(5, 1)].0, [155, 233, 155]);
    assert!(capture.protocol.line().contains("12×8 · resize area"));
    insta::assert_snapshot!(refusal(dir.path(), &Params { width: Some(25), ..Params::default() }));
}

#[test]
fn lego_can_be_tested_on_its_validation_split() {
    let dir = blender_scene();
    let params = Params { test_split: TestSplit::Val, ..Params::default() };
    std::fs::remove_file(transforms_path(dir.path(), "test")).unwrap(); // must not be read
    let (_root, capture) = run(dir.path(), &params).unwrap();
    assert_eq!(capture.protocol.split, "official, tested on val");
    let names: Vec<&str> = capture.views_of(Split::Test).map(|(_, view)| view.name.as_str()).collect();
    assert_eq!(names, ["val_000", "val_001"]);
    assert_eq!(capture.views_of(Split::Val).count(), 0);
    let (_root, capture) = run(dir.path(), &Params { val_count: Some(1), ..params }).unwrap();
    assert_eq!(capture.views_of(Split::Val).next().unwrap().1.name, "train_002");
    assert_eq!(capture.views_of(Split::Train).count(), 4);
}

#[test]
fn validation_views_leave_training_views() {
    let dir = blender_scene();
    for count in [5, 100] {
        let params = Params { test_split: TestSplit::Val, val_count: Some(count), ..Params::default() };
        assert_refused(dir.path(), &params, &["the train split", "if val_count holds out", "set it below 5"]);
    }
}

#[test]
fn skipped_training_views_are_part_of_the_protocol() {
    let dir = blender_scene();
    let params = Params { frame_step: 2, train_limit: Some(2), val_count: Some(1), ..Params::default() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    let names: Vec<&str> = capture.views_of(Split::Train).map(|(_, view)| view.name.as_str()).collect();
    assert_eq!(names, ["train_000", "train_004"]);
    assert_eq!(capture.protocol.split, "official, 1 of 2 training views, at most 2 training views");
    assert_eq!((capture.views_of(Split::Val).count(), capture.views_of(Split::Test).count()), (1, 3));
    assert_eq!(capture.time_map.frame_secs, 0.25, "the time map covers the whole capture");
}

#[test]
fn frames_without_times_are_a_static_scene() {
    let dir = blender_scene();
    for label in ["train", "val", "test"] {
        edit_transforms(dir.path(), label, |json| {
            json["frames"]
                .as_array_mut()
                .unwrap()
                .iter_mut()
                .for_each(|f| drop(f.as_object_mut().unwrap().remove("time")));
        });
    }
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert!(capture.views.iter().all(|view| view.time_secs == 0.0 && view.frame_index == 0));
    assert_eq!((capture.time_map.start_secs, capture.time_map.end_secs), (0.0, 0.0));
    assert_eq!(capture.protocol.dataset, "blender");
    let source = read(dir.path(), &Params::default()).unwrap();
    let expected = "no frame has a time: imported as a static scene; if it moves, add time (in seconds) to each frame";
    assert_eq!(source.warnings, [expected]);
    edit_transforms(dir.path(), "val", |json| json["frames"][0]["time"] = json!(0.0));
    insta::assert_snapshot!(refusal(dir.path(), &Params::default()));
}

#[test]
fn the_number_of_threads_changes_no_byte() {
    let dir = blender_scene();
    let params = Params { width: Some(10), ..Params::default() };
    let bytes = |threads: usize| {
        let root = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| crate::import(dir.path(), &params, root.path())).unwrap();
        ["capture.json", "images/train_003.png", "alpha/test_001.png"]
            .map(|f| std::fs::read(root.path().join(f)).unwrap())
    };
    assert_eq!(bytes(1), bytes(3));
}

#[test]
fn missing_files_are_named() {
    let mut refusals = Refusals::default();
    let dir = blender_scene();
    std::fs::remove_file(dir.path().join("train/r_003.png")).unwrap();
    refusals.add(dir.path(), &Params::default());
    std::fs::remove_file(dir.path().join("test/r_001.png")).unwrap();
    refusals.add(dir.path(), &Params::default());
    let dir = blender_scene();
    std::fs::remove_file(transforms_path(dir.path(), "val")).unwrap();
    refusals.add(dir.path(), &Params { test_split: TestSplit::Val, ..Params::default() });
    refusals.add(&dir.path().join("nowhere"), &Params::default());
    refusals.add(&dir.path().join("transforms_train.json"), &Params::default());
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn images_of_different_size_are_refused() {
    let mut refusals = Refusals::default();
    let dir = blender_scene();
    image::RgbaImage::new(23, 16).save(dir.path().join("train/r_002.png")).unwrap();
    refusals.add(dir.path(), &Params::default());
    let dir = blender_scene();
    for index in 0..3 {
        image::RgbaImage::new(12, 8).save(dir.path().join(format!("test/r_00{index}.png"))).unwrap();
    }
    refusals.add(dir.path(), &Params::default());
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn wrong_poses_are_refused() {
    let mut refusals = Refusals::default();
    let mut add = |edit: &dyn Fn(&mut serde_json::Value)| {
        let dir = blender_scene();
        edit_transforms(dir.path(), "val", |json| edit(&mut json["frames"][0]["transform_matrix"]));
        refusals.add(dir.path(), &Params::default());
    };
    add(&|m| m[0][0] = json!(2.0));
    add(&|m| (0..3).for_each(|row| m[row][0] = json!(-m[row][0].as_f64().unwrap())));
    add(&|m| m[3] = json!([0.0, 0.0, 0.0, 2.0]));
    add(&|m| *m = json!([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1]]));
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn non_finite_and_impossible_numbers_are_refused() {
    let mut refusals = Refusals::default();
    let dir = blender_scene();
    let path = transforms_path(dir.path(), "train");
    let text = std::fs::read_to_string(&path).unwrap().replacen("0.7", "NaN", 1);
    assert!(text.contains("NaN"));
    std::fs::write(&path, text).unwrap();
    refusals.add(dir.path(), &Params::default());
    for angle in [0.0, -1.0, 3.2] {
        let dir = blender_scene();
        edit_transforms(dir.path(), "test", |json| json["camera_angle_x"] = json!(angle));
        refusals.add(dir.path(), &Params::default());
    }
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn frames_are_sorted_by_time() {
    let dir = blender_scene();
    let in_order = frames(dir.path(), &Params::default());
    edit_transforms(dir.path(), "train", |json| json["frames"].as_array_mut().unwrap().reverse());
    let reversed = frames(dir.path(), &Params::default());
    for (expected, frame) in in_order.iter().zip(&reversed) {
        assert_eq!((&frame.image, frame.time_secs), (&expected.image, expected.time_secs));
        assert_eq!((frame.frame_index, frame.camera_from_world), (expected.frame_index, expected.camera_from_world));
    }
    assert_eq!(reversed[0].name, "train_004", "named by its index in the file");
    assert!(run(dir.path(), &Params::default()).is_ok());
}

#[test]
fn empty_splits_and_paths_outside_are_refused() {
    let mut refusals = Refusals::default();
    let dir = blender_scene();
    edit_transforms(dir.path(), "test", |json| json["frames"] = json!([]));
    refusals.add(dir.path(), &Params::default());
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| json["frames"][0]["file_path"] = json!("../train/r_009"));
    refusals.add(dir.path(), &Params::default());
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn damaged_images_are_refused() {
    let dir = blender_scene();
    let path = dir.path().join("val/r_000.png");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert_refused(dir.path(), &Params::default(), &["image cannot be read", "val/r_000.png"]);
}

#[test]
fn stop_requests_interrupt_the_import() {
    let dir = blender_scene();
    let root = tempfile::tempdir().unwrap();
    let mut context = engine::JobContext::detached(root.path()).unwrap();
    context.sources.insert("source".into(), dir.path().into());
    context.stop.store(true, std::sync::atomic::Ordering::Relaxed);
    let error = <crate::SfmImport as engine::Stage>::run(&context, &Params::default()).err().unwrap();
    let failure = error.downcast_ref::<engine::Failure>().unwrap();
    assert_eq!(failure.kind, engine::FailureKind::Interrupted);
    assert!(!root.path().join("output/capture.json").exists());
}
