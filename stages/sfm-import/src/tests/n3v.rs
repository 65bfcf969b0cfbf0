//! Rigs of Neural 3D Video: poses, splits, times and sizes.

use std::path::Path;

use glam::DVec3;
use scene::ply::PlyFormat;
use scene::protocol::Preset;
use scene::{Camera, PointCloud, Split, facts};
use tempfile::TempDir;

use super::support::*;
use crate::recognise::read;
use crate::{Format, Params, Resize};

/// Points in front of all cameras.
const TARGETS: [DVec3; 3] = [DVec3::new(0.2, -0.1, 5.0), DVec3::new(-0.4, 0.3, 6.0), DVec3::new(0.5, 0.6, 4.5)];

/// Camera `index` of the rig. The world has y down and z into the scene.
fn camera(index: usize) -> Camera {
    let position = DVec3::new(0.8 * index as f64 - 0.5, 0.3 - 0.2 * index as f64, -0.1 * index as f64);
    Camera::look_at(intrinsics(), position, DVec3::new(0.1, 0.2, 5.0), DVec3::NEG_Y)
}

/// Arranges the axes of a camera (right, down, forward) as the columns of a stored rotation.
type Columns = fn(DVec3, DVec3, DVec3) -> [DVec3; 3];

const LLFF: Columns = |right, down, forward| [down, right, -forward];

/// The row of a camera in `poses_bounds.npy`.
fn row(camera: &Camera, columns: Columns) -> [f64; 17] {
    let pose = camera.camera_from_world.inverse();
    let [a, b, c] = columns(pose.rotation.x_axis, pose.rotation.y_axis, pose.rotation.z_axis);
    let (t, k) = (pose.translation, camera.intrinsics);
    let (height, width, focal) = (f64::from(k.height), f64::from(k.width), k.focal_x);
    [a.x, b.x, c.x, t.x, height, a.y, b.y, c.y, t.y, width, a.z, b.z, c.z, t.z, focal, 2.5, 40.0]
}

pub(crate) fn write_poses(dir: &Path, rows: &[[f64; 17]]) {
    write_npy(&dir.join("poses_bounds.npy"), &format!("({}, 17)", rows.len()), rows.as_flattened());
}

pub(crate) fn rows(count: usize) -> Vec<[f64; 17]> {
    (0..count).map(|index| row(&camera(index), LLFF)).collect()
}

/// A rig with `count` frames per camera; the blue channel is the index of the camera.
pub(crate) fn rig(names: &[&str], count: usize) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    write_poses(dir.path(), &rows(names.len()));
    for (index, name) in names.iter().enumerate() {
        let first = dir.path().join(name).join("images/0000.png");
        write_image(&first, index as u32);
        for frame in 1..count {
            std::fs::copy(&first, first.with_file_name(format!("{frame:04}.png"))).unwrap();
        }
    }
    dir
}

#[test]
fn other_rigs_in_this_layout_are_read_with_their_names() {
    for names in
        [["cam0", "cam1", "cam2"], ["cam_00", "cam_01", "cam_02"], ["camera_0001", "camera_0002", "camera_0003"]]
    {
        let dir = rig(&names, 2);
        let source = read(dir.path(), &Params::default()).unwrap();
        assert!(source.problems().is_empty() && source.camera_count() == 3);
        let test: Vec<&str> = source.frames.iter().filter(|it| it.split == Split::Test).map(|it| &*it.name).collect();
        assert_eq!(test, [format!("{}_0000", names[0]), format!("{}_0001", names[0])]);
        assert_eq!(source.split_rule, format!("camera {} held out, 2 frames", names[0]));
        assert!(source.warnings[0].starts_with("there is no cam00"), "{:?}", source.warnings);
    }
}

/// The scripts of 4DGaussians leave their models next to the files of the data set.
#[test]
fn models_made_from_a_data_set_are_not_a_second_capture() {
    for model in ["colmap/sparse/0", "sparse_"] {
        let (rig, video) = (rig(&["cam00", "cam01", "cam02"], 2), super::nerfies::capture(4, [0.0; 5]));
        for (dir, format) in [(rig, Format::N3v), (video, Format::Nerfies)] {
            let folder = dir.path().join(model);
            std::fs::create_dir_all(&folder).unwrap();
            ["cameras.txt", "images.txt"].iter().for_each(|name| std::fs::write(folder.join(name), "").unwrap());
            assert_eq!(read(dir.path(), &Params::default()).unwrap().format, format, "{model}");
        }
    }
}

