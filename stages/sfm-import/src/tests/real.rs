//! Real captures, where `PIPELINE_DATA` names their folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use scene::{Capture, Intrinsics, Split};

use super::support::run;
use crate::colmap::layout::sparse_dir;
use crate::colmap::model::Model;
use crate::colmap::read_model;
use crate::{Params, Resize, TestSplit};

/// The folder of a real capture, after printing its description; `None` if it is not available.
fn data(name: &str) -> Option<PathBuf> {
    let dir = support::data(name)?;
    eprintln!("{}", crate::inspect::inspect(&dir).unwrap().text());
    Some(dir)
}

fn counts(capture: &Capture) -> [usize; 3] {
    [Split::Train, Split::Val, Split::Test].map(|split| capture.views_of(split).count())
}

fn assert_orthonormal(capture: &Capture) {
    for view in &capture.views {
        let rotation = view.camera.camera_from_world.rotation;
        let residual = (rotation * rotation.transpose() - glam::DMat3::IDENTITY).to_cols_array();
        assert!(residual.iter().all(|value| value.abs() <= 1e-5), "{}", view.name);
    }
}

/// Names and train, val and test counts in `data-manifests/dnerf.toml`; `None` for a count that it does not state.
fn dnerf_manifest() -> Vec<(String, [Option<i64>; 3])> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data-manifests/dnerf.toml");
    let manifest: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
    let count = |scene: &toml::Value, split| scene.get(split).map(|count| count.as_integer().unwrap());
    let scene = |scene: &toml::Value| {
        (scene["name"].as_str().unwrap().to_owned(), ["train", "val", "test"].map(|split| count(scene, split)))
    };
    manifest["scene"].as_array().unwrap().iter().map(scene).collect()
}

#[test]
fn dnerf_scenes_have_the_counts_of_the_manifest() {
    let scenes = dnerf_manifest();
    assert_eq!(scenes.len(), 8);
    for (scene, expected) in scenes {
        let Some(dir) = data(&format!("dnerf/{scene}")) else { continue };
        let params = Params { width: Some(200), resize: Some(Resize::Area), ..Params::default() };
        let started = std::time::Instant::now();
        let (_root, capture) = run(&dir, &params).unwrap();
        eprintln!("{scene}: {} images at 200 px in {:.2?}", capture.views.len(), started.elapsed());
        for (found, stated) in counts(&capture).into_iter().zip(expected) {
            assert!(stated.is_none_or(|stated| stated == found as i64), "{scene}: {found} images, manifest {stated:?}");
        }
        assert_eq!((capture.time_map.start_secs, capture.time_map.end_secs), (0.0, 1.0));
        assert_orthonormal(&capture);
        for view in &capture.views {
            let focal = view.camera.intrinsics.focal_x;
            assert!((focal - 1111.111 / 4.0).abs() <= 1e-3, "{focal}");
            let radius = view.camera.position_world().length();
            assert!((radius - 4.031).abs() <= 2e-3, "{scene} {}: {radius}", view.name);
            assert!(view.camera.project(DVec3::ZERO).is_some(), "{} looks away", view.name);
        }
    }
    let Some(dir) = data("dnerf/lego") else { return };
    let params = Params { test_split: TestSplit::Val, width: Some(100), ..Params::default() };
    assert_eq!(counts(&run(&dir, &params).unwrap().1), [50, 0, 11]);
}

/// The share of the object's pixels in the first view that the visual hull of all training views covers.
fn hull_coverage(capture: &Capture, mirrored: bool) -> f64 {
    let views: Vec<_> = capture.views_of(Split::Train).map(|(_, view)| view).collect();
    let masks: Vec<_> = views.iter().map(|view| capture.load_alpha(view).unwrap().unwrap()).collect();
    let pixel = |view: &scene::View, point| {
        let (pixel, _) = view.camera.project(point)?;
        let Intrinsics { width, height, .. } = view.camera.intrinsics;
        let inside = pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < f64::from(width) && pixel.y < f64::from(height);
        let column = if mirrored { width - 1 - (pixel.x as u32).min(width - 1) } else { pixel.x as u32 };
        inside.then_some((column, pixel.y as u32))
    };
    let mut covered = image::GrayImage::new(masks[0].width(), masks[0].height());
    let cell = 2.6 / 80.0; // about half a pixel's footprint at the test's resolution
    for index in 0..80_u32.pow(3) {
        let position = [index % 80, index / 80 % 80, index / 6400].map(|i| -1.3 + (f64::from(i) + 0.5) * cell);
        let point = DVec3::from(position);
        let seen = views.iter().zip(&masks).filter(|(view, mask)| pixel(view, point).is_some_and(|at| mask[at][0] > 0));
        // Nine of ten views, because the shovel moves.
        if 10 * seen.count() >= 9 * views.len()
            && let Some(at) = pixel(views[0], point)
        {
            covered[at][0] = 255;
        }
    }
    let object = masks[0].pixels().zip(covered.pixels()).filter(|(mask, _)| mask[0] > 127);
    let (hits, all) = object.fold((0, 0), |(hits, all), (_, hull)| (hits + u32::from(hull[0] > 0), all + 1));
    f64::from(hits) / f64::from(all)
}

