//! Warnings about times, lenses and points that are often errors, and refusals of numbers that are certainly wrong.

use scene::PointCloud;
use scene::ply::PlyFormat;
use serde_json::json;

use super::support::*;
use crate::Params;
use crate::oddities::UNTESTED;
use crate::recognise::read;
use crate::source::Frame;
use crate::transforms::{long_gap, time_map};

/// The warnings of an import, which `inspect` must show, too.
fn warnings(dir: &std::path::Path) -> Vec<String> {
    let imported = read(dir, &Params::default()).unwrap().warnings;
    let summary = crate::inspect::inspect(dir).unwrap().captures.remove(0);
    assert!(imported.iter().all(|warning| summary.warnings.contains(warning)), "{imported:?} {:?}", summary.warnings);
    assert!(summary.problems.is_empty(), "{:?}", summary.problems);
    imported
}

/// A Blender capture with changed training views.
fn edited(edit: impl FnOnce(&mut serde_json::Value)) -> tempfile::TempDir {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", edit);
    dir
}

#[test]
fn ordinary_captures_have_no_warnings() {
    assert_eq!(warnings(blender_scene().path()), [""; 0]);
}

#[test]
fn a_capture_without_test_views_is_warned_of() {
    let dir = Workspace::video(10).write();
    let is_warned = |every_nth: u32| {
        let found = read(dir.path(), &Params { every_nth, ..colmap_params() }).unwrap().warnings;
        found.iter().any(|warning| warning == UNTESTED)
    };
    assert_eq!([0, 8].map(is_warned), [true, false]);
}

#[test]
fn views_in_two_splits_are_warned_of() {
    let dir = blender_scene();
    std::fs::copy(dir.path().join("transforms_train.json"), dir.path().join("transforms_test.json")).unwrap();
    let found = warnings(dir.path());
    let expected = "5 views have camera, time and image of a view of another split, e.g. train_000 and test_000";
    assert!(found.len() == 1 && found[0].starts_with(expected), "{found:?}");
}

#[test]
fn normalised_principal_points_are_warned_of() {
    let dir = edited(|json| {
        let frames = json["frames"].as_array_mut().unwrap();
        frames.iter_mut().for_each(|frame| (frame["cx"], frame["cy"]) = (json!(0.5), json!(0.5)));
    });
    let found = warnings(dir.path());
    assert!(found.len() == 1 && found[0].contains("far from the middle of the images, e.g. (0.5, 0.5)"), "{found:?}");
}

#[test]
fn parameters_of_rigs_are_refused_for_other_captures() {
    let dir = blender_scene();
    let cases = [
        (Params { test_cameras: vec!["cam1".into()], ..Params::default() }, "test_cameras has no effect"),
        (Params { first_frame: Some(2), ..Params::default() }, "first_frame has no effect"),
        (Params { frame_count: Some(2), ..Params::default() }, "frame_count has no effect"),
    ];
    for (params, expected) in cases {
        assert_refused(dir.path(), &params, &[expected, "n3v"]);
    }
}

#[test]
fn a_wrong_time_is_warned_of() {
    let dir = edited(|json| json["frames"][4]["time"] = json!(50.0));
    let found = warnings(dir.path());
    let expected = "no frame lies between test_002 (time 1 in transforms_test.json) and train_004 (time 50 in \
                    transforms_train.json), 98 % of the whole time: correct the times";
    assert!(found.len() == 1 && found[0].starts_with(expected), "{found:?}");
    // A gap of few frames is not, and neither is one that is a small part of the whole time.
    let first = frames(dir.path(), &Params::default()).remove(0);
    let is_warned = |times: &[f64]| {
        let timed: Vec<Frame> = times.iter().map(|time| Frame { time_secs: *time, ..first.clone() }).collect();
        long_gap(&timed, &time_map(&timed, false)).is_some()
    };
    let far_apart: Vec<f64> = [0.0, 0.1].into_iter().chain((1..=20).map(|index| 3.0 * f64::from(index))).collect();
    let cases = [is_warned(&[0.0, 0.1, 2.0]), is_warned(&[0.0, 0.1, 2.2]), is_warned(&far_apart)];
    assert_eq!(cases, [false, true, false]);
}

