//! Captures with `poses_bounds.npy` next to single folders of images: LLFF and NVIDIA's Dynamic Scenes.

use std::path::Path;

use scene::Split;
use support::fakes::Fake;

use super::rigs::misfit_px;
use super::support::*;
use crate::recognise::read;
use crate::{Format, Params};

#[test]
fn photos_of_llff_are_a_static_capture() {
    let fake = Fake::small(9, 1);
    let dir = tempfile::tempdir().unwrap();
    fake.llff(dir.path());
    let capture = read(dir.path(), &Params::default()).unwrap();
    assert!(misfit_px(&fake, &capture) <= 1e-9);
    let test: Vec<&str> = capture.frames.iter().filter(|it| it.split == Split::Test).map(|it| &*it.name).collect();
    assert_eq!((test, capture.format), (vec!["IMG_0000", "IMG_0008"], Format::Llff));
    assert_eq!((capture.split_rule.as_str(), capture.time_rule.as_str()), ("1 of 8 images", "one instant"));
    assert!(run(dir.path(), &Params::default()).is_ok());
    std::fs::remove_file(dir.path().join("images/IMG_0003.png")).unwrap();
    assert_refused(dir.path(), &Params::default(), &["poses of 9 cameras, but there are 8"]);
}

#[test]
fn rows_belong_to_photos_in_the_order_of_text() {
    let fake = Fake::small(12, 1);
    let dir = tempfile::tempdir().unwrap();
    fake.llff(dir.path());
    let read_at = || read(dir.path(), &Params::default()).unwrap();
    let padded = read_at().frames[2].camera_from_world;
    for index in 0..12 {
        let path = |name: String| dir.path().join("images").join(name);
        std::fs::rename(path(format!("IMG_{index:04}.png")), path(format!("IMG_{index}.png"))).unwrap();
    }
    let capture = read_at();
    assert_eq!((capture.frames[2].name.as_str(), capture.frames[2].camera_from_world), ("IMG_10", padded));
    assert!(capture.warnings[0].contains("IMG_11.png comes before IMG_2.png"), "{:?}", capture.warnings);
}

/// The times, cameras and names of the frames, and the warnings.
fn timeline(dir: &Path, params: &Params) -> (Vec<(f64, u32, String)>, Vec<String>) {
    let capture = read(dir, params).unwrap();
    let times = capture.frames.into_iter().map(|frame| (frame.time_secs, frame.camera_index, frame.name));
    (times.collect(), capture.warnings)
}

#[test]
fn images_with_maps_of_a_video_are_its_frames() {
    let fake = Fake::small(12, 1);
    let dir = tempfile::tempdir().unwrap();
    fake.llff(dir.path());
    for index in 0..12 {
        let path = |name: String| dir.path().join("images").join(name);
        std::fs::rename(path(format!("IMG_{index:04}.png")), path(format!("IMG_{index}.png"))).unwrap();
    }
    let read_at = |static_scene| timeline(dir.path(), &Params { static_scene, fps: 10.0, ..Params::default() });
    let video: Vec<_> = (0..12).map(|index| (f64::from(index) / 10.0, 0, format!("IMG_{index}"))).collect();
    let (photos, warnings) = read_at(None);
    assert!(photos.iter().all(|(time, ..)| *time == 0.0) && photos[11].1 == 11, "{photos:?}");
    assert!(warnings.iter().any(|warning| warning.contains("set static = false")), "{warnings:?}");
    assert_eq!(read_at(Some(false)).0, video);
    assert_eq!((read_at(Some(true)).0, read_at(Some(true)).1.len()), (photos, 1));
    for maps in ["flow_i1", "flow", "motion_masks", "mv_masks"] {
        std::fs::create_dir(dir.path().join(maps)).unwrap();
        let (frames, warnings) = read_at(None);
        assert_eq!((frames, warnings.len()), (video.clone(), 1), "{maps}");
        assert!(read_at(Some(true)).0.iter().all(|(time, ..)| *time == 0.0), "{maps}");
        std::fs::remove_dir(dir.path().join(maps)).unwrap();
    }
}