#[test]
fn silhouettes_of_lego_intersect_in_one_object() {
    let Some(dir) = data("dnerf/lego") else { return };
    let params = Params { width: Some(64), ..Params::default() };
    let (_root, capture) = run(&dir, &params).unwrap();
    let (coverage, mirrored) = (hull_coverage(&capture, false), hull_coverage(&capture, true));
    eprintln!(
        "the visual hull covers {:.1} % of the object; with mirrored images {:.1} %",
        100.0 * coverage,
        100.0 * mirrored
    );
    assert!(coverage >= 0.97, "{coverage}");
    assert!(mirrored <= 0.8, "the test does not detect mirrored images: {mirrored}");
}

/// For every point: the mean reprojection error of its track with the cameras of the capture, and the stored error.
fn reprojection_px(capture: &Capture, model: &Model) -> Vec<(f64, f64)> {
    let views: BTreeMap<&str, _> = capture.views.iter().map(|view| (view.name.as_str(), view)).collect();
    let point_errors = model.points.values().map(|point| {
        let distances = point.track.iter().map(|(image, at)| {
            let image = &model.images[image];
            let view = views[Path::new(&image.name).file_stem().unwrap().to_str().unwrap()];
            view.camera.project(point.position).unwrap().0.distance(image.observations[*at as usize].0)
        });
        (distances.sum::<f64>() / point.track.len() as f64, point.error_px)
    });
    point_errors.collect()
}

#[test]
fn reprojection_errors_agree_with_colmaps() {
    // COLMAP stored the errors of sceaux before its images were undistorted and reduced from a width of 2832 pixels.
    let sceaux = ("colmap_sceaux", [9, 0, 2], (1200, 885), 2832.0, true);
    let davis = ("davis_bmx-trees_colmap", [70, 0, 10], (432, 240), 432.0, false);
    for (name, expected, size, original_width, is_static) in [sceaux, davis] {
        let Some(dir) = data(name) else { continue };
        let params = Params { static_scene: Some(is_static), ..Params::default() };
        let (_root, capture) = run(&dir, &params).unwrap();
        assert_eq!(counts(&capture), expected, "{name}");
        assert_eq!((capture.protocol.width, capture.protocol.height), size);
        assert_orthonormal(&capture);
        let model = read_model(&sparse_dir(&dir).unwrap()).unwrap();
        let errors = reprojection_px(&capture, &model);
        let ours = errors.iter().map(|error| error.0).sum::<f64>() / errors.len() as f64;
        let stored = errors.iter().map(|error| error.1).sum::<f64>() / errors.len() as f64;
        eprintln!("{name}: {ours:.4} px with the imported cameras, {stored:.4} px stored, {} points", errors.len());
        let reduced = f64::from(size.0) / original_width;
        assert!((ours / (stored * reduced) - 1.0).abs() <= 0.03, "{name}: {ours} against {stored} · {reduced}");
        let mut ratios: Vec<f64> = errors.iter().map(|(ours, stored)| ours / (stored * reduced)).collect();
        ratios.sort_by(f64::total_cmp);
        let (low, high) = (ratios[ratios.len() / 20], ratios[ratios.len() * 19 / 20]);
        assert!(low >= 0.95 && high <= 1.05, "{name}: {low} to {high} times the stored error for 90 % of the points");
        let masks = capture.views.iter().filter(|view| view.mask.is_some()).count();
        assert_eq!(masks, if is_static { 0 } else { 80 });
        assert!(capture.load_points().unwrap().unwrap().len() == model.points.len());
    }
}

#[test]
fn a_model_with_other_images_is_refused() {
    let Some(dir) = data("n3dv_one_frame_5views/data") else { return };
    let message = super::support::refusal(&dir, &Params { static_scene: Some(true), ..Params::default() });
    assert!(message.contains("image file is missing"), "{message}");
}

