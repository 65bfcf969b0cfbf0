//! COLMAP models: reading, times, splits, masks, and errors.

use std::path::Path;

use engine::{JobContext, Stage as _};
use image::{Rgba, RgbaImage};
use scene::{Split, TimeMap};
use tempfile::TempDir;

use super::colmap_files::{StatedCamera, write_binary, write_text};
use super::support::*;
use crate::colmap::read_model;
use crate::recognise::read;
use crate::{Params, Resize, SfmImport};

#[test]
fn binary_and_text_files_read_back_equal() {
    let models: [(&str, &[f64]); 13] = [
        ("SIMPLE_PINHOLE", &[30.0, 12.0, 8.0]),
        ("PINHOLE", &[30.0, 31.0, 12.0, 8.0]),
        ("SIMPLE_RADIAL", &[30.0, 12.0, 8.0, 0.03]),
        ("RADIAL", &[30.0, 12.0, 8.0, 0.03, -0.01]),
        ("OPENCV", &[30.0, 31.0, 12.0, 8.0, 0.03, -0.01, 0.001, 0.002]),
        ("OPENCV_FISHEYE", &[30.0, 31.0, 12.0, 8.0, 0.03, -0.01, 0.001, 0.002]),
        ("FULL_OPENCV", &[30.0, 31.0, 12.0, 8.0, 0.03, -0.01, 0.001, 0.002, 0.01, 0.02, 0.03, 0.04]),
        ("FOV", &[30.0, 31.0, 12.0, 8.0, 0.9]),
        ("SIMPLE_RADIAL_FISHEYE", &[30.0, 12.0, 8.0, 0.03]),
        ("RADIAL_FISHEYE", &[30.0, 12.0, 8.0, 0.03, -0.01]),
        ("THIN_PRISM_FISHEYE", &[30.0, 31.0, 12.0, 8.0, 0.03, -0.01, 0.001, 0.002, 0.01, 0.02, 0.03, 0.04]),
        ("SIMPLE_FISHEYE", &[30.0, 12.0, 8.0]),
        ("FISHEYE", &[30.0, 31.0, 12.0, 8.0]),
    ];
    for (camera_model, params) in models {
        let workspace = Workspace::new(3, camera_model, params, |index| format!("my clip {index}.png"));
        let dir = tempfile::tempdir().unwrap();
        for (write, folder) in [(write_binary as fn(&_, &_, &_), "bin"), (write_text, "txt")] {
            let dir = dir.path().join(folder);
            write(&dir, &workspace.cameras, &workspace.model);
            let model = read_model(&dir).unwrap();
            assert_eq!(model, workspace.model, "{camera_model} {folder}");
            let error = model.reprojection_error().unwrap().recomputed_px;
            assert!(error <= 1e-9, "{camera_model} {folder}: {error}");
        }
    }
}

#[test]
fn a_shifted_point_raises_the_reprojection_error() {
    let mut workspace = Workspace::video(4);
    workspace.model.points.get_mut(&3).unwrap().position.x += 0.05;
    let error = workspace.model.reprojection_error().unwrap();
    assert!(error.recomputed_px > 0.01 && error.stored_px == 0.0, "{error:?}");
}

#[test]
fn a_model_that_lost_its_scale_is_noticed() {
    let mut workspace = Workspace::video(4);
    assert_eq!(workspace.model.lost_scale(), None);
    // The second half of the video sees copies of the points in a world that is 10⁴ times smaller.
    let originals: Vec<_> = workspace.model.points.clone().into_iter().collect();
    for (id, mut point) in originals {
        point.position *= 1e-4;
        point.track.retain(|(image, _)| *image > 2);
        workspace.model.points.insert(10 + id, point);
        workspace.model.points.get_mut(&id).unwrap().track.retain(|(image, _)| *image <= 2);
    }
    for image in workspace.model.images.values_mut().skip(2) {
        image.translation = image.translation.map(|coordinate| 1e-4 * coordinate);
        image.observations.iter_mut().for_each(|(_, id)| *id = id.map(|id| 10 + id));
    }
    let factor = workspace.model.lost_scale().unwrap();
    assert!((8e3..=1.3e4).contains(&factor), "{factor}");
    assert!(workspace.model.reprojection_error().unwrap().recomputed_px < 1.0, "the images alone do not show it");
    let dir = workspace.write();
    assert!(crate::inspect::lost_scale(&dir.path().join("sparse/0")).is_some());
    assert_eq!(crate::inspect::lost_scale(dir.path()), None);
    let source = read(dir.path(), &colmap_params()).unwrap();
    assert!(source.warnings.iter().any(|warning| warning.contains("lost the scale")), "{:?}", source.warnings);
}

