//! Masks laid out as each tool writes them, and real ones where `PIPELINE_DATA` names their folder.

use std::collections::BTreeSet;
use std::path::Path;

use scene::mask_file::MaskFile;
use scene::{Capture, Mask, Videos, View};
use scene_synthesis::{CameraPath, SceneKind, Truth};
use serde_json::json;
use tempfile::TempDir;

use crate::params::{LayerSource, Polarity};
use crate::tests::{agreement, capture, capture_of, run, run_measured};
use crate::{Layers, Params};

fn params() -> Params {
    Params { source: LayerSource::Files, folder: "mask".into(), ..Params::default() }
}

/// Bouncing balls, whose labels start at 1.
fn balls() -> (TempDir, Capture) {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(dir.path(), SceneKind::BouncingSpheres, CameraPath::Arc, &[Truth::Masks]);
    (dir, capture)
}

fn labels(capture: &Capture, view: &View) -> Vec<u8> {
    capture.load_mask(view).unwrap().unwrap().labels
}

/// Writes indices with the first colours of DAVIS's palette, as SAM 2 does.
fn write_palette(path: &Path, indices: &[u8]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), 64, 64);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(vec![0, 0, 0, 128, 0, 0, 0, 128, 0, 128, 128, 0, 0, 0, 1]);
    encoder.write_header().unwrap().write_image_data(indices).unwrap();
}

fn layers(capture: &Capture, folder: &Path, params: &Params) -> (TempDir, Layers) {
    run(capture, None, folder, params).unwrap()
}

#[test]
fn sam2_palettes_mark_every_object() {
    let ((_dir, capture), folder) = (balls(), tempfile::tempdir().unwrap());
    for view in &capture.views {
        // The last colour of the palette is nearly black, and still an object.
        let indices: Vec<u8> =
            labels(&capture, view).iter().map(|label| if *label == 1 { 4 } else { *label }).collect();
        write_palette(&folder.path().join(format!("{:05}.png", view.frame_index)), &indices);
    }
    let (_root, layers) = layers(&capture, folder.path(), &params());
    assert_eq!(agreement(&capture, &layers), 1.0);
}

#[test]
fn masks_of_other_frames_are_noticed_by_the_images() {
    let measurement = "masks_fit_images_better_shifted_by_frames";
    // Masks are often wider than the object. In the rig, the balls move by less than a pixel per frame, so masks that
    // are a pixel wider also contain them in the next frame.
    for (camera, widths_px) in [(CameraPath::Arc, &[0, 1][..]), (CameraPath::Rig, &[0][..])] {
        let (dir, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let capture = capture_of(20, dir.path(), SceneKind::BouncingSpheres, camera, &[Truth::Masks, Truth::Points]);
        let videos = Videos::of(&capture);
        let shift_of = |shift: i64, widened_px: u32| {
            for view in &capture.views {
                let other = videos.after(view, shift).map_or(view, |at| &capture.views[at]);
                let mask = Mask::from(&capture.load_mask(other).unwrap().unwrap()).dilated(widened_px);
                mask.to_labels().write(&folder.path().join(format!("{}.png", view.name))).unwrap();
            }
            let (_root, _, measured) = run_measured(&capture, None, folder.path(), &params()).unwrap();
            measured[measurement].clone()
        };
        for &widened_px in widths_px {
            let expected = [json!(1), json!(null), json!(-1)];
            assert_eq!([-1, 0, 1].map(|shift| shift_of(shift, widened_px)), expected, "{camera:?}, {widened_px} px");
        }
        // Masks of the capture are checked, too.
        let (_root, _, measured) = run_measured(&capture, None, Path::new(""), &Params::default()).unwrap();
        assert_eq!(measured[measurement], json!(null));
    }
}

#[test]
fn sam2_folders_of_objects_are_united() {
    let ((_dir, capture), folder) = (balls(), tempfile::tempdir().unwrap());
    let objects = capture.views.iter().flat_map(|view| labels(&capture, view)).max().unwrap();
    assert!(objects >= 2);
    for (at, view) in capture.views.iter().enumerate() {
        for object in 1..=objects {
            let indices: Vec<u8> = labels(&capture, view).iter().map(|label| u8::from(*label == object)).collect();
            // An object that is out of sight may have no file.
            if at > 0 || object == 1 || indices.contains(&1) {
                write_palette(&folder.path().join(format!("{object:03}/{}.png", view.name)), &indices);
            }
        }
    }
    let (_root, both) = layers(&capture, folder.path(), &params());
    assert_eq!(agreement(&capture, &both), 1.0);
    for object in 2..=objects {
        std::fs::remove_dir_all(folder.path().join(format!("{object:03}"))).unwrap();
    }
    let (_root, one) = layers(&capture, folder.path(), &params());
    assert!(agreement(&capture, &one) < 0.9, "the test is blind to the second object");
    std::fs::remove_file(folder.path().join(format!("001/{}.png", capture.views[2].name))).unwrap();
    let error = format!("{:#}", run(&capture, None, folder.path(), &params()).unwrap_err());
    assert!(error.contains(&capture.views[2].name) || error.contains("1 view"), "{error}");
}

#[test]
fn masks_that_colmap_reads_need_a_polarity() {
    let ((_dir, capture), folder) = (balls(), tempfile::tempdir().unwrap());
    for view in &capture.views {
        let keep: Vec<u8> = labels(&capture, view).iter().map(|label| if *label == 0 { 255 } else { 0 }).collect();
        let image = image::GrayImage::from_raw(64, 64, keep).unwrap();
        image.save(folder.path().join(format!("{}.jpg.png", view.name))).unwrap();
    }
    let error = format!("{:#}", run(&capture, None, folder.path(), &params()).unwrap_err());
    assert!(error.contains("like those that COLMAP reads") && error.contains("set-rests"), "{error}");
    let (_root, rests) = layers(&capture, folder.path(), &Params { polarity: Polarity::SetRests, ..params() });
    assert_eq!(agreement(&capture, &rests), 1.0);
    let (_root, moves) = layers(&capture, folder.path(), &Params { polarity: Polarity::SetMoves, ..params() });
    assert_eq!(agreement(&capture, &moves), 0.0, "a stated polarity is followed");
}

#[test]
fn one_array_may_hold_the_masks_of_a_whole_video() {
    let ((_dir, capture), folder) = (balls(), tempfile::tempdir().unwrap());
    let count = capture.views.len();
    let mut header = format!("{{'descr': '|b1', 'fortran_order': False, 'shape': ({count}, 1, 64, 64), }}");
    header += &" ".repeat(63 - (10 + header.len()) % 64);
    let mut bytes = [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16 + 1).to_le_bytes()].concat();
    bytes.extend(header.bytes().chain([b'\n']));
    bytes.extend(capture.views.iter().flat_map(|view| labels(&capture, view)).map(|label| u8::from(label != 0)));
    std::fs::write(folder.path().join("video_masks.npy"), bytes).unwrap();
    let (_root, layers) = layers(&capture, folder.path(), &params());
    assert_eq!(agreement(&capture, &layers), 1.0);
}