#[test]
fn times_in_another_unit_are_warned_of() {
    let scale = |label: &str, dir: &std::path::Path, unit: f64| {
        edit_transforms(dir, label, |json| {
            let frames = json["frames"].as_array_mut().unwrap();
            (0_u32..).zip(frames).for_each(|(index, frame)| frame["time"] = json!(f64::from(index) * unit / 30.0));
        });
    };
    for (unit, expected) in [
        (1.0, None),
        (1e3, None), // 33 s per frame may be a time lapse
        (1e5, Some("a frame lasts 3333 s, because times are read as seconds: if they are in milliseconds")),
        (1e6, Some("if they are in microseconds, multiply the time of each frame by 1e-6")),
        (1e9, Some("if they are in nanoseconds, multiply the time of each frame by 1e-9")),
    ] {
        let dir = blender_scene();
        ["train", "val", "test"].iter().for_each(|label| scale(label, dir.path(), unit));
        let found = warnings(dir.path());
        assert_eq!(found.len(), usize::from(expected.is_some()), "{found:?}");
        assert!(expected.is_none_or(|expected| found[0].contains(expected)), "{found:?}");
    }
}

#[test]
fn held_out_times_between_the_frames_do_not_shorten_the_frames() {
    // 5 training views in steps of 1/4, and 3 test views in the middle of steps of 1/24.
    let dir = blender_scene();
    edit_transforms(dir.path(), "test", |json| {
        let frames = json["frames"].as_array_mut().unwrap();
        (0_u32..).zip(frames).for_each(|(index, frame)| frame["time"] = json!((f64::from(index) + 0.5) / 24.0));
    });
    assert_eq!(read(dir.path(), &Params::default()).unwrap().time_map.frame_secs, 0.25);
    let found = warnings(dir.path());
    let expected = "the times of held-out views lie between the frames: a frame lasts 0.250 s by the times of the training views, \
                    although all times are multiples of 0.0208 s";
    assert!(found.len() == 1 && found[0].starts_with(expected), "{found:?}");
    // Held-out frames of the same video make the grid finer, and are not warned of.
    let dir = blender_scene();
    edit_transforms(dir.path(), "test", |json| json["frames"][1]["time"] = json!(0.375));
    assert_eq!(read(dir.path(), &Params::default()).unwrap().time_map.frame_secs, 0.125);
    assert_eq!(warnings(dir.path()), [""; 0]);
}

#[test]
fn times_that_overflow_are_refused_with_their_file() {
    let dir = edited(|json| {
        json["frames"][0]["time"] = json!(-1e308);
        json["frames"][4]["time"] = json!(1e308);
    });
    let expected = ["train_004: the time is 1e308 s", "correct the times", "transforms_train.json"];
    assert_refused(dir.path(), &Params::default(), &expected);
    let summary = crate::inspect::inspect(dir.path()).unwrap().captures.remove(0);
    assert!(summary.problems.iter().any(|problem| problem.message.starts_with(expected[0])), "{:?}", summary.problems);
}

#[test]
fn rounded_poses_are_straightened_with_a_warning() {
    let rounded = |value: f64| (1e3 * value).round() / 1e3;
    let dir = edited(|json| {
        for index in 1..5 {
            let rows = blender_matrix(index).map(|row| row.map(rounded));
            json["frames"][index]["transform_matrix"] = json!(rows);
        }
    });
    let found = warnings(dir.path());
    assert!(found.len() == 1, "{found:?}");
    assert!(found[0].starts_with("the rotations of 4 poses have few digits, e.g. that of train_001"), "{found:?}");
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    for (view, index) in capture.views[1..5].iter().zip(1..) {
        let pose = view.camera.camera_from_world;
        assert!(pose.deviation() <= 1e-12, "{}", pose.deviation());
        let position = glam::DVec3::from_array([0, 1, 2].map(|axis| rounded(blender_matrix(index)[axis][3])));
        assert!(view.camera.position_world().distance(position) <= 1e-12, "the position is kept");
        let forward = pose.rotation.transpose() * glam::DVec3::Z;
        let exact = glam::DVec3::from_array([0, 1, 2].map(|axis| -blender_matrix(index)[axis][2]));
        assert!(forward.distance(exact) <= 3e-3, "{forward} instead of {exact}");
    }
}

