//! Real captures, where `PIPELINE_DATA` names a folder that holds them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use scene::{Capture, Intrinsics, Split};

use super::support::run;
use crate::Params;
use crate::colmap::{Model, layout::sparse_dir};
use crate::params::{Resize, TestSplit};

/// The folder of a real capture; says so where there is none.
fn data(name: &str) -> Option<PathBuf> {
    let dir = needs::data(name)?;
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

/// Names and train, val and test counts of `data-manifests/dnerf.toml`; `None` where it states none.
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

/// The share of the object's pixels in the first view that its visual hull over all training views covers.
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
        // Nine of ten: the shovel moves.
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
fn silhouettes_agree_on_one_object() {
    let Some(dir) = data("dnerf/lego") else { return };
    let params = Params { width: Some(64), ..Params::default() };
    let (_root, capture) = run(&dir, &params).unwrap();
    let (coverage, mirrored) = (hull_coverage(&capture, false), hull_coverage(&capture, true));
    eprintln!(
        "visual hull covers {:.1} % of the object, of mirrored images {:.1} %",
        100.0 * coverage,
        100.0 * mirrored
    );
    assert!(coverage >= 0.97, "{coverage}");
    assert!(mirrored <= 0.8, "the test does not notice mirrored images: {mirrored}");
}

/// Of every point: mean reprojection error of its track through the cameras of the capture, and the stored error.
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
fn colmap_captures_reproject_as_colmap_says() {
    // COLMAP stored the errors of sceaux before the images were undistorted and reduced from 2832 pixels per row.
    let sceaux = ("colmap_sceaux", [9, 0, 2], (1200, 885), 2832.0, true);
    let davis = ("davis_bmx-trees_colmap", [70, 0, 10], (432, 240), 432.0, false);
    for (name, expected, size, original_width, is_static) in [sceaux, davis] {
        let Some(dir) = data(name) else { continue };
        let params = Params { static_scene: is_static, ..Params::default() };
        let (_root, capture) = run(&dir, &params).unwrap();
        assert_eq!(counts(&capture), expected, "{name}");
        assert_eq!((capture.protocol.width, capture.protocol.height), size);
        assert_orthonormal(&capture);
        let model = Model::read(&sparse_dir(&dir).unwrap()).unwrap();
        let errors = reprojection_px(&capture, &model);
        let ours = errors.iter().map(|error| error.0).sum::<f64>() / errors.len() as f64;
        let stored = errors.iter().map(|error| error.1).sum::<f64>() / errors.len() as f64;
        eprintln!("{name}: {ours:.4} px through our cameras, {stored:.4} px stored, {} points", errors.len());
        let reduced = f64::from(size.0) / original_width;
        assert!((ours / (stored * reduced) - 1.0).abs() <= 0.03, "{name}: {ours} against {stored} · {reduced}");
        let mut ratios: Vec<f64> = errors.iter().map(|(ours, stored)| ours / (stored * reduced)).collect();
        ratios.sort_by(f64::total_cmp);
        let (low, high) = (ratios[ratios.len() / 20], ratios[ratios.len() * 19 / 20]);
        assert!(low >= 0.95 && high <= 1.05, "{name}: point by point {low} to {high} times the stored error");
        let masks = capture.views.iter().filter(|view| view.mask.is_some()).count();
        assert_eq!(masks, if is_static { 0 } else { 80 });
        assert!(capture.load_points().unwrap().unwrap().len() == model.points.len());
    }
}

#[test]
fn wrong_images_beside_a_model_are_refused() {
    let Some(dir) = data("n3dv_one_frame_5views/data") else { return };
    let message = super::support::refusal(&dir, &Params { static_scene: true, ..Params::default() });
    assert!(message.contains("image file is missing"), "{message}");
}

/// Poses of LLFF beside an independent reconstruction: how the cameras are turned against each other must agree.
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
    let model = Model::read(&sparse_dir(&dir).unwrap()).unwrap();
    let colmap = |name: &str| {
        let file = format!("{}.jpg", name["cam".len()..].parse::<u32>().unwrap());
        model.images.values().find(|image| image.name == file).unwrap().camera_from_world().rotation
    };
    for name in &names[1..] {
        let turn = |rotation: &dyn Fn(&str) -> glam::DMat3| rotation(name) * rotation("cam00").transpose();
        let apart = |rotation: glam::DMat3| glam::DQuat::from_mat3(&rotation).to_axis_angle().1.to_degrees();
        let (turned, differs) = (apart(turn(&colmap)), apart(turn(&ours) * turn(&colmap).transpose()));
        eprintln!("{name} is turned by {turned:.2}°, differently by {differs:.2}°");
        assert!(turned >= 5.0 && differs <= 1.0, "{name}: {differs}° of {turned}°");
    }
}

#[test]
fn a_nerfies_capture_sees_its_points() {
    let Some(dir) = data("davis_tennis_nerfies") else { return };
    let (_root, capture) = run(&dir, &Params::default()).unwrap();
    assert_eq!(counts(&capture), [53, 0, 17]);
    assert_orthonormal(&capture);
    assert_eq!(capture.views.iter().filter(|view| view.mask.is_some()).count(), 70);
    let points = capture.load_points().unwrap().unwrap();
    assert_eq!(points.len(), 4860);
    // Triangulated in this video, every point is in front of most cameras, and many are inside of each image.
    let share = |inside: bool| {
        let shares = capture.views.iter().map(|view| {
            let pixels = points.positions.iter().filter_map(|p| view.camera.project(DVec3::from(p.map(f64::from))));
            let size = glam::DVec2::new(432.0, 240.0);
            let found = pixels.filter(|(at, _)| !inside || (at.cmpge(glam::DVec2::ZERO) & at.cmplt(size)).all());
            found.count() as f64 / points.len() as f64
        });
        shares.fold(f64::INFINITY, f64::min)
    };
    eprintln!("seen by every view: {:.2} in front, {:.2} inside", share(false), share(true));
    assert!(share(false) >= 0.99 && share(true) >= 0.2);
}

#[test]
fn dychecks_cameras_and_splits_are_read() {
    let Some(dir) = data("dycheck_paper_windmill/demo/datasets/iphone/paper-windmill") else { return };
    let (views, rule) = crate::nerfies::split_views(&dir).unwrap();
    let count = |split| views.iter().filter(|(_, of)| *of == split).count();
    assert_eq!((count(Split::Train), count(Split::Test), rule), (277, 419, "DyCheck"));
    let frame = crate::nerfies::scene_frame(&dir, &mut Vec::new()).unwrap();
    for (id, _) in &views {
        let (lens, pose) = crate::nerfies::files::camera(&dir.join(format!("camera/{id}.json")), &frame, 2).unwrap();
        pose.check().unwrap();
        assert_eq!((lens.intrinsics.width, lens.intrinsics.height), (360, 480));
        // The scene lies in front of every camera, within the stated near and far planes around its centre.
        let depth = pose.translation.z;
        assert!((0.1..0.6).contains(&depth), "{id} has the centre at depth {depth}");
    }
    // Its images are not part of this data: the import says so.
    let message = super::support::refusal(&dir, &Params::default());
    assert!(message.contains("no folder of images"), "{message}");
}