#[test]
fn a_video_is_imported_with_times_points_and_split() {
    let dir = Workspace::video(10).write();
    let (_root, capture) = run(dir.path(), &colmap_params()).unwrap();
    let names = |split| capture.views_of(split).map(|(_, view)| view.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(Split::Test), ["0000", "0004", "0008"]);
    assert_eq!((names(Split::Train).len(), names(Split::Val).len()), (7, 0));
    assert_eq!(capture.time_map, TimeMap { start_secs: 0.0, end_secs: 0.9, frame_secs: 0.1 });
    let expected =
        "colmap · 1 of 4 images split · 24×16 · resize none · none background · time sorted frame / (frames - 1)";
    assert!(capture.protocol.line().ends_with(expected), "{}", capture.protocol.line());
    let points = capture.load_points().unwrap().unwrap();
    assert_eq!((points.len(), points.colors[2]), (6, [3; 3]));
    for view in &capture.views {
        assert_eq!((view.time_secs, view.camera_index), (f64::from(view.frame_index) / 10.0, 0));
        let (pixel, _) = view.camera.project(glam::DVec3::ZERO).unwrap();
        assert!(pixel.distance(glam::DVec2::new(12.0, 8.0)) <= 1e-9, "{pixel}");
        assert!(view.alpha.is_none() && view.mask.is_none());
    }
}

#[test]
fn every_nth_zero_makes_no_test_views() {
    let dir = Workspace::video(5).write();
    let params = Params { every_nth: 0, val_count: Some(2), ..colmap_params() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    let counts = [Split::Train, Split::Val, Split::Test].map(|split| capture.views_of(split).count());
    assert_eq!(counts, [3, 2, 0]);
    assert_eq!(capture.protocol.split, "no test, 2 training views held out for validation");
    let single = Workspace::video(1).write();
    insta::assert_snapshot!(refusal(single.path(), &colmap_params()));
}

#[test]
fn text_and_binary_models_import_equally() {
    let workspace = Workspace::video(6);
    let dir = workspace.write();
    let (_root, from_binary) = run(dir.path(), &colmap_params()).unwrap();
    std::fs::remove_dir_all(dir.path().join("sparse")).unwrap();
    write_text(&dir.path().join("sparse"), &workspace.cameras, &workspace.model); // in `sparse` itself
    let (_root, from_text) = run(dir.path(), &colmap_params()).unwrap();
    assert_eq!(from_binary.views, from_text.views);
}

#[test]
fn images_without_a_pose_leave_a_gap_in_time() {
    let mut workspace = Workspace::video(8);
    let dir = workspace.write();
    workspace.model.images.remove(&3);
    for point in workspace.model.points.values_mut() {
        point.track.retain(|(image, _)| *image != 3);
    }
    write_binary(&dir.path().join("sparse/0"), &workspace.cameras, &workspace.model);
    let source = read(dir.path(), &colmap_params()).unwrap();
    assert_eq!(source.frames.iter().map(|frame| frame.frame_index).collect::<Vec<_>>(), [0, 1, 3, 4, 5, 6, 7]);
    assert_eq!(source.warnings, ["1 of 8 images have no pose and are skipped"]);
    let strict = Params { min_registered_share: 0.9, ..colmap_params() };
    insta::assert_snapshot!(refusal(dir.path(), &strict));
}

#[test]
fn sub_folders_are_the_cameras_of_a_rig() {
    let workspace =
        Workspace::new(10, "SIMPLE_PINHOLE", &[30.0, 12.0, 8.0], |i| format!("cam{}/{}.png", i / 2, i % 2 + 9));
    let dir = workspace.write();
    let (_root, capture) = run(dir.path(), &colmap_params()).unwrap();
    assert_eq!(capture.protocol.split, "1 of 4 cameras");
    let test: Vec<&str> = capture.views_of(Split::Test).map(|(_, view)| view.name.as_str()).collect();
    assert_eq!(
        test,
        ["cam0_9", "cam4_9", "cam0_10", "cam4_10"],
        "9 precedes 10, and cameras at equal times are in order"
    );
}

#[test]
fn fixed_cameras_next_to_a_moving_one_are_test_views() {
    let name = |index: u32| match index {
        0..12 => format!("0_{index:05}.png"),
        _ => format!("{}_{:05}.png", 1 + (index - 12) / 3, 4 * (index % 3)),
    };
    let mut workspace = Workspace::new(18, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], name);
    for camera in [13, 16] {
        let fixed = workspace.model.images[&camera].clone();
        for id in camera + 1..camera + 3 {
            let image = workspace.model.images.get_mut(&id).unwrap();
            (image.quaternion, image.translation) = (fixed.quaternion, fixed.translation);
        }
    }
    let dir = workspace.write();
    let source = read(dir.path(), &colmap_params()).unwrap();
    let is_test = |frame: &crate::source::Frame| frame.split == Split::Test;
    assert_eq!((source.count(Split::Test), source.split_rule.as_str()), (6, "fixed cameras held out"));
    assert!(source.frames.iter().all(|frame| is_test(frame) == (frame.camera_index > 0)));
    let late = source.frames.iter().find(|frame| frame.name == "2_00008").unwrap();
    assert_eq!((late.frame_index, late.time_secs), (8, 0.8));
    assert!(source.problems().is_empty(), "{:?}", source.problems());
    let fixed = read(dir.path(), &Params { static_scene: Some(true), ..colmap_params() }).unwrap();
    assert_eq!(fixed.split_rule, "1 of 4 images");
}