#[test]
fn only_folders_with_a_size_are_copies() {
    let fake = Fake::small(4, 1);
    let dir = tempfile::tempdir().unwrap();
    fake.llff(dir.path());
    let folder_at = |width| {
        let image = read(dir.path(), &Params { width, ..Params::default() }).unwrap().frames.remove(0).image;
        image.parent().unwrap().file_name().unwrap().to_string_lossy().into_owned()
    };
    let larger = Fake { size: (48, 32), ..fake.clone() };
    larger.write_frames(|camera, _| dir.path().join(format!("images_colmap/IMG_{camera:04}.png")));
    fake.write_frames(|camera, _| dir.path().join(format!("images_1/IMG_{camera:04}.png")));
    let small = Fake { size: (12, 8), ..fake };
    small.write_frames(|camera, _| dir.path().join(format!("images_12x8/IMG_{camera:04}.png")));
    assert_eq!([None, Some(24), Some(12)].map(folder_at), ["images", "images", "images_12x8"]);
}

#[test]
fn smaller_copies_of_photos_are_read_for_their_width() {
    let fake = Fake::small(4, 1);
    let dir = tempfile::tempdir().unwrap();
    fake.llff(dir.path());
    std::fs::rename(dir.path().join("images"), dir.path().join("originals")).unwrap();
    let (small, large) = (Fake { size: (12, 8), ..fake.clone() }, Fake { size: (24, 16), ..fake });
    large.llff(dir.path());
    small.write_frames(|camera, _| dir.path().join(format!("images_2/IMG_{camera:04}.png")));
    let read_at = |width| read(dir.path(), &Params { width, ..Params::default() }).unwrap();
    assert_eq!(read_at(Some(12)).split_rule, "1 of 8 images, images at 1/2");
    assert_eq!(read_at(Some(13)).split_rule, "1 of 8 images");
    assert!(misfit_px(&small, &read_at(Some(12))) <= 1e-9 && misfit_px(&large, &read_at(None)) <= 1e-9);
}

#[test]
fn dynamic_scenes_are_tested_on_the_other_cameras() {
    let fake = Fake { cameras: 12, ..Fake::small(12, 13) };
    let dir = tempfile::tempdir().unwrap();
    fake.nvidia(dir.path());
    let capture = read(dir.path(), &Params::default()).unwrap();
    assert!(misfit_px(&fake, &capture) <= 1e-9);
    assert_eq!([capture.count(Split::Train), capture.count(Split::Test)], [13, 13 * 11]);
    assert_eq!(capture.format, Format::Nvidia);
    let train: Vec<u32> =
        capture.frames.iter().filter(|it| it.split == Split::Train).map(|it| it.camera_index).collect();
    assert_eq!(train, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 0]);
    assert!(run(dir.path(), &Params::default()).is_ok());
    let missing = dir.path().join("mv_images/00002/cam05.jpg");
    std::fs::remove_file(missing).unwrap();
    assert_refused(dir.path(), &Params::default(), &["the test view is missing", "00002"]);
}

#[test]
fn training_images_of_another_size_are_refused() {
    let fake = Fake::small(12, 12);
    let dir = tempfile::tempdir().unwrap();
    fake.nvidia(dir.path());
    let half = Fake { size: (12, 8), ..fake };
    std::fs::remove_dir_all(dir.path().join("mv_images")).unwrap();
    half.write_frames(|camera, frame| dir.path().join(format!("mv_images/{frame:05}/cam{:02}.jpg", camera + 1)));
    assert_refused(dir.path(), &Params::default(), &["24×16, but test views of 12×8", "set images"]);
    half.write_frames(|_, frame| dir.path().join(format!("images_12x8/{frame:05}.png")));
    let params = Params { images: Some("images_12x8".into()), ..Params::default() };
    assert!(run(dir.path(), &params).is_ok());
}

/// A real rig whose file states no depth bounds.
#[test]
fn zero_depth_bounds_are_none() {
    let Some(real) = support::data("formats/captures/llff-poses-bounds-rig/poses_bounds.npy") else { return };
    let dir = tempfile::tempdir().unwrap();
    std::fs::copy(real, dir.path().join("poses_bounds.npy")).unwrap();
    let image = image::RgbImage::new(640, 480);
    std::fs::create_dir(dir.path().join("images")).unwrap();
    (0..26).for_each(|index| image.save(dir.path().join(format!("images/{index:02}.png"))).unwrap());
    let capture = read(dir.path(), &Params { static_scene: Some(true), ..Params::default() }).unwrap();
    assert_eq!((capture.frames.len(), capture.warnings.len()), (26, 1));
    assert!(capture.problems().is_empty(), "{:?}", capture.problems());
}
