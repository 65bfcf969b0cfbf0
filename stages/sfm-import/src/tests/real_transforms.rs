//! Real transforms files, where `PIPELINE_DATA` names their folder. Their images are not part of it: blank ones stand in.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use image::GrayImage;
use scene::Split;
use serde_json::Value;
use tempfile::TempDir;

use super::support::refusal;
use crate::Params;
use crate::lens::Distortion;
use crate::recognise::read;
use crate::source::SourceCapture;

/// A copy of some files of a real capture, renamed, with blank images; `None` if the data is not available.
fn copy(folder: &str, files: &[(&str, &str)], size: (u32, u32)) -> Option<TempDir> {
    let source = support::data(&format!("formats/captures/{folder}"))?;
    let dir = tempfile::tempdir().unwrap();
    for (from, to) in files {
        std::fs::copy(source.join(from), dir.path().join(to)).unwrap();
        if to.ends_with(".json") {
            add_images(dir.path(), &dir.path().join(to), size);
        }
    }
    Some(dir)
}

/// Writes a blank image for every frame of a file, at the size that the file states or at `size`.
fn add_images(dir: &Path, file: &Path, size: (u32, u32)) {
    let json: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    for frame in json["frames"].as_array().unwrap() {
        let side = |key: &str, other: u32| {
            let stated = frame[key].as_f64().or(json[key].as_f64());
            stated.map_or(other, |value| value as u32)
        };
        let name = frame["file_path"].as_str().unwrap();
        if name.is_empty() {
            continue;
        }
        let path = dir.join(name);
        let is_named = ["png", "jpg", "jpeg"].iter().any(|extension| name.to_lowercase().ends_with(extension));
        let path = if is_named { path } else { PathBuf::from(format!("{}.png", path.display())) };
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        let (width, height) = (side("w", size.0), side("h", size.1));
        let extension = path.extension().unwrap().to_string_lossy().to_lowercase();
        let blank = dir.join(format!("blank_{width}_{height}.{extension}"));
        if !blank.is_file() {
            GrayImage::new(width, height).save(&blank).unwrap();
        }
        let _ = std::fs::hard_link(&blank, &path); // several frames may name one image
    }
}

/// Reads a copy with one `transforms.json`, and checks that nothing prevents its import.
fn single(folder: &str, file: &str) -> Option<SourceCapture> {
    let files = [(file, "transforms.json"), ("sparse_pc.ply", "sparse_pc.ply")];
    let has_cloud = support::data(&format!("formats/captures/{folder}"))?.join("sparse_pc.ply").is_file();
    let dir = copy(folder, &files[..1 + usize::from(has_cloud)], (540, 540))?;
    Some(accepted(&dir))
}

fn accepted(dir: &TempDir) -> SourceCapture {
    let capture = read(dir.path(), &Params::default()).unwrap();
    assert_eq!(capture.problems().first().map(ToString::to_string), None);
    capture
}

fn count(capture: &SourceCapture) -> [usize; 3] {
    [Split::Train, Split::Val, Split::Test].map(|split| capture.count(split))
}

/// Distinct pairs of focal lengths, as bits.
fn lenses(capture: &SourceCapture) -> usize {
    let focal = |frame: &crate::source::Frame| {
        (frame.lens.intrinsics.focal_x.to_bits(), frame.lens.intrinsics.focal_y.to_bits())
    };
    capture.frames.iter().map(focal).collect::<BTreeSet<_>>().len()
}

#[test]
fn nerfstudio_files_are_read() {
    let Some(capture) = single("nerfstudio-colmap-full", "transforms.json") else { return };
    assert_eq!((count(&capture), lenses(&capture), capture.points.len()), ([97, 0, 14], 1, 28162));
    let k = capture.frames[0].lens.intrinsics;
    assert_eq!((k.width, k.height, k.focal_x), (5712, 4284, 4158.0468167053505));
    // The cloud is in the frame of the poses: the cameras see most of it.
    let seen = capture.frames.iter().flat_map(|frame| {
        let camera = scene::Camera { intrinsics: k, camera_from_world: frame.camera_from_world };
        capture.points.iter().step_by(100).map(move |(point, _)| {
            camera.project((*point).into()).is_some_and(|(at, _)| {
                (0.0..f64::from(k.width)).contains(&at.x) && (0.0..f64::from(k.height)).contains(&at.y)
            })
        })
    });
    let (hits, all) = seen.fold((0, 0), |(hits, all), hit| (hits + usize::from(hit), all + 1));
    assert!(5 * hits > 2 * all, "{hits} of {all} projections are inside the images");
    assert!(
        capture.warnings.iter().all(|warning| !warning.contains("lacks applied_transform")),
        "{:?}",
        capture.warnings
    );
    // Structure from motion has y downwards; nerfstudio's z is upwards.
    let down = capture.frames[0].camera_from_world.rotation.transpose() * glam::DVec3::Y;
    assert!(down.y > 0.5, "{down}");

    let Some(capture) = single("nerfstudio-opencv-noapplied", "transforms.json") else { return };
    assert_eq!((count(&capture), capture.points.len()), ([264, 0, 38], 0));
}