#[test]
fn rows_follow_the_names_as_text() {
    let dir = rig(&["cam0", "cam10", "cam2"], 1);
    let source = read(dir.path(), &Params::default()).unwrap();
    assert!(source.warnings.iter().any(|it| it.contains("cam10 comes before cam2")), "{:?}", source.warnings);
    let second = source.frames.iter().find(|frame| frame.name == "cam10_0000").unwrap();
    assert!(
        (second.camera_from_world.inverse().translation - camera(1).camera_from_world.inverse().translation).length()
            < 1e-9
    );
}

pub(crate) const NAMES: [&str; 3] = ["cam00", "cam02", "cam10"];

/// The largest distance in pixels between projections by the original and by the imported cameras, for poses stored with
/// these columns.
fn misfit_px(columns: Columns) -> f64 {
    let dir = rig(&NAMES, 2);
    write_poses(dir.path(), &[0, 1, 2].map(|index| row(&camera(index), columns)));
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let misfits = capture.views.iter().flat_map(|view| {
        TARGETS.map(|point| {
            let expected = camera(view.camera_index as usize).project(point).unwrap();
            view.camera.project(point).map_or(f64::INFINITY, |found| found.0.distance(expected.0))
        })
    });
    misfits.fold(0.0, f64::max)
}

#[test]
fn poses_follow_the_convention_of_llff() {
    assert!(misfit_px(LLFF) <= 1e-9);
    let opencv: Columns = |right, down, forward| [right, down, forward];
    let opengl: Columns = |right, down, forward| [right, -down, -forward];
    let up_first: Columns = |right, down, forward| [-down, right, forward];
    for (name, columns) in [("OpenCV", opencv), ("OpenGL", opengl), ("up first", up_first)] {
        assert!(misfit_px(columns) >= 1.0, "the test does not detect the axes of {name}");
    }
    let dir = rig(&NAMES, 2);
    write_poses(dir.path(), &[0, 1, 2].map(|index| row(&camera(index), |x, y, z| [y, x, z])));
    insta::assert_snapshot!(refusal(dir.path(), &Params::default()));
}

/// A manually computed camera: at (2, 0, 1) in a world with z up, looking along x, so that right is −y.
#[test]
fn a_row_written_by_hand_is_read() {
    let dir = rig(&["cam00", "cam01"], 2);
    let down_right_back = [0.0, 0.0, -1.0, 2.0, 16.0, 0.0, -1.0, 0.0, 0.0, 24.0, -1.0, 0.0, 0.0, 1.0, 30.0, 1.0, 9.0];
    write_poses(dir.path(), &[down_right_back; 2]);
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    // 5 in front, 1 to the right, half above: (30 · 1 / 5 + 12, 30 · (−0.5) / 5 + 8).
    let (pixel, depth) = capture.views[0].camera.project(DVec3::new(7.0, -1.0, 1.5)).unwrap();
    assert!(pixel.distance(glam::DVec2::new(18.0, 5.0)) <= 1e-12 && depth == 5.0, "{pixel} at {depth}");
}