#[test]
fn deleted_frames_cause_a_warning() {
    let name = |index: u32| format!("frame_{:04}.jpg", if index < 4 { 1 + index } else { 16 + index });
    let dir = Workspace::new(8, "PINHOLE", &[30.0, 31.0, 12.0, 8.0], name).write();
    let warned =
        |static_scene| read(dir.path(), &Params { static_scene, ..colmap_params() }).unwrap().warnings.join("; ");
    assert!(warned(None).contains("frame_0020.jpg is 16.0 usual steps after frame_0004.jpg"), "{}", warned(None));
    assert_eq!(warned(Some(true)), "");
    for number in 5..20 {
        write_image(&dir.path().join(format!("images/frame_{number:04}.jpg")), number);
    }
    let found = read(dir.path(), &Params { min_registered_share: 0.0, ..colmap_params() }).unwrap();
    assert_eq!(found.frames[4].frame_index, 19);
    assert_eq!(found.warnings, ["15 of 23 images have no pose and are skipped"]);
}

#[test]
fn photos_of_a_static_scene_are_one_instant() {
    let dir = Workspace::video(6).write();
    let (_root, capture) = run(dir.path(), &Params { static_scene: Some(true), ..colmap_params() }).unwrap();
    assert!(capture.views.iter().all(|view| view.time_secs == 0.0 && view.frame_index == 0));
    assert_eq!(capture.time_map.normalized(0.0), 0.0);
}

#[test]
fn distorted_images_are_undistorted_to_the_declared_pinhole() {
    let workspace =
        Workspace::new(4, "OPENCV", &[30.0, 31.0, 12.0, 8.0, 0.2, 0.05, 0.004, -0.003], |i| format!("{i}.png"));
    let dir = workspace.write();
    let (_root, capture) = run(dir.path(), &colmap_params()).unwrap();
    let lens = workspace.model.cameras[&1];
    let target = lens.undistorted().unwrap();
    assert!(target.focal_x > 30.0, "pincushion distortion needs a crop");
    for view in &capture.views {
        assert_eq!(view.camera.intrinsics, target);
        let image = capture.load_image(view).unwrap();
        for (column, row, pixel) in image.enumerate_pixels() {
            // The generated images are ramps: 10 (x − ½) in red and 15 (y − ½) in green.
            let seen = lens.pixel(crate::lens::plane_point(&target, column, row));
            let expected = [10.0 * (seen.x - 0.5), 15.0 * (seen.y - 0.5)];
            let error = (0..2).map(|c| (f64::from(pixel[c]) - expected[c]).abs()).fold(0.0, f64::max);
            assert!(error <= 0.501, "{error} at ({column}, {row})");
        }
    }
}