#[test]
fn odd_lenses_are_warned_of_and_impossible_ones_refused() {
    let with = |key: &'static str, value: f64| edited(move |json| json[key] = json!(value));
    let found = warnings(with("fl_y", 3000.0).path());
    assert!(found.len() == 1 && found[0].starts_with("the focal lengths of 5 views differ"), "{found:?}");
    let found = warnings(with("cx", 30.0).path());
    assert!(
        found.len() == 1 && found[0].starts_with("the principal points of 5 views are far from the middle"),
        "{found:?}"
    );
    let expected = ["train_000: the principal point, cx = 1e9 px", "more than 85°", "in pixels of these images"];
    assert_refused(with("cx", 1e9).path(), &Params::default(), &expected);
}

#[test]
fn different_focal_lengths_are_shown() {
    let dir = edited(|json| json["frames"][1]["fl_x"] = json!(35.0));
    let text = describe(dir.path()).unwrap();
    assert!(text.contains("focal       32.9 px (32.9 to 35.0 px in all views), 40.1° horizontal"), "{text}");
}

/// Adds a cloud: a grid of 1000 points in [-1, 1]³, and more points.
fn add_cloud(dir: &std::path::Path, more: &[[f32; 3]]) {
    let at = |index: u32| [index % 10, index / 10 % 10, index / 100].map(|step| step as f32 / 4.5 - 1.0);
    let positions: Vec<[f32; 3]> = (0..1000).map(at).chain(more.iter().copied()).collect();
    let cloud = PointCloud { colors: vec![[9; 3]; positions.len()], positions };
    cloud.write_ply(&dir.join("fused.ply"), PlyFormat::Ascii).unwrap();
}

#[test]
fn far_points_are_counted() {
    let dir = blender_scene();
    add_cloud(dir.path(), &[[2.0; 3], [0.0, 100.0, 0.0], [1e30; 3], [0.0, 0.0, -100.0]]);
    let found = warnings(dir.path());
    let expected = "3 of 1004 points are far from the others, e.g. (0, 100, 0)";
    assert!(found.len() == 1 && found[0].starts_with(expected), "{found:?}");
    add_cloud(dir.path(), &[[2.0; 3]]);
    assert_eq!(warnings(dir.path()), [""; 0]);
}

#[test]
fn elongated_images_need_points_or_bounds() {
    let dir = blender_scene();
    for (label, count, first) in [("train", 5, 0), ("val", 2, 10), ("test", 3, 20)] {
        for index in 0..count {
            let path = dir.path().join(label).join(format!("r_{index:03}.png"));
            let pixel = |column, row| image::Rgba([column as u8, row as u8, first + index, 255]);
            image::RgbaImage::from_fn(96, 16, pixel).save(path).unwrap();
        }
    }
    let found = warnings(dir.path());
    assert!(found.len() == 1 && found[0].starts_with("images of 96×16 pixels without a point cloud"), "{found:?}");
    edit_transforms(dir.path(), "train", |json| json["aabb"] = json!([[-1, -1, -1], [1, 1, 1]]));
    assert_eq!(warnings(dir.path()), [""; 0]);
    edit_transforms(dir.path(), "train", |json| drop(json["aabb"].take()));
    add_cloud(dir.path(), &[]);
    assert_eq!(warnings(dir.path()), [""; 0]);
}

#[test]
fn images_that_viewers_turn_are_warned_of() {
    let dir = blender_scene();
    for index in [1, 3] {
        let path = dir.path().join(format!("train/r_00{index}.png"));
        let mut jpeg = std::io::Cursor::new(Vec::new());
        image::open(&path).unwrap().into_rgb8().write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
        std::fs::write(path, with_orientation(&jpeg.into_inner(), 6)).unwrap();
    }
    let found = warnings(dir.path());
    let expected = "2 images have an EXIF orientation, which is not applied, e.g. r_001.png";
    assert!(found.len() == 1 && found[0].starts_with(expected) && found[0].contains("auto-orient"), "{found:?}");
}
