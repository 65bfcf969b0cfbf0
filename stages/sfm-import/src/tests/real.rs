//! Real captures, where `PIPELINE_DATA` names a folder that holds them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::DVec3;
use scene::{Capture, Split};

use super::support::run;
use crate::Params;
use crate::colmap::{Model, layout::sparse_dir};
use crate::params::{Resize, TestSplit};

/// The folder of a real capture; says so where there is none.
fn data(name: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("PIPELINE_DATA") else {
        eprintln!("skipped: no PIPELINE_DATA");
        return None;
    };
    let dir = Path::new(&root).join(name);
    if !dir.is_dir() {
        eprintln!("skipped: no {name} in PIPELINE_DATA");
        return None;
    }
    eprintln!("{}", crate::inspect::describe(&dir).unwrap());
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

#[test]
fn dnerf_scenes_have_the_published_counts() {
    for (scene, expected) in [("bouncingballs", [150, 20, 20]), ("jumpingjacks", [200, 20, 20]), ("lego", [50, 11, 20])] {
        let Some(dir) = data(&format!("dnerf/{scene}")) else { continue };
        let params = Params { width: Some(200), resize: Some(Resize::Area), ..Params::default() };
        let started = std::time::Instant::now();
        let (_root, capture) = run(&dir, &params).unwrap();
        eprintln!("{scene}: {} images at 200 px in {:.2?}", capture.views.len(), started.elapsed());
        assert_eq!(counts(&capture), expected, "{scene}");
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
