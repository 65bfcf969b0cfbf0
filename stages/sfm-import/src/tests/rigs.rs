//! Rigs in the layouts of EasyVolcap, CMU Panoptic and Technicolor: poses, splits and times.

use std::path::Path;

use glam::{DMat3, DVec2, DVec3};
use scene::Split;
use support::fakes::Fake;

use super::support::*;
use crate::recognise::read;
use crate::source::SourceCapture;
use crate::{Format, Params};

/// Points in front of all cameras of a fake rig.
const TARGETS: [DVec3; 3] = [DVec3::new(0.2, -0.1, 0.5), DVec3::new(-0.4, 0.3, 0.0), DVec3::new(0.5, 0.6, -0.4)];

/// The largest distance in pixels between projections by the cameras of the fake and by the imported ones.
pub(super) fn misfit_px(fake: &Fake, capture: &SourceCapture) -> f64 {
    let misfits = capture.frames.iter().flat_map(|frame| {
        let (truth, found) = (fake.camera(frame.camera_index as usize), frame.camera().unwrap());
        TARGETS
            .map(|point| found.project(point).map_or(f64::INFINITY, |(pixel, _)| pixel.distance(truth.project(point))))
    });
    misfits.fold(0.0, f64::max)
}

/// Writes a fake into a new folder of this name, and reads it.
fn written(name: &str, write: impl FnOnce(&Path)) -> (tempfile::TempDir, std::path::PathBuf) {
    let root = tempfile::tempdir().unwrap();
    let dir = root.path().join(name);
    write(&dir);
    (root, dir)
}

/// The numbers of training and test views.
fn counts(capture: &SourceCapture) -> [usize; 2] {
    [Split::Train, Split::Test].map(|split| capture.count(split))
}

fn holding_out(cameras: &[&str]) -> Params {
    Params { test_cameras: cameras.iter().map(|name| (*name).to_owned()).collect(), ..Params::default() }
}

#[test]
fn easy_volcap_rigs_are_read_with_their_test_camera() {
    let fake = Fake::small(4, 3);
    let (_root, dir) = written("actor1_4", |dir| fake.easy_volcap(dir));
    let capture = read(&dir, &holding_out(&["02"])).unwrap();
    assert!(misfit_px(&fake, &capture) <= 1e-9, "{}", misfit_px(&fake, &capture));
    assert_eq!((counts(&capture), capture.format, capture.dataset), ([9, 3], Format::EasyVolcap, "enerf-outdoor"));
    assert_eq!(capture.split_rule, "camera 02 held out, 3 frames");
    assert!(capture.problems().is_empty(), "{:?}", capture.problems());
    let (_root, imported) = run(&dir, &holding_out(&["02"])).unwrap();
    assert_eq!(
        imported.views_of(Split::Test).map(|(_, view)| view.name.as_str()).collect::<Vec<_>>()[..2],
        ["02_0000", "02_0001"]
    );
    assert_eq!(
        read(&dir, &Params { every_nth: 2, ..Params::default() }).unwrap().split_rule,
        "1 of 2 cameras, 3 frames"
    );
    let window = Params { first_frame: Some(1), frame_count: Some(2), ..holding_out(&["02"]) };
    let capture = read(&dir, &window).unwrap();
    assert_eq!((counts(&capture), capture.split_rule.as_str()), ([6, 2], "camera 02 held out, 2 frames"));
    assert!(capture.frames[0].image.ends_with("000001.jpg") && capture.frames[0].time_secs == 0.0);
}