#[test]
fn sa_v_files_hold_the_masks_of_a_whole_video() {
    let ((_dir, capture), folder) = (balls(), tempfile::tempdir().unwrap());
    // The left 32 of 64 columns: 0 pixels outside, 2048 inside, 2048 outside.
    let object = r#"{"size": [64, 64], "counts": "0PP2PP2"}"#;
    let frames = |count: usize| format!("{{\"masklet\": [{}]}}", vec![format!("[{object}]"); count].join(", "));
    let path = folder.path().join("sav_000001_manual.json");
    std::fs::write(&path, frames(capture.views.len())).unwrap();
    let (_root, layers) = layers(&capture, folder.path(), &params());
    let mask = layers.load_moving(1).unwrap().unwrap();
    let is_left = |(at, label): (usize, &u8)| (*label != 0) == (at % 64 < 32);
    assert!(mask.labels.iter().enumerate().all(is_left));
    std::fs::write(&path, frames(2)).unwrap();
    let error = format!("{:#}", run(&capture, None, folder.path(), &params()).unwrap_err());
    assert!(error.contains("2 maps in one array for a video of"), "{error}");
}

/// Predictions of OSVOS and RVOS on DAVIS, with its palette: every index that numpy finds.
#[test]
fn real_palettes_keep_their_indices() {
    let Some(dir) = support::data("formats/outputs/masks/davis_palette") else { return };
    for (name, last) in [("osvos_judo_00000.png", 2), ("rvos_judo_00000.png", 20), ("cutie_judo_00000.png", 1)] {
        let image = MaskFile::read(&dir.join(name)).unwrap().labels;
        let found: BTreeSet<u8> = image.iter().copied().collect();
        assert_eq!(image.dimensions(), (854, 480));
        assert!(found.into_iter().eq(0..=last), "{name}");
    }
}

/// The mask of a video that is delivered with CoTracker is anti-aliased: it needs a threshold.
#[test]
fn a_real_soft_mask_needs_a_threshold() {
    let Some(dir) = support::data("formats/outputs/masks") else { return };
    let image = MaskFile::read(&dir.join("cotracker_apple_mask.png")).unwrap().levels;
    let share = |threshold: u8| {
        let inside = image.iter().map(|value| *value > threshold).collect();
        let mask = Mask { width: image.width(), height: image.height(), inside };
        mask.count() as f64 / mask.inside.len() as f64
    };
    eprintln!("{:.3} of the pixels above 0, {:.3} above 127", share(0), share(127));
    assert!(share(127) > 0.01 && share(0) > share(127));
}
