use scene::{Split, TimeMap};

use super::support::*;
use crate::Params;
use crate::colmap::{Model, write};

#[test]
fn binary_and_text_files_read_back_equal() {
    let models: [(&str, &[f64]); 5] = [
        ("SIMPLE_PINHOLE", &[30.0, 12.0, 8.0]),
        ("PINHOLE", &[30.0, 31.0, 12.0, 8.0]),
        ("SIMPLE_RADIAL", &[30.0, 12.0, 8.0, 0.03]),
        ("RADIAL", &[30.0, 12.0, 8.0, 0.03, -0.01]),
        ("OPENCV", &[30.0, 31.0, 12.0, 8.0, 0.03, -0.01, 0.001, 0.002]),
    ];
    for (camera_model, params) in models {
        let workspace = Workspace::new(3, camera_model, params, |index| format!("my clip {index}.png"));
        let dir = tempfile::tempdir().unwrap();
        for (write, folder) in [(write::binary as fn(&_, &_, &_), "bin"), (write::text, "txt")] {
            let dir = dir.path().join(folder);
            write(&dir, &workspace.cameras, &workspace.model);
            let model = Model::read(&dir).unwrap();
            assert_eq!(model, workspace.model, "{camera_model} {folder}");
            let error = model.reprojection_error().unwrap().recomputed_px;
            assert!(error <= 1e-9, "{camera_model} {folder}: {error}");
        }
    }
}

#[test]
fn reprojection_error_notices_a_shifted_point() {
    let mut workspace = Workspace::video(4);
    workspace.model.points.get_mut(&3).unwrap().position.x += 0.05;
    let error = workspace.model.reprojection_error().unwrap();
    assert!(error.recomputed_px > 0.01 && error.stored_px == 0.0, "{error:?}");
}