/// A manually computed camera: at (0, 0, −5) turned by 90° about y, so that it looks along −x with z to the right.
#[test]
fn an_opencv_file_written_by_hand_is_read() {
    let (_root, dir) = written("scene", |dir| Fake::small(2, 1).easy_volcap(dir));
    let lens = "%YAML:1.0\n---\nnames: [\"00\"]\nK_00: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 20., 0., 12.,\n       0., 40., 8., 0., 0., 1. ]\ndist_00: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ 0.1, 0., 0., 0., 0. ]\n";
    let pose = "%YAML:1.0\n---\nR_00: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 0., 1.5707963267948966, 0. ]\nT_00: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 5., 0., 0. ]\n";
    std::fs::write(dir.join("intri.yml"), lens).unwrap();
    std::fs::write(dir.join("extri.yml"), pose).unwrap();
    let frame = &read(&dir, &Params { every_nth: 0, ..Params::default() }).unwrap().frames[0];
    // 90° about y maps x to −z and z to x: (−2, 1, −4) becomes (−4 + 5, 1, 2).
    let view = frame.camera_from_world.apply(DVec3::new(-2.0, 1.0, -4.0));
    assert!(view.distance(DVec3::new(1.0, 1.0, 2.0)) <= 1e-12, "{view}");
    // On the plane z = 1: (0.5, 0.5), r² = 0.5, times 1 + 0.1 · 0.5.
    let pixel = frame.lens.pixel(view.truncate() / view.z);
    assert!(pixel.distance(DVec2::new(20.0 * 0.525 + 12.0, 40.0 * 0.525 + 8.0)) <= 1e-12, "{pixel}");
}

