//! Lens keys of transforms files beyond `camera_angle_x`, as written by instant-ngp and nerfstudio.

use serde_json::{Value, json};

use super::support::*;
use crate::lens::{Distortion, Lens};
use crate::recognise::read;
use crate::{Format, Params};

/// The lenses of all views, in the order of the files, after editing the training file.
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
fn stated_focal_lengths_and_principal_points_are_used() {
    let stated =
        json!({ "fl_x": 30.0, "fl_y": 31.0, "cx": 11.0, "cy": 8.5, "w": 24.0, "h": 16, "camera_model": "OPENCV" });
    let lenses = lenses(|json| set(json, &stated));
    let k = lenses[0].intrinsics;
    assert_eq!((k.focal_x, k.focal_y, k.center_x, k.center_y), (30.0, 31.0, 11.0, 8.5));
    assert!(lenses[..5].iter().all(|lens| *lens == lenses[0] && lens.distortion.is_none()));
    // The other files state only an angle.
    let k = lenses[5].intrinsics;
    assert_eq!((k.focal_x, k.focal_y, k.center_x, k.center_y), (12.0 / 0.35_f64.tan(), k.focal_x, 12.0, 8.0));
}

#[test]
fn a_lens_stated_vertically_has_square_pixels() {
    for key in ["fl_y", "camera_angle_y"] {
        let dir = blender_scene();
        for label in ["train", "val", "test"] {
            edit_transforms(dir.path(), label, |json| {
                json.as_object_mut().unwrap().remove("camera_angle_x");
                let angle = 2.0 * (0.5 * f64::from(HEIGHT) / 30.0).atan();
                json[key] = if key == "fl_y" { 30.0 } else { angle }.into();
            });
        }
        let source = read(dir.path(), &Params::default()).unwrap();
        let lens = source.frames[0].lens.intrinsics;
        assert!((lens.focal_x - 30.0).abs() < 1e-9 && lens.focal_x == lens.focal_y, "{lens:?}");
        assert_eq!(
            source.warnings,
            [format!("only {key} states the lens: pixels are taken as square; state fl_x if they are not")]
        );
    }
}

#[test]
fn keys_of_a_frame_override_those_of_its_file() {
    let lenses = lenses(|json| {
        set(json, &json!({ "fl_x": 30.0, "fl_y": 31.0, "cx": 11.0 }));
        set(&mut json["frames"][1], &json!({ "fl_x": 40.0 }));
        set(&mut json["frames"][2], &json!({ "camera_angle_x": 0.8, "camera_angle_y": 0.5, "cx": 12.5 }));
    });
    let [file, one, both] = [0, 1, 2].map(|at: usize| lenses[at].intrinsics);
    assert_eq!((file.focal_x, file.focal_y), (30.0, 31.0));
    assert_eq!(
        (one.focal_x, one.focal_y, one.center_x),
        (40.0, 40.0, 11.0),
        "square pixels instead of the file's fl_y"
    );
    assert_eq!((both.focal_x, both.focal_y, both.center_x), (12.0 / 0.4_f64.tan(), 8.0 / 0.25_f64.tan(), 12.5));
}

#[test]
fn distortion_is_applied_or_refused() {
    let all = json!({ "k1": -0.05, "k2": 0.01, "k3": 0.002, "k4": 0.0, "p1": 0.001, "p2": -0.002 });
    let bent = lenses(|json| set(json, &all))[0];
    assert_eq!(bent.distortion, Distortion::brown([-0.05, 0.01, 0.002, 0.0], [0.001, -0.002]));
    insta::assert_snapshot!(refusals(&[
        json!({ "k4": 0.1 }),
        json!({ "camera_model": "EQUIRECTANGULAR" }),
        json!({ "k1": -40.0 }),
    ]));
}

/// The errors for training files with these values.
fn refusals(cases: &[Value]) -> String {
    let mut refusals = Refusals::default();
    for values in cases {
        let dir = blender_scene();
        edit_transforms(dir.path(), "train", |json| set(json, values));
        refusals.add(dir.path(), &Params::default());
    }
    refusals.text().to_owned()
}

#[test]
fn impossible_lenses_and_sizes_are_refused() {
    insta::assert_snapshot!(refusals(&[
        json!({ "fl_x": 0.0 }),
        json!({ "camera_angle_x": null }),
        json!({ "w": 48, "h": 32 }),
        json!({ "w": 24.5 }),
        json!({ "camera_angle_x": 1e-9 }),
        json!({ "camera_angle_x": 3.1 }),
    ]));
}

#[test]
fn cameras_too_far_for_single_precision_are_refused() {
    let dir = blender_scene();
    edit_transforms(dir.path(), "train", |json| json["frames"][0]["transform_matrix"][0][3] = json!(1e30));
    insta::assert_snapshot!(refusal(dir.path(), &Params::default()));
}
