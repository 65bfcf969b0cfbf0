//! Rigs in the layout of Immersive Light Field Video.

use std::path::Path;

use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::Split;
use serde_json::{Value, json};
use support::fakes::{Fake, has_ffmpeg};
use tempfile::TempDir;

use super::rigs::misfit_px;
use super::support::*;
use crate::lens::Distortion;
use crate::recognise::read;
use crate::{Format, Params};

/// The name of a camera of a fake; numbers start at 1.
fn name(camera: usize) -> String {
    format!("camera_{:04}", camera + 1)
}

/// `models.json` of a fake rig.
fn models(fake: &Fake) -> Value {
    let model = |index: usize| {
        let camera = fake.camera(index);
        let orientation = DQuat::from_mat3(&camera.rotation).to_scaled_axis().to_array();
        json!({
            "name": name(index), "position": camera.position().to_array(), "orientation": orientation,
            "focal_length": camera.focal, "pixel_aspect_ratio": 1.0, "principal_point": camera.center.to_array(),
            "height": f64::from(fake.size.1), "width": f64::from(fake.size.0), "radial_distortion": [0.0, 0.0, 0.0],
            "projection_type": "fisheye",
        })
    };
    (0..fake.cameras).map(model).collect()
}

/// A fake rig with extracted frames.
fn rig(fake: &Fake) -> TempDir {
    let dir = TempDir::new().unwrap();
    std::fs::write(dir.path().join("models.json"), models(fake).to_string()).unwrap();
    fake.write_frames(|camera, frame| dir.path().join(format!("{}/{frame}.png", name(camera))));
    dir
}

#[test]
fn rigs_hold_out_the_first_camera() {
    let fake = Fake::small(4, 12);
    let dir = rig(&fake);
    let capture = read(dir.path(), &Params::default()).unwrap();
    // The pinhole of a fisheye has its pose and its focal length on the axis.
    assert!(misfit_px(&fake, &capture) < 1e-9, "{}", misfit_px(&fake, &capture));
    assert_eq!((capture.count(Split::Train), capture.count(Split::Test), capture.format), (36, 12, Format::Immersive));
    assert_eq!((capture.dataset, capture.split_rule.as_str()), ("immersive", "camera camera_0001 held out, 12 frames"));
    assert!(
        capture.problems().is_empty() && capture.warnings.is_empty(),
        "{:?} {:?}",
        capture.problems(),
        capture.warnings
    );
    let window = Params { first_frame: Some(2), frame_count: Some(3), ..Params::default() };
    let (_root, imported) = run(dir.path(), &Params { test_cameras: vec![name(2)], ..window }).unwrap();
    assert_eq!((imported.views.len(), imported.protocol.split.as_str()), (12, "camera camera_0003 held out, 3 frames"));
    let text = crate::inspect::inspect(dir.path()).unwrap().text();
    for part in
        ["Immersive Light Field Video", "4 (a rig)", "undistorted by the import", "fps = 30.0", "ready to import"]
    {
        assert!(text.contains(part), "{part:?} is not in\n{text}");
    }
    assert!(!text.contains("ignored"), "{text}");
}

/// The example in the README of the data set: a camera, a world point, and the pixel where the camera sees it.
#[test]
fn the_example_of_the_data_set_is_projected_to_its_pixel() {
    let fake = Fake { size: (2560, 1920), is_blank: true, ..Fake::small(1, 1) };
    let dir = rig(&fake);
    let model = json!([{
        "name": "camera_0001",
        "position": [0.003311238794086777, 0.000126384684934784, 0.42421246053630285],
        "orientation": [-0.03295944563072383, 0.02964606619481096, -0.03337751007195316],
        "focal_length": 1111.3638715594666, "pixel_aspect_ratio": 1.0,
        "principal_point": [1284.7296468363463, 925.4651609728676], "height": 1920.0, "width": 2560.0,
        "radial_distortion": [0.0970525284520715, -0.01708587111009977, 0.0], "projection_type": "fisheye",
    }]);
    std::fs::write(dir.path().join("models.json"), model.to_string()).unwrap();
    let params = Params { test_cameras: vec!["camera_0001".into()], ..Params::default() };
    let frame = &read(dir.path(), &params).unwrap().frames[0];
    let view = frame.camera_from_world.apply(DVec3::new(0.5, 0.5, 10.0));
    let pixel = frame.lens.pixel(view.truncate() / view.z);
    assert!(pixel.distance(DVec2::new(1377.85525, 1017.61440)) < 1e-4, "{pixel}");
    let pinhole = frame.camera().unwrap().intrinsics;
    assert_eq!(pinhole.focal_x, 1111.3638715594666, "the pinhole's whole view is inside the photograph");
}

