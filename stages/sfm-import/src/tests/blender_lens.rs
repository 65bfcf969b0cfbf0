//! Lenses that transforms files state beyond `camera_angle_x`, as instant-ngp and nerfstudio write them.

use serde_json::{Value, json};

use super::support::*;
use crate::Params;
use crate::lens::{Distortion, Lens};
use crate::params::Format;

/// The lens of every view, in the order of the files, after `edit` of the training file.
fn lenses(edit: impl FnOnce(&mut Value)) -> Vec<Lens> {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", edit);
    run(dir.path(), &Params { format: Format::Blender, ..Params::default() }).unwrap();
    frames(dir.path(), &Params::default()).iter().map(|frame| frame.lens).collect()
}

fn set(json: &mut Value, values: &Value) {
    json.as_object_mut().unwrap().extend(values.as_object().unwrap().clone());
}

#[test]
fn stated_focal_lengths_and_principal_points_count() {
    let stated =
        json!({ "fl_x": 30.0, "fl_y": 31.0, "cx": 11.0, "cy": 8.5, "w": 24.0, "h": 16, "camera_model": "OPENCV" });
    let lenses = lenses(|json| set(json, &stated));
    let k = lenses[0].intrinsics;
    assert_eq!((k.focal_x, k.focal_y, k.center_x, k.center_y), (30.0, 31.0, 11.0, 8.5));
    assert!(lenses[..5].iter().all(|lens| *lens == lenses[0] && lens.distortion.is_none()));
    // The other files state an angle alone.
    let k = lenses[5].intrinsics;
    assert_eq!((k.focal_x, k.focal_y, k.center_x, k.center_y), (12.0 / 0.35_f64.tan(), k.focal_x, 12.0, 8.0));
}

#[test]
fn a_frame_counts_before_its_file_and_angles_may_differ_by_axis() {
    let lenses = lenses(|json| {
        set(json, &json!({ "fl_x": 30.0, "fl_y": 31.0, "cx": 11.0 }));
        set(&mut json["frames"][1], &json!({ "fl_x": 40.0 }));
        set(&mut json["frames"][2], &json!({ "camera_angle_x": 0.8, "camera_angle_y": 0.5, "cx": 12.5 }));
    });
    let [file, one, both] = [0, 1, 2].map(|at: usize| lenses[at].intrinsics);
    assert_eq!((file.focal_x, file.focal_y), (30.0, 31.0));
    assert_eq!((one.focal_x, one.focal_y, one.center_x), (40.0, 40.0, 11.0), "square pixels, not the file's fl_y");
    assert_eq!((both.focal_x, both.focal_y, both.center_x), (12.0 / 0.4_f64.tan(), 8.0 / 0.25_f64.tan(), 12.5));
}

#[test]
fn distortion_is_honoured_or_refused() {
    let all = json!({ "k1": -0.05, "k2": 0.01, "k3": 0.002, "k4": 0.0, "p1": 0.001, "p2": -0.002 });
    let bent = lenses(|json| set(json, &all))[0];
    assert_eq!(bent.distortion, Distortion { k1: -0.05, k2: 0.01, k3: 0.002, p1: 0.001, p2: -0.002 });
    let refused = |values: Value, parts: &[&str]| {
        let dir = blender_scene();
        edit_transforms(dir.path(), "train", |json| set(json, &values));
        assert_refused(dir.path(), &Params::default(), &[parts, &["transforms_train.json"]].concat());
    };
    refused(json!({ "k4": 0.1 }), &["k4 is 0.1", "image_undistorter"]);
    refused(json!({ "camera_model": "OPENCV_FISHEYE" }), &["camera model OPENCV_FISHEYE is not supported"]);
    refused(json!({ "is_fisheye": true }), &["is_fisheye"]);
    refused(json!({ "k1": -40.0 }), &["folds the image over"]);
}

#[test]
fn impossible_lenses_and_sizes_are_refused() {
    let refused = |values: Value, parts: &[&str]| {
        let dir = blender_scene();
        edit_transforms(dir.path(), "train", |json| set(json, &values));
        assert_refused(dir.path(), &Params::default(), parts);
    };
    refused(json!({ "fl_x": 0.0 }), &["fl_x is 0", "transforms_train.json"]);
    refused(json!({ "camera_angle_x": null }), &["neither fl_x nor camera_angle_x", "transforms_train.json"]);
    refused(json!({ "w": 48, "h": 32 }), &["24×16 where 48×32 is expected", "r_000.png"]);
    refused(json!({ "w": 24.5 }), &["w is 24.5, not a number of pixels", "transforms_train.json"]);
    refused(json!({ "camera_angle_x": 1e-9 }), &["the camera sees 5.73e-8°", "transforms_train.json"]);
    refused(json!({ "camera_angle_x": 3.1 }), &["no pinhole", "transforms_train.json"]);
}

#[test]
fn cameras_too_far_for_single_precision_are_refused() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| json["frames"][0]["transform_matrix"][0][3] = json!(1e30));
    assert_refused(dir.path(), &Params::default(), &["1e30 units from the origin", "centre and scale"]);
}