#[test]
fn a_video_has_times_points_and_a_split() {
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
fn no_test_views_are_made_only_when_asked() {
    let dir = Workspace::video(5).write();
    let params = Params { every_nth: 0, val_count: Some(2), ..colmap_params() };
    let (_root, capture) = run(dir.path(), &params).unwrap();
    let counts = [Split::Train, Split::Val, Split::Test].map(|split| capture.views_of(split).count());
    assert_eq!(counts, [3, 2, 0]);
    assert_eq!(capture.protocol.split, "no test, 2 training views held out for validation");
    let single = Workspace::video(1).write();
    assert_refused(single.path(), &colmap_params(), &["the train split of", "is empty"]);
}

#[test]
fn text_models_import_as_binary_ones_do() {
    let workspace = Workspace::video(6);
    let dir = workspace.write();
    let (_root, from_binary) = run(dir.path(), &colmap_params()).unwrap();
    std::fs::remove_dir_all(dir.path().join("sparse")).unwrap();
    write::text(&dir.path().join("sparse"), &workspace.cameras, &workspace.model); // without the 0
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
    write::binary(&dir.path().join("sparse/0"), &workspace.cameras, &workspace.model);
    let source = crate::source::read(dir.path(), &colmap_params()).unwrap();
    assert_eq!(source.frames.iter().map(|frame| frame.frame_index).collect::<Vec<_>>(), [0, 1, 3, 4, 5, 6, 7]);
    assert_eq!(source.warnings, ["1 of 8 images have no pose and are left out"]);
    let strict = Params { min_registered_share: 0.9, ..colmap_params() };
    assert_refused(dir.path(), &strict, &["only 7 of 8 images (88 %) have a pose", "0002.png", "min_registered_share"]);
}

#[test]
fn folders_are_the_cameras_of_a_rig() {
    let workspace =
        Workspace::new(10, "SIMPLE_PINHOLE", &[30.0, 12.0, 8.0], |i| format!("cam{}/{}.png", i / 2, i % 2 + 9));
    let dir = workspace.write();
    let (_root, capture) = run(dir.path(), &colmap_params()).unwrap();
    assert_eq!(capture.protocol.split, "1 of 4 cameras");
    let test: Vec<&str> = capture.views_of(Split::Test).map(|(_, view)| view.name.as_str()).collect();
    assert_eq!(test, ["cam0_9", "cam4_9", "cam0_10", "cam4_10"], "9 comes before 10, cameras at equal times in order");
}

#[test]
fn photos_are_one_instant() {
    let dir = Workspace::video(6).write();
    let (_root, capture) = run(dir.path(), &Params { static_scene: true, ..colmap_params() }).unwrap();
    assert!(capture.views.iter().all(|view| view.time_secs == 0.0 && view.frame_index == 0));
    assert_eq!(capture.time_map.normalized(0.0), 0.0);
}

#[test]
fn distorted_images_are_undistorted_to_the_pinhole_that_is_declared() {
    let workspace =
        Workspace::new(4, "OPENCV", &[30.0, 31.0, 12.0, 8.0, 0.2, 0.05, 0.004, -0.003], |i| format!("{i}.png"));
    let dir = workspace.write();
    let (_root, capture) = run(dir.path(), &colmap_params()).unwrap();
    let lens = workspace.model.cameras[&1];
    let target = lens.undistorted().unwrap();
    assert!(target.focal_x > 30.0, "a pincushion image has to be cropped");
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
fn masks_of_the_right_size_are_labels() {
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
    let warnings = crate::source::read(dir.path(), &params).unwrap().warnings;
    assert_eq!(warnings, ["1 masks are not used: they have not the size of their images"]);
}

#[test]
fn models_without_poses_points_or_support_are_refused() {
    let refused =
        |workspace: &Workspace, parts: &[&str]| assert_refused(workspace.write().path(), &colmap_params(), parts);
    refused(&Workspace::video(0), &["no image is registered", "images.bin"]);
    let mut workspace = Workspace::video(3);
    workspace.model.images.get_mut(&2).unwrap().camera_id = 7;
    refused(&workspace, &["image 0001.png has camera 7, which does not exist"]);
    let mut workspace = Workspace::video(3);
    workspace.model.points.remove(&4);
    refused(&workspace, &["sees point 4, which does not exist", "one and the same model"]);
    let mut workspace = Workspace::video(3);
    workspace.model.points.get_mut(&4).unwrap().track.push((9, 0));
    refused(&workspace, &["point 4 is seen by keypoint 0 of image 9", "points3D.bin"]);
    let fisheye =
        Workspace::new(3, "OPENCV_FISHEYE", &[30.0, 30.0, 12.0, 8.0, 0.0, 0.0, 0.0, 0.0], |i| format!("{i}.png"));
    refused(&fisheye, &["camera model OPENCV_FISHEYE is not supported", "image_undistorter", "cameras.bin"]);
    let folding = Workspace::new(3, "SIMPLE_RADIAL", &[30.0, 12.0, 8.0, -40.0], |i| format!("{i}.png"));
    refused(&folding, &["folds the image over", "calibrate again", "sparse/0"]);
    let unheard = Workspace::new(3, "MIRROR_BALL", &[30.0, 30.0, 12.0, 8.0], |i| format!("{i}.png"));
    refused(&unheard, &["camera model number 99 is unknown"]);
    let dir = unheard.write();
    std::fs::remove_dir_all(dir.path().join("sparse/0")).unwrap();
    write::text(&dir.path().join("sparse/0"), &unheard.cameras, &unheard.model);
    assert_refused(dir.path(), &colmap_params(), &["line 2: camera model MIRROR_BALL is unknown", "cameras.txt"]);
}

#[test]
fn wrong_numbers_are_refused() {
    let refused = |edit: &dyn Fn(&mut Workspace), parts: &[&str]| {
        let mut workspace = Workspace::video(3);
        edit(&mut workspace);
        assert_refused(workspace.write().path(), &colmap_params(), parts);
    };
    refused(
        &|w| w.model.images.get_mut(&2).unwrap().quaternion[0] *= 1.5,
        &["rotation of 0001.png is a quaternion of length"],
    );
    refused(&|w| w.model.images.get_mut(&2).unwrap().quaternion[0] = f64::NAN, &["0001.png", "NaN"]);
    refused(&|w| w.model.images.get_mut(&3).unwrap().translation[1] = f64::NAN, &["0002", "not finite"]);
    refused(&|w| w.model.points.get_mut(&5).unwrap().position.y = f64::INFINITY, &["point 5 lies at", "inf"]);
    refused(&|w| w.cameras[0].params[0] = f64::NAN, &["a parameter of the camera is NaN"]);
    refused(&|w| w.cameras[0].params[1] = -5.0, &["focal lengths must be positive"]);
    refused(&|w| w.cameras[0].size = (48, 32), &["image is 24×16 where 48×32 is expected", "images"]);
}

#[test]
fn missing_and_foreign_images_are_refused() {
    let dir = Workspace::video(4).write();
    std::fs::remove_file(dir.path().join("images/0002.png")).unwrap();
    assert_refused(dir.path(), &colmap_params(), &["image file is missing", "images/0002.png"]);
    let outside = Workspace::new(3, "SIMPLE_PINHOLE", &[30.0, 12.0, 8.0], |i| format!("../{i}.png"));
    let dir = tempfile::tempdir().unwrap();
    write::binary(&dir.path().join("sparse/0"), &outside.cameras, &outside.model);
    assert_refused(dir.path(), &colmap_params(), &["leads out of the images' folder"]);
    let twice = Workspace::new(2, "SIMPLE_PINHOLE", &[30.0, 12.0, 8.0], |i| ["a b.png", "a_b.png"][i as usize].into());
    assert_refused(twice.write().path(), &Params::default(), &["would both be called a_b"]);
    for file in ["points3D.bin", "images.bin", "cameras.bin"] {
        let dir = Workspace::video(3).write();
        std::fs::remove_file(dir.path().join("sparse/0").join(file)).unwrap();
        assert_refused(dir.path(), &colmap_params(), &["cannot read the file", file.trim_end_matches("bin")]);
    }
}

#[test]
fn views_of_different_size_are_refused() {
    let mut workspace = Workspace::video(4);
    let params = vec![30.0, 12.0, 8.0];
    workspace.cameras.push(write::StatedCamera { id: 2, model: "SIMPLE_PINHOLE", size: (20, 16), params });
    workspace.model.images.get_mut(&3).unwrap().camera_id = 2;
    let dir = workspace.write();
    image::RgbImage::new(20, 16).save(dir.path().join("images/0002.png")).unwrap();
    assert_refused(dir.path(), &colmap_params(), &["views differ in size: 0000 is 24×16, 0002 is 20×16", "0002.png"]);
}

#[test]
fn truncated_text_names_its_line() {
    let workspace = Workspace::video(3);
    let dir = workspace.write();
    std::fs::remove_dir_all(dir.path().join("sparse/0")).unwrap();
    let sparse = dir.path().join("sparse/0");
    write::text(&sparse, &workspace.cameras, &workspace.model);
    let path = sparse.join("images.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.lines().take(4).collect::<Vec<_>>().join("\n")).unwrap();
    assert_refused(dir.path(), &colmap_params(), &["line 4", "the line of its keypoints is missing", "images.txt"]);
    std::fs::write(&path, text.replacen("0001.png", "", 1)).unwrap();
    assert_refused(dir.path(), &colmap_params(), &["line 4: the line ends too early"]);
    std::fs::write(&path, text.replacen(" 1 0000.png", " one 0000.png", 1)).unwrap();
    assert_refused(dir.path(), &colmap_params(), &["line 2: \"one\" is not a number"]);
}

#[test]
fn params_are_checked() {
    let keys = |params: Params| params.problems().into_iter().map(|problem| problem.key).collect::<Vec<_>>();
    let good = Params { source: "dnerf/lego".into(), ..Params::default() };
    assert_eq!(keys(good.clone()), [] as [&str; 0]);
    assert_eq!(keys(Params::default()), ["source"]);
    assert_eq!(keys(Params { source: "/data/lego".into(), ..good.clone() }), ["source"]);
    assert_eq!(keys(Params { width: Some(0), every_nth: 1, ..good.clone() }), ["width", "every_nth"]);
    assert_eq!(keys(Params { resize: Some(crate::params::Resize::Area), ..good.clone() }), ["resize"]);
    assert_eq!(keys(Params { fps: f64::NAN, min_registered_share: f64::NAN, ..good }), ["fps", "min_registered_share"]);
}