#[test]
fn faulty_calibrations_are_refused_with_the_camera() {
    type Fault = (&'static str, &'static str, &'static str);
    let faults: [Fault; 8] = [
        ("intri.yml", "K_01:", "K_09:"),
        ("extri.yml", "T_01:", "T_09:"),
        ("extri.yml", "rows: 3", "rows: 4"),
        ("extri.yml", "Rot_00", "Rot_01"),
        ("intri.yml", "\"01\"", "\"../01\""),
        ("intri.yml", "\"01\"", "\"05\""),
        ("intri.yml", "W_00: 24.", "W_00: 48."),
        ("intri.yml", "names:", "%names:"),
    ];
    let mut refusals = Refusals::default();
    for (file, from, to) in faults {
        let (_root, dir) = written("scene", |dir| Fake::small(2, 2).easy_volcap(dir));
        let text = std::fs::read_to_string(dir.join(file)).unwrap();
        assert!(text.contains(from), "{file} has no {from}");
        std::fs::write(dir.join(file), text.replacen(from, to, 1)).unwrap();
        refusals.add(&dir, &holding_out(&["00"]));
    }
    let (_root, dir) = written("scene", |dir| Fake::small(2, 2).easy_volcap(dir));
    refusals.add(&dir, &holding_out(&["08"]));
    refusals.add(&dir, &Params { frame_count: Some(9), ..holding_out(&["00"]) });
    std::fs::remove_file(dir.join("images/01/000001.jpg")).unwrap();
    refusals.add(&dir, &holding_out(&["00"]));
    insta::assert_snapshot!(refusals.text());
    let stale = Fake::small(2, 2);
    let (_root, dir) = written("scene", |dir| stale.easy_volcap(dir));
    let text = std::fs::read_to_string(dir.join("extri.yml")).unwrap();
    let (before, after) = text.split_once("R_01").unwrap();
    let (_, tail) = after.split_once("data:").unwrap();
    let turned =
        format!("{before}R_01: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 1., 0., 0. ]\nx: {tail}");
    std::fs::write(dir.join("extri.yml"), turned).unwrap();
    assert_refused(&dir, &holding_out(&["00"]), &["Rot_01 and R_01 are different rotations"]);
}

#[test]
fn panoptic_sports_have_the_official_split_and_points() {
    let fake = Fake::small(12, 3);
    let (_root, dir) = written("boxes", |dir| fake.panoptic_sports(dir));
    write_cloud(&dir.join("init_pt_cld.npz"));
    let capture = read(&dir, &Params::default()).unwrap();
    assert!(misfit_px(&fake, &capture) <= 1e-9);
    assert_eq!((counts(&capture), capture.format, capture.dataset), ([30, 6], Format::Panoptic, "cmu-panoptic"));
    assert_eq!(capture.split_rule, "official, 3 frames");
    assert_eq!(capture.points, [([0.5, -1.0, 2.0], [255, 128, 0])]);
    assert!(capture.problems().is_empty() && capture.warnings.is_empty(), "{:?}", capture.warnings);
    let test: Vec<&str> = capture.frames.iter().filter(|it| it.split == Split::Test).map(|it| &*it.name).collect();
    assert_eq!(test[..3], ["00_0000", "10_0000", "00_0001"]);
    assert!(run(&dir, &Params::default()).is_ok());
    let window = Params { first_frame: Some(1), frame_count: Some(1), ..Params::default() };
    assert_eq!(counts(&read(&dir, &window).unwrap()), [10, 2]);
}

/// The differences between the import of a small fake and the protocol of a long clip.
fn differences(capture: &scene::Capture, preset: &str) -> Vec<String> {
    capture.protocol.differences(&scene::protocol::Preset::named(preset).unwrap().protocol())
}

/// Fakes in the layouts of Table 8 of Phys4DGS, with the parameters of its recipe.
#[test]
fn rigs_of_long_clips_have_the_named_protocols() {
    let fake = Fake::small(9, 2);
    for (scene, camera, preset, count) in
        [("actor1_4", "08", "enerf-outdoor-1080", 1200), ("dance3", "05", "mobilestage-1080", 1600)]
    {
        let (_root, dir) = written(scene, |dir| fake.easy_volcap(dir));
        let (_root, capture) = run(&dir, &Params { frame_count: Some(2), ..holding_out(&[camera]) }).unwrap();
        let split =
            format!("split camera {camera} held out, 2 frames instead of camera {camera} held out, {count} frames");
        assert_eq!(differences(&capture, preset), [split, "size 24×16 instead of 1920×1080".into()]);
    }
    let (_root, dir) = written("box", |dir| Fake::small(31, 2).panoptic_studio(dir));
    let (_root, capture) = run(&dir, &holding_out(&["00_00", "00_10", "00_15", "00_30"])).unwrap();
    assert_eq!(differences(&capture, "cmu-panoptic-1080"), ["size 24×16 instead of 1920×1080"]);
}

/// One point in the shape of the data set.
pub(super) fn write_cloud(path: &Path) {
    use std::io::Write as _;
    let dir = tempfile::tempdir().unwrap();
    write_npy(&dir.path().join("data.npy"), "(1, 7)", &[0.5, -1.0, 2.0, 1.0, 0.5, 0.0, 1.0]);
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    archive.start_file("data.npy", zip::write::SimpleFileOptions::default()).unwrap();
    archive.write_all(&std::fs::read(dir.path().join("data.npy")).unwrap()).unwrap();
    archive.finish().unwrap();
}

#[test]
fn a_camera_is_held_out_whatever_the_numbers_of_cameras() {
    let (_root, dir) = written("boxes", |dir| Fake::small(4, 2).panoptic_sports(dir));
    std::fs::remove_file(dir.join("test_meta.json")).unwrap();
    let path = dir.join("train_meta.json");
    let mut meta: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let cameras = meta["fn"][0].as_array().unwrap().len();
    meta["cam_id"] = serde_json::json!(vec![(1..=cameras).collect::<Vec<_>>(); 2]);
    std::fs::write(&path, meta.to_string()).unwrap();
    let capture = read(&dir, &Params::default()).unwrap();
    let test: Vec<u32> =
        capture.frames.iter().filter(|frame| frame.split == Split::Test).map(|frame| frame.camera_index).collect();
    assert_eq!(test, [1, 1]);
}

#[test]
fn named_test_cameras_replace_those_of_the_test_file() {
    let (_root, dir) = written("boxes", |dir| Fake::small(4, 2).panoptic_sports(dir));
    let held_out = |cameras: &[&str]| {
        let test_cameras = cameras.iter().map(|name| name.to_string()).collect();
        let capture = read(&dir, &Params { test_cameras, ..Params::default() })?;
        let test = capture.frames.iter().filter(|frame| frame.split == Split::Test).map(|frame| frame.camera_index);
        let test: std::collections::BTreeSet<u32> = test.collect();
        crate::error::Result::Ok((test, capture.split_rule))
    };
    let (official, _) = held_out(&[]).unwrap();
    let (named, rule) = held_out(&["3"]).unwrap();
    assert!(!official.contains(&3) && named == [3].into() && rule.starts_with("camera 3 held out"), "{rule}");
    assert!(held_out(&["77"]).unwrap_err().message.contains("the test camera 77 is missing"));
}

#[test]
fn faulty_panoptic_files_are_refused() {
    let mut refusals = Refusals::default();
    let edits: [fn(&mut serde_json::Value); 5] = [
        |meta| meta["fn"][1][0] = "../../outside.jpg".into(),
        |meta| meta["k"][0] = serde_json::json!([]),
        |meta| meta["cam_id"][1][1] = meta["cam_id"][1][0].clone(),
        |meta| meta["k"][0][0][0][1] = 3.0.into(),
        |meta| meta["w"] = (-5).into(),
    ];
    for edit in edits {
        let (_root, dir) = written("boxes", |dir| Fake::small(3, 2).panoptic_sports(dir));
        let path = dir.join("train_meta.json");
        let mut meta = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        edit(&mut meta);
        std::fs::write(&path, meta.to_string()).unwrap();
        refusals.add(&dir, &Params::default());
    }
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn the_panoptic_studio_is_read_in_metres() {
    let fake = Fake::small(4, 3);
    let (_root, dir) = written("161029_sports1", |dir| fake.panoptic_studio(dir));
    let capture = read(&dir, &holding_out(&["00_00", "00_03"])).unwrap();
    assert!(misfit_px(&fake, &capture) <= 1e-9);
    assert_eq!((counts(&capture), capture.split_rule.as_str()), ([6, 6], "cameras 00_00 00_03 held out"));
    let window = Params { first_frame: Some(1), frame_count: Some(2), ..holding_out(&["00_00"]) };
    assert_eq!(read(&dir, &window).unwrap().split_rule, "camera 00_00 held out, 2 frames from 1 on");
    assert!(run(&dir, &holding_out(&["00_00"])).is_ok());
    std::fs::remove_dir_all(dir.join("hdImgs/00_02")).unwrap();
    let capture = read(&dir, &holding_out(&["00_00"])).unwrap();
    assert_eq!((capture.camera_count(), capture.warnings[0].as_str()), (3, "3 of 4 hd cameras have frames"));
}

#[test]
fn technicolor_holds_out_camera_10() {
    let fake = Fake::small(12, 2);
    let (_root, dir) = written("Birthday", |dir| fake.technicolor(dir));
    let capture = read(&dir, &Params::default()).unwrap();
    assert!(misfit_px(&fake, &capture) <= 1e-9);
    assert_eq!((counts(&capture), capture.split_rule.as_str()), ([22, 2], "camera 10 held out, 2 frames"));
    assert!(run(&dir, &Params::default()).is_ok());
    std::fs::rename(dir.join("Birthday_undist_00051_03.png"), dir.join("Birthday_00051_03.png")).unwrap();
    assert_refused(&dir, &Params::default(), &["distortion of its lens", "undistorted images of the release"]);
}

/// The undistorted release has no columns for the distortion.
#[test]
fn technicolors_undistorted_release_is_read() {
    let fake = Fake::small(12, 2);
    let (_root, dir) = written("Birthday", |dir| fake.technicolor(dir));
    let path = dir.join("cameras_parameters.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    let without_distortion = |line: &str| {
        let mut words: Vec<&str> = line.split(' ').collect();
        words.drain(5..7);
        words.join(" ") + "\n"
    };
    let short: String = text.lines().map(without_distortion).collect();
    assert!(short.starts_with("f cu cv ar sk qw qx qy qz tx ty tz\n"), "{short}");
    std::fs::write(&path, &short).unwrap();
    assert!(misfit_px(&fake, &read(&dir, &Params::default()).unwrap()) <= 1e-9);
    let long_line = text.lines().nth(3).unwrap();
    let mixed: Vec<&str> = short.lines().take(3).chain([long_line]).chain(short.lines().skip(4)).collect();
    std::fs::write(&path, mixed.join("\n")).unwrap();
    assert_refused(&dir, &Params::default(), &["line 4: 12 finite numbers are expected (f cu cv ar sk [d1 d2] qw"]);
}

/// Neither of these calibrations states the size of its images.
#[test]
fn images_of_another_size_than_the_calibrated_ones_are_refused() {
    type Layout = (&'static str, fn(&Fake, &Path));
    let layouts: [Layout; 2] = [("actor1_4", Fake::easy_volcap), ("Birthday", Fake::technicolor)];
    for ((name, write), (width, height)) in
        layouts.into_iter().flat_map(|layout| [(layout, (12, 8)), (layout, (48, 32))])
    {
        let (_root, dir) = written(name, |dir| write(&Fake::small(12, 2), dir));
        if let Ok(intri) = std::fs::read_to_string(dir.join("intri.yml")) {
            let states_size = |line: &&str| line.starts_with("H_") || line.starts_with("W_");
            let lines: Vec<&str> = intri.lines().filter(|line| !states_size(line)).collect();
            std::fs::write(dir.join("intri.yml"), lines.join("\n")).unwrap();
        }
        assert!(read(&dir, &Params::default()).is_ok());
        for file in walkdir::WalkDir::new(&dir).into_iter().flatten() {
            if let Ok(image) = image::open(file.path()) {
                image.thumbnail_exact(width, height).save(file.path()).unwrap();
            }
        }
        let size = format!("does not fit images of {width}×{height}");
        assert_refused(&dir, &Params::default(), &["(12.0, 8.0)", &size, "use the images that were calibrated"]);
    }
}

/// Mirrored poses and points keep their projections.
#[test]
fn a_left_handed_world_is_mirrored() {
    let fake = Fake::small(2, 1);
    let (_root, dir) = written("boxes", |dir| fake.panoptic_sports(dir));
    let path = dir.join("train_meta.json");
    let mut meta: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for row in meta["w2c"][0][0].as_array_mut().unwrap() {
        row[1] = (-row[1].as_f64().unwrap()).into(); // a world with y up
    }
    std::fs::write(&path, meta.to_string()).unwrap();
    std::fs::remove_file(dir.join("test_meta.json")).unwrap();
    let frame = &read(&dir, &Params { every_nth: 0, ..Params::default() }).unwrap().frames[0];
    let truth = fake.camera(1); // camera 0 is a test camera
    for point in TARGETS {
        let (pixel, _) = frame.camera().unwrap().project(point * DVec3::new(-1.0, -1.0, 1.0)).unwrap();
        assert!(pixel.distance(truth.project(point)) <= 1e-9, "{pixel}");
    }
}

/// The imported cameras of each layout see what the fake shows: the check would detect axes of another convention.
#[test]
fn transposed_rotations_are_noticed() {
    let fake = Fake::small(3, 1);
    let (_root, dir) = written("scene", |dir| fake.easy_volcap(dir));
    let mut capture = read(&dir, &holding_out(&["00"])).unwrap();
    assert!(misfit_px(&fake, &capture) <= 1e-9);
    for frame in &mut capture.frames {
        frame.camera_from_world.rotation = frame.camera_from_world.rotation.transpose();
    }
    assert!(misfit_px(&fake, &capture) > 0.1);
}

/// Rot and R of a real file are the same rotations, and its cameras surround what they look at.
#[test]
fn a_real_easymocap_calibration_surrounds_its_subject() {
    let Some(real) = support::data("formats/captures/easymocap-A-NeRF") else { return };
    let root = tempfile::tempdir().unwrap();
    for name in ["intri.yml", "extri.yml"] {
        std::fs::copy(real.join(name), root.path().join(name)).unwrap();
    }
    for camera in 2..=7 {
        let image = root.path().join(format!("images/{camera}/000000.jpg"));
        std::fs::create_dir_all(image.parent().unwrap()).unwrap();
        image::RgbImage::new(1920, 1080).save(image).unwrap();
    }
    let capture = read(root.path(), &Params { every_nth: 0, ..Params::default() }).unwrap();
    assert_eq!(capture.frames.len(), 6);
    let identity = |rotation: DMat3| (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
    for frame in &capture.frames {
        assert!(identity(frame.camera_from_world.rotation).iter().all(|value| value.abs() <= 1e-9));
        // The subject stands near the origin, about five metres away, inside the image.
        let (pixel, depth) = frame.camera().unwrap().project(DVec3::ZERO).unwrap();
        assert!(
            (2.0..12.0).contains(&depth) && pixel.min_element() > 0.0 && pixel.x < 1920.0 && pixel.y < 1080.0,
            "{pixel}"
        );
    }
}

/// The rig of a real file in the layout of Dynamic 3D Gaussians.
#[test]
fn a_real_panoptic_file_is_read() {
    let Some(real) = support::data("formats/captures/dynamic3dgs-train-meta/train_meta.json") else { return };
    let root = tempfile::tempdir().unwrap();
    std::fs::create_dir(root.path().join("ims")).unwrap();
    std::fs::copy(real, root.path().join("train_meta.json")).unwrap();
    let capture = read(root.path(), &Params { every_nth: 0, ..Params::default() }).unwrap();
    assert_eq!((capture.frames.len(), capture.camera_count()), (3 * 298, 3));
    assert!(capture.warnings.iter().any(|warning| warning.contains("left-handed")), "{:?}", capture.warnings);
    for frame in &capture.frames {
        assert!((frame.lens.intrinsics.center_x - 960.0).abs() < 40.0 && frame.camera_from_world.check().is_ok());
    }
}

/// The high-definition cameras of a real calibration of the Panoptic Studio look at the middle of the dome.
#[test]
fn a_real_panoptic_studio_looks_at_its_middle() {
    let Some(real) = support::data("formats/captures/panoptic-calibration/calibration.json") else { return };
    let root = tempfile::tempdir().unwrap();
    std::fs::copy(real, root.path().join("calibration_ultimatum.json")).unwrap();
    let blank = root.path().join("blank.jpg");
    image::RgbImage::new(1920, 1080).save(&blank).unwrap();
    for camera in 0..31 {
        let image = root.path().join(format!("hdImgs/00_{camera:02}/00_{camera:02}_00000000.jpg"));
        std::fs::create_dir_all(image.parent().unwrap()).unwrap();
        std::fs::hard_link(&blank, image).unwrap();
    }
    let capture = read(root.path(), &Params { every_nth: 0, ..Params::default() }).unwrap();
    assert_eq!(capture.frames.len(), 31);
    let cameras: Vec<scene::Camera> = capture.frames.iter().map(|frame| frame.camera().unwrap()).collect();
    let middle = scene::camera::common_view_volume(&cameras).unwrap().center_world;
    for camera in &cameras {
        let (pixel, depth) = camera.project(middle).unwrap();
        assert!((1.0..6.0).contains(&depth), "{depth} m from the middle of a dome of 5.5 m");
        assert!(pixel.distance(DVec2::new(960.0, 540.0)) < 700.0, "{pixel}");
    }
}