/// Relative rotations of LLFF poses must agree with those of an independent reconstruction.
#[test]
fn poses_bounds_agree_with_colmap() {
    let Some(dir) = data("n3dv_one_frame_5views/data") else { return };
    let names = ["cam00", "cam03", "cam05", "cam08", "cam14"]; // images 1 to 5 and rows 0 to 4
    let rig = tempfile::tempdir().unwrap();
    std::fs::copy(dir.join("poses_bounds.npy"), rig.path().join("poses_bounds.npy")).unwrap();
    for (name, index) in names.iter().zip(1..) {
        std::fs::create_dir(rig.path().join(name)).unwrap();
        std::fs::copy(dir.join(format!("images_4/{index}.png")), rig.path().join(format!("{name}/0000.png"))).unwrap();
    }
    let (_root, capture) = run(rig.path(), &Params::default()).unwrap();
    assert_eq!(
        (counts(&capture), capture.protocol.split.as_str()),
        ([4, 0, 1], "camera 0 held out, 1 frames, images at 1/4")
    );
    assert_eq!((capture.protocol.width, capture.protocol.height), (676, 507));
    let ours = |name: &str| {
        let view = capture.views.iter().find(|view| view.name.starts_with(name)).unwrap();
        view.camera.camera_from_world.rotation
    };
    let model = read_model(&sparse_dir(&dir).unwrap()).unwrap();
    let colmap = |name: &str| {
        let file = format!("{}.jpg", name["cam".len()..].parse::<u32>().unwrap());
        model.images.values().find(|image| image.name == file).unwrap().camera_from_world().rotation
    };
    for name in &names[1..] {
        let turn = |rotation: &dyn Fn(&str) -> glam::DMat3| rotation(name) * rotation("cam00").transpose();
        let apart = |rotation: glam::DMat3| glam::DQuat::from_mat3(&rotation).to_axis_angle().1.to_degrees();
        let (turned, differs) = (apart(turn(&colmap)), apart(turn(&ours) * turn(&colmap).transpose()));
        eprintln!("{name} is rotated by {turned:.2}° against cam00; the two sources differ by {differs:.2}°");
        assert!(turned >= 5.0 && differs <= 1.0, "{name}: {differs}° of {turned}°");
    }
}

#[test]
fn nerfies_cameras_see_their_points() {
    let Some(dir) = data("davis_tennis_nerfies") else { return };
    let (_root, capture) = run(&dir, &Params::default()).unwrap();
    assert_eq!(counts(&capture), [53, 0, 17]);
    assert_orthonormal(&capture);
    assert_eq!(capture.views.iter().filter(|view| view.mask.is_some()).count(), 70);
    let points = capture.load_points().unwrap().unwrap();
    assert_eq!(points.len(), 4860);
    // The points were triangulated in this video: most are in front of every camera, and many are inside of each image.
    let share = |inside: bool| {
        let shares = capture.views.iter().map(|view| {
            let pixels = points.positions.iter().filter_map(|p| view.camera.project(DVec3::from(p.map(f64::from))));
            let size = glam::DVec2::new(432.0, 240.0);
            let found = pixels.filter(|(at, _)| !inside || (at.cmpge(glam::DVec2::ZERO) & at.cmplt(size)).all());
            found.count() as f64 / points.len() as f64
        });
        shares.fold(f64::INFINITY, f64::min)
    };
    eprintln!(
        "share of points in every view, at least: {:.2} in front of the camera, {:.2} inside of the image",
        share(false),
        share(true)
    );
    assert!(share(false) >= 0.99 && share(true) >= 0.2);
}

#[test]
fn dycheck_cameras_and_splits_are_read() {
    let Some(dir) = data("dycheck_paper_windmill/demo/datasets/iphone/paper-windmill") else { return };
    let (views, rule) = crate::nerfies::split_views(&dir).unwrap();
    let count = |split| views.iter().filter(|(_, of)| *of == split).count();
    assert_eq!((count(Split::Train), count(Split::Test), rule), (277, 419, "DyCheck"));
    let frame = crate::nerfies::scene_frame(&dir, &mut Vec::new()).unwrap();
    for (id, _) in &views {
        let (lens, pose) = crate::nerfies::files::camera(&dir.join(format!("camera/{id}.json")), &frame, 2).unwrap();
        pose.check().unwrap();
        assert_eq!((lens.intrinsics.width, lens.intrinsics.height), (360, 480));
        // The scene centre is in front of every camera, between the stated near and far planes.
        let depth = pose.translation.z;
        assert!((0.1..0.6).contains(&depth), "{id} sees the centre at depth {depth}");
    }
    // The images are not part of this data.
    let message = super::support::refusal(&dir, &Params::default());
    assert!(message.contains("no folder of images"), "{message}");
}