/// Manually computed pixels of a lens with a strong bend: a ray at 45° is seen at f · π/4 · (1 + 0.1 (π/4)²).
#[test]
fn fisheye_rays_follow_the_angle() {
    let fake = Fake::small(2, 1);
    let dir = rig(&fake);
    let mut models = models(&fake);
    models[1]["radial_distortion"] = json!([0.1, 0.0, 0.0]);
    models[1]["orientation"] = json!([0.0, std::f64::consts::FRAC_PI_2, 0.0]);
    models[1]["position"] = json!([1.0, 2.0, 3.0]);
    std::fs::write(dir.path().join("models.json"), models.to_string()).unwrap();
    let capture = read(dir.path(), &Params { every_nth: 0, ..Params::default() }).unwrap();
    let frame = capture.frames.iter().find(|frame| frame.camera_index == 1).unwrap();
    // 90° about y maps x to −z and z to x.
    assert!(
        (frame.camera_from_world.rotation - DMat3::from_rotation_y(std::f64::consts::FRAC_PI_2))
            .to_cols_array()
            .iter()
            .all(|it| it.abs() < 1e-12)
    );
    assert!(frame.camera_from_world.apply(DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
    assert_eq!(frame.lens.distortion, Distortion::fisheye([0.1, 0.0, 0.0, 0.0]));
    let angle = std::f64::consts::FRAC_PI_4;
    let expected = frame.lens.intrinsics.focal_x * angle * (1.0 + 0.1 * angle * angle);
    let found = frame.lens.pixel(DVec2::new(1.0, 0.0)).x - frame.lens.intrinsics.center_x;
    assert!((found - expected).abs() < 1e-9, "{found} {expected}");
}

#[test]
fn videos_belong_to_calibrations_by_name() {
    let fake = Fake::small(4, 2);
    let dir = rig(&fake);
    std::fs::rename(dir.path().join(name(1)), dir.path().join("camera_0036")).unwrap();
    let capture = read(dir.path(), &Params::default()).unwrap();
    assert_eq!((capture.camera_count(), capture.count(Split::Test)), (3, 2));
    let expected =
        ["1 of 4 cameras have no frames, e.g. camera_0002", "models.json has no calibration for camera_0036"];
    assert_eq!(capture.warnings, expected);
    let named: Vec<&str> = capture.frames[..3].iter().map(|frame| frame.name.as_str()).collect();
    assert_eq!(named, ["camera_0001_0000", "camera_0003_0000", "camera_0004_0000"]);
    std::fs::remove_dir_all(dir.path().join(name(0))).unwrap();
    let capture = read(dir.path(), &Params { every_nth: 2, ..Params::default() }).unwrap();
    assert_eq!(capture.split_rule, "1 of 2 cameras, 2 frames", "without camera_0001, the usual rule of rigs holds");
}

#[test]
fn videos_are_decoded_and_undistorted() {
    if !has_ffmpeg() {
        return;
    }
    let fake = Fake { size: (96, 64), ..Fake::small(4, 5) };
    let dir = TempDir::new().unwrap();
    fake.neural_3d_videos(dir.path());
    for camera in 0..fake.cameras {
        let video = dir.path().join(format!("cam{camera:02}.mp4"));
        std::fs::rename(video, dir.path().join(format!("{}.mp4", name(camera)))).unwrap();
    }
    std::fs::remove_file(dir.path().join("poses_bounds.npy")).unwrap();
    std::fs::write(dir.path().join("models.json"), models(&fake).to_string()).unwrap();
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!((capture.views.len(), capture.views[0].camera.intrinsics.width), (20, 96));
}

#[test]
fn faulty_rigs_are_refused() {
    let mut refusals = Refusals::default();
    let fake = Fake::small(2, 2);
    let mut add = |damage: &dyn Fn(&Path, &mut Value)| {
        let (dir, mut models) = (rig(&fake), models(&fake));
        damage(dir.path(), &mut models);
        std::fs::write(dir.path().join("models.json"), models.to_string()).unwrap();
        refusals.add(dir.path(), &Params::default());
    };
    let changes: [(&str, Value); 9] = [
        ("projection_type", json!("perspective")),
        ("pixel_aspect_ratio", json!(1.1)),
        ("width", json!(23.5)),
        ("width", json!(48.0)),
        ("focal_length", json!(-3.0)),
        ("orientation", json!([1e300, 1e300, 0.0])),
        ("position", json!([0.0, 1.0])),
        ("radial_distortion", json!([-9.0, 0.0, 0.0])),
        ("name", json!("camera_0001")),
    ];
    for (key, value) in changes {
        add(&|_, models| models[1][key] = value.clone());
    }
    add(&|_, models| *models = json!({ "cameras": [] }));
    add(&|_, models| models[1]["name"] = json!("../camera_0002"));
    add(&|dir, _| (0..2).for_each(|camera| std::fs::remove_dir_all(dir.join(name(camera))).unwrap()));
    add(&|dir, _| (0..2).for_each(|frame| std::fs::remove_file(dir.join(format!("camera_0002/{frame}.png"))).unwrap()));
    add(&|dir, _| std::fs::remove_file(dir.join("camera_0002/1.png")).unwrap());
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn mangled_models_of_rigs_never_panic() {
    let dir = rig(&Fake::small(2, 2));
    let refused = support::mangle::refused(&dir.path().join("models.json"), 400, |_| {
        let capture = read(dir.path(), &Params::default())?;
        capture.problems().into_iter().next().map_or(Ok(()), Err)
    });
    assert!(refused > 100, "only {refused} of 400 damaged versions were refused: is the file read at all?");
}