#[test]
fn a_rig_is_imported_with_its_split_times_and_points() {
    let dir = rig(&NAMES, 4);
    let cloud = PointCloud { positions: vec![[0.5, -1.0, 5.0]], colors: vec![[1, 2, 3]] };
    let other = PointCloud { colors: vec![[9; 3]], ..cloud.clone() };
    other.write_ply(&dir.path().join("points3D.ply"), PlyFormat::Ascii).unwrap();
    cloud.write_ply(&dir.path().join("points3D_downsample2.ply"), PlyFormat::BinaryLittleEndian).unwrap();
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    let names = |split| capture.views_of(split).map(|(_, view)| view.name.as_str()).collect::<Vec<_>>();
    assert_eq!(names(Split::Test), ["cam00_0000", "cam00_0001", "cam00_0002", "cam00_0003"]);
    assert_eq!(names(Split::Train)[..3], ["cam02_0000", "cam10_0000", "cam02_0001"]);
    assert_eq!((names(Split::Train).len(), names(Split::Val).len()), (8, 0));
    for view in &capture.views {
        let index = NAMES.iter().position(|name| view.name.starts_with(name)).unwrap();
        assert_eq!((view.camera_index, capture.load_image(view).unwrap()[(3, 2)][2]), (index as u32, index as u8));
        assert_eq!(view.time_secs, f64::from(view.frame_index) / 30.0);
    }
    assert_eq!((capture.time_map.start_secs, capture.time_map.end_secs), (0.0, 0.1));
    assert_eq!(capture.time_map.frame_secs, 1.0 / 30.0);
    assert_eq!(capture.load_points().unwrap().unwrap(), cloud);
    assert_eq!((capture.pose_source.as_str(), capture.protocol.split.as_str()), ("n3v", "camera 0 held out, 4 frames"));
    let known = crate::facts::of_capture(dir.path(), &Params::default());
    assert_eq!((known.count(facts::TIMES), known.flag(facts::POINTS)), (Some(4), Some(true)));
}

/// The generated scene differs from the named protocol only by its size.
#[test]
fn three_hundred_frames_have_the_named_protocol() {
    let dir = rig(&["cam00", "cam01"], 301);
    let params = Params { width: Some(12), resize: Some(Resize::Lanczos3), ..Params::default() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    assert_eq!((capture.views.len(), capture.time_map.end_secs), (600, 299.0 / 30.0));
    let preset = Preset::named("n3v-1352").unwrap().protocol();
    assert_eq!(capture.protocol.differences(&preset), ["size 12×8 instead of 1352×1014"]);
    let view = &capture.views[0];
    assert_eq!(view.camera, camera_of(&dir, view.camera_index).resized(12, 8));
    let source = read(dir.path(), &params).unwrap();
    assert!(source.warnings[0].contains("first 300 of 301"), "{:?}", source.warnings);
    let named = Params { protocol: "n3v-1352".into(), ..params };
    let mut refusals = Refusals::default();
    refusals.add(dir.path(), &named);
    for frame in 150..301 {
        let image = |name: &str| dir.path().join(format!("{name}/images/{frame:04}.png"));
        ["cam00", "cam01"].iter().for_each(|name| std::fs::remove_file(image(name)).unwrap());
    }
    refusals.add(dir.path(), &named);
    insta::assert_snapshot!(refusals.text());
}

/// The camera at native size, as read.
fn camera_of(dir: &TempDir, index: u32) -> Camera {
    let frames = frames(dir.path(), &Params::default());
    frames.iter().find(|frame| frame.camera_index == index).unwrap().camera().unwrap()
}

#[test]
fn cameras_are_scaled_to_smaller_images() {
    let dir = rig(&["cam00", "cam01"], 2);
    let twice = |index: usize| {
        let k = intrinsics();
        row(&camera(index).resized(2 * k.width, 2 * k.height), LLFF)
    };
    write_poses(dir.path(), &[twice(0), twice(1)]);
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!(capture.protocol.split, "camera 0 held out, 2 frames, images at 1/2");
    assert_eq!(capture.views[0].camera.intrinsics, intrinsics());
}

#[test]
fn frames_may_be_in_the_camera_folder_with_any_first_number() {
    let dir = rig(&NAMES, 1);
    for name in NAMES {
        let folder = dir.path().join(name);
        std::fs::remove_dir_all(folder.join("images")).unwrap();
        (8..11).for_each(|frame| write_image(&folder.join(format!("frame_{frame}.jpg")), frame));
    }
    let (_root, capture) = run(dir.path(), &Params::default()).unwrap();
    assert_eq!((capture.views.len(), capture.time_map.end_secs), (9, 2.0 / 30.0));
    let static_scene = Params { static_scene: Some(true), ..Params::default() };
    let (_root, capture) = run(dir.path(), &static_scene).unwrap();
    assert!(capture.views.iter().all(|view| view.time_secs == 0.0));
}

#[test]
fn a_single_frame_is_a_static_scene() {
    let (_root, capture) = run(rig(&NAMES, 1).path(), &Params::default()).unwrap();
    assert_eq!((capture.views.len(), capture.protocol.time.as_str()), (3, "one instant"));
}