#[test]
fn masks_of_the_images_size_become_labels() {
    let dir = Workspace::video(4).write();
    for index in 0..3 {
        write_mask(&dir.path().join(format!("masks/{index:04}.png")), (WIDTH, HEIGHT), 255);
    }
    write_mask(&dir.path().join("masks/0003.png"), (WIDTH / 2, HEIGHT), 255);
    let params = Params { width: Some(12), ..colmap_params() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    assert_eq!(capture.class_names, ["object"]);
    let view = capture.views.iter().find(|view| view.name == "0001").unwrap();
    let mask = capture.load_mask(view).unwrap().unwrap();
    assert_eq!(mask.labels[..12], [0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1]);
    assert!(capture.views.iter().find(|view| view.name == "0003").unwrap().mask.is_none());
    let warnings = read(dir.path(), &params).unwrap().warnings;
    assert_eq!(warnings, ["1 masks are skipped: their size differs from that of their image"]);
}

/// A video of 4 images with masks that `paint` paints, column by column; `suffix` follows the stem of an image in their names.
fn with_masks(suffix: &str, paint: impl Fn(u32, u32) -> [u8; 4]) -> TempDir {
    let dir = Workspace::video(4).write();
    std::fs::create_dir_all(dir.path().join("masks")).unwrap();
    for index in 0..4 {
        let path = dir.path().join(format!("masks/{index:04}{suffix}"));
        RgbaImage::from_fn(WIDTH, HEIGHT, |x, y| Rgba(paint(x, y))).save(path).unwrap();
    }
    dir
}

/// The labels of a row of the first view, and the warnings.
fn labels_and_warnings(dir: &Path) -> (Vec<u8>, String) {
    let root = tempfile::tempdir().unwrap();
    let mut context = JobContext::detached(root.path()).unwrap();
    context.sources.insert("source".into(), dir.into());
    let capture = SfmImport::run(&context, &colmap_params()).unwrap().0;
    let labels = capture.load_mask(&capture.views[0]).unwrap().unwrap().labels;
    let warnings = context.measurements.borrow()["warnings"].to_string();
    (labels[..WIDTH as usize].to_vec(), warnings)
}

#[test]
fn masks_that_colmap_reads_are_inverted() {
    let white = |is_set: bool| if is_set { [255; 4] } else { [0, 0, 0, 255] };
    let first_columns = |count: u32| (0..WIDTH).map(|x| u8::from(x < count)).collect::<Vec<_>>();
    let keep = |x: u32, _: u32| white(x >= 6);
    let (labels, warnings) = labels_and_warnings(with_masks(".png.png", keep).path());
    assert_eq!(labels, first_columns(6));
    assert!(warnings.contains("0000.png.png, and most of their pixels are set"), "{warnings}");
    // Half of the pixels are not most of them.
    let (labels, warnings) = labels_and_warnings(with_masks(".png.png", |x, _| white(x < 12)).path());
    assert_eq!(labels, first_columns(12));
    assert!(warnings.contains("0000.png.png, but set pixels count as moving"), "{warnings}");
    let (labels, warnings) = labels_and_warnings(with_masks(".png", keep).path());
    assert_eq!(labels[..8], [0, 0, 0, 0, 0, 0, 1, 1]);
    assert!(!warnings.contains("masks are named"), "{warnings}");
    assert!(warnings.contains("most pixels of the masks are set, e.g. of 000"), "{warnings}");
}

#[test]
fn masks_of_any_colour_and_cut_outs_become_labels() {
    let from_half: Vec<u8> = (0..WIDTH).map(|x| u8::from(x >= 12)).collect();
    let red = |x: u32, _: u32| [if x == 23 { 128 } else { (x * 128 / 24) as u8 }, 0, 0, 255];
    assert_eq!(labels_and_warnings(with_masks(".png", red).path()).0, from_half);
    let cut_out = |x: u32, y: u32| [(10 * x) as u8, (15 * y) as u8, 90, if x < 12 { 0 } else { 255 }];
    assert_eq!(labels_and_warnings(with_masks(".png", cut_out).path()).0, from_half);
}

#[test]
fn empty_masks_cause_a_warning() {
    let (labels, warnings) = labels_and_warnings(with_masks(".png", |_, _| [0, 0, 0, 255]).path());
    assert!(labels.iter().all(|label| *label == 0));
    assert!(warnings.contains("all masks are empty, e.g. 000"), "{warnings}");
    let (_, warnings) = labels_and_warnings(with_masks(".png", |x, _| [(x % 2) as u8, 0, 0, 255]).path());
    assert!(!warnings.contains("empty"), "{warnings}");
}

#[test]
fn unusable_models_are_refused() {
    let mut refusals = Refusals::default();
    let mut add = |workspace: &Workspace| refusals.add(workspace.write().path(), &colmap_params());
    add(&Workspace::video(0));
    let mut workspace = Workspace::video(3);
    workspace.model.images.get_mut(&2).unwrap().camera_id = 7;
    add(&workspace);
    let mut workspace = Workspace::video(3);
    workspace.model.points.remove(&4);
    add(&workspace);
    let mut workspace = Workspace::video(3);
    workspace.model.points.get_mut(&4).unwrap().track.push((9, 0));
    add(&workspace);
    let eucm = [30.0, 30.0, 12.0, 8.0, 0.5, 1.0];
    add(&Workspace::new(3, "EUCM", &eucm, |i| format!("{i}.png")));
    add(&Workspace::new(3, "SIMPLE_RADIAL", &[30.0, 12.0, 8.0, -40.0], |i| format!("{i}.png")));
    let unknown = Workspace::new(3, "MIRROR_BALL", &[30.0, 30.0, 12.0, 8.0], |i| format!("{i}.png"));
    add(&unknown);
    let dir = unknown.write();
    std::fs::remove_dir_all(dir.path().join("sparse/0")).unwrap();
    write_text(&dir.path().join("sparse/0"), &unknown.cameras, &unknown.model);
    refusals.add(dir.path(), &colmap_params());
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn wrong_numbers_are_refused() {
    let mut refusals = Refusals::default();
    let mut add = |edit: &dyn Fn(&mut Workspace)| {
        let mut workspace = Workspace::video(3);
        edit(&mut workspace);
        refusals.add(workspace.write().path(), &colmap_params());
    };
    add(&|w| w.model.images.get_mut(&2).unwrap().quaternion = [2.0, 0.0, 0.0, 0.0]);
    add(&|w| w.model.images.get_mut(&2).unwrap().quaternion[0] = f64::NAN);
    add(&|w| w.model.images.get_mut(&3).unwrap().translation[1] = f64::NAN);
    add(&|w| w.model.points.get_mut(&5).unwrap().position = glam::DVec3::new(1.0, f64::INFINITY, 2.0));
    add(&|w| w.model.points.get_mut(&5).unwrap().position = glam::DVec3::new(1.0, 1e39, 2.0));
    add(&|w| w.cameras[0].params[0] = f64::NAN);
    add(&|w| w.cameras[0].params[1] = -5.0);
    add(&|w| w.cameras[0].size = (48, 32));
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn missing_and_foreign_files_are_refused() {
    let mut refusals = Refusals::default();
    let dir = Workspace::video(4).write();
    std::fs::remove_file(dir.path().join("images/0002.png")).unwrap();
    refusals.add(dir.path(), &colmap_params());
    let outside = Workspace::new(3, "SIMPLE_PINHOLE", &[30.0, 12.0, 8.0], |i| format!("../{i}.png"));
    let dir = tempfile::tempdir().unwrap();
    write_binary(&dir.path().join("sparse/0"), &outside.cameras, &outside.model);
    refusals.add(dir.path(), &colmap_params());
    for file in ["images.bin", "cameras.bin"] {
        let dir = Workspace::video(3).write();
        std::fs::remove_file(dir.path().join("sparse/0").join(file)).unwrap();
        refusals.add(dir.path(), &colmap_params());
    }
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn views_of_different_size_are_refused() {
    let mut workspace = Workspace::video(4);
    let params = vec![30.0, 12.0, 8.0];
    workspace.cameras.push(StatedCamera { id: 2, model: "SIMPLE_PINHOLE", size: (20, 16), params });
    workspace.model.images.get_mut(&3).unwrap().camera_id = 2;
    let dir = workspace.write();
    image::RgbImage::new(20, 16).save(dir.path().join("images/0002.png")).unwrap();
    insta::assert_snapshot!(refusal(dir.path(), &colmap_params()));
}

#[test]
fn damaged_text_files_are_refused_with_the_line() {
    let workspace = Workspace::video(3);
    let dir = workspace.write();
    std::fs::remove_dir_all(dir.path().join("sparse/0")).unwrap();
    let sparse = dir.path().join("sparse/0");
    write_text(&sparse, &workspace.cameras, &workspace.model);
    let path = sparse.join("images.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    let damaged = [
        text.lines().take(4).collect::<Vec<_>>().join("\n"),
        text.replacen("0001.png", "", 1),
        text.replacen(" 1 0000.png", " one 0000.png", 1),
    ];
    let mut refusals = Refusals::default();
    for damaged in damaged {
        std::fs::write(&path, damaged).unwrap();
        refusals.add(dir.path(), &colmap_params());
    }
    insta::assert_snapshot!(refusals.text());
}

#[test]
fn wrong_params_are_reported_by_key() {
    let keys = |params: Params| params.problems().into_iter().map(|problem| problem.key).collect::<Vec<_>>();
    let good = Params { source: "dnerf/lego".into(), ..Params::default() };
    assert_eq!(keys(good.clone()), [] as [&str; 0]);
    assert_eq!(keys(Params::default()), ["source"]);
    assert_eq!(keys(Params { source: "/data/lego".into(), ..good.clone() }), ["source"]);
    assert_eq!(keys(Params { width: Some(0), every_nth: 1, ..good.clone() }), ["width", "every_nth"]);
    assert_eq!(keys(Params { resize: Some(Resize::Area), ..good.clone() }), ["resize"]);
    assert_eq!(keys(Params { fps: f64::NAN, min_registered_share: f64::NAN, ..good }), ["fps", "min_registered_share"]);
}