#[test]
fn instant_ngp_files_are_read() {
    let Some(fox) = single("instantngp-fox", "transforms.json") else { return };
    assert_eq!((fox.frames.len(), lenses(&fox)), (67, 1));
    let expected = Distortion::brown([0.0578421, -0.0805099, 0.0, 0.0], [-0.000980296, 0.00015575]);
    assert_eq!(fox.frames[0].lens.distortion, expected);
    let two = single("instantngp-per-frame-intrinsics", "transforms.json").unwrap();
    assert_eq!((two.frames.len(), lenses(&two)), (42, 2));
    let many = single("instantngp-per-frame-simple-radial", "transforms.json").unwrap();
    assert_eq!((many.frames.len(), lenses(&many)), (22, 22));
    let blender = single("instantngp-blender-addon", "transforms.json").unwrap();
    assert_eq!((blender.frames.len(), blender.frames[0].lens.distortion.is_none()), (50, true));
    // The vertical angle that this writer states is wrong.
    assert!(
        blender.warnings[1].contains("fl_y is 1866.7 px, but camera_angle_y implies 1575.0 px"),
        "{:?}",
        blender.warnings
    );
    let rig = single("colmap-rigs-frames-text", "transforms.json").unwrap();
    assert_eq!((rig.frames.len(), rig.frames[0].lens.intrinsics.focal_x), (13, 1027.7879529283434));
    let priors = single("dense-depth-priors-transforms", "transforms_ngp.json").unwrap();
    assert_eq!((priors.frames.len(), priors.frames[0].lens.intrinsics.width), (22, 2880));
}

#[test]
fn split_files_of_other_writers_are_read() {
    let all = ["transforms_train.json", "transforms_val.json", "transforms_test.json"].map(|name| (name, name));
    let Some(dir) = copy("blender-depth-file-path", &all, (40, 30)) else { return };
    for (bits, has_depth) in [(16, true), (8, false)] {
        let path = dir.path().join("train/r_7_depth_0001.png");
        match bits {
            16 => image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(40, 30).save(path).unwrap(),
            _ => GrayImage::new(40, 30).save(path).unwrap(),
        }
        let capture = accepted(&dir);
        assert_eq!(count(&capture), [100; 3]);
        let frame = capture.frames.iter().find(|frame| frame.name == "train_007").unwrap();
        assert_eq!((frame.depth.is_some(), frame.lens.intrinsics.width), (has_depth, 40));
    }

    let dir = copy("dnerf-time", &all, (40, 40)).unwrap();
    let capture = accepted(&dir);
    assert_eq!((count(&capture), capture.camera_count()), ([1500, 1, 1], 15));
    let times: BTreeSet<u64> = capture.frames.iter().map(|frame| frame.time_secs.to_bits()).collect();
    assert_eq!(times.len(), 100);
    assert!((capture.time_map.frame_secs - 1.0 / 99.0).abs() <= 1e-9);

    let dir = copy("dense-depth-priors-transforms", &[all[0], all[2]], (540, 540)).unwrap();
    let capture = accepted(&dir);
    assert_eq!((count(&capture), capture.frames[0].lens.intrinsics.focal_x), ([18, 0, 4], 290.0161437988281));

    let dir = copy("colmap2nerf-split", &all[..1], (0, 0)).unwrap();
    assert_eq!((count(&accepted(&dir)), lenses(&accepted(&dir))), ([5, 0, 1], 1));
}

#[test]
fn wrong_files_are_refused_with_the_reason() {
    let named = [("transforms_video.json", "transforms.json")];
    let Some(dir) = copy("dense-depth-priors-transforms", &named, (540, 540)) else { return };
    let message = refusal(dir.path(), &Params::default());
    assert!(message.contains("no frame names an image: every file_path is empty"), "{message}");
    let named = [("xml_4_transforms.json", "transforms.json")];
    let dir = copy("survey-xml-transforms-odd", &named, (0, 0)).unwrap();
    let message = refusal(dir.path(), &Params::default());
    assert!(message.contains("fl_x is 35.74504986769521 pixels, but camera_angle_x implies 1635"), "{message}");
    assert!(message.contains("millimetres"), "{message}");
}
