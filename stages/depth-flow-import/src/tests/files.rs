//! Imports of files whose content is derived from the ground truth of synthetic captures.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::maps::DepthKind;
use scene::{DepthMap, FlowMap, Split, pixels};

use super::*;
use crate::params::{Alignment, Axes, DepthParams, FlowParams, MapKind, MapSource, NormalParams};

pub(super) fn params() -> Params {
    Params { source: MapSource::Files, folder: "maps".into(), ..Params::default() }
}

/// Writes one depth file per view; `value` maps the true depth of a pixel to the stored value.
fn write_depth(folder: &Path, capture: &Capture, mut value: impl FnMut(f32) -> f32) {
    std::fs::create_dir_all(folder.join("depth")).unwrap();
    for view in &capture.views {
        let depth = capture.load_depth(view).unwrap().unwrap();
        let values = depth.depth_view.iter().map(|z| value(*z)).collect();
        let path = folder.join("depth").join(format!("{}.exr", view.name));
        scene::exr_file::write(&path, depth.width, depth.height, &[("Z", values)]).unwrap();
    }
}

/// Largest relative error over all known pixels, and the share of pixels with true depth that are known.
pub(super) fn depth_error(capture: &Capture, priors: &Priors) -> (f64, f64) {
    let (mut worst, mut known, mut all) = (0.0_f64, 0, 0);
    for (index, view) in capture.views.iter().enumerate() {
        let (found, truth) = (priors.load_depth(index).unwrap().unwrap(), capture.load_depth(view).unwrap().unwrap());
        for (found, truth) in found.depth_view.iter().zip(&truth.depth_view).filter(|(_, truth)| **truth > 0.0) {
            all += 1;
            known += usize::from(*found > 0.0);
            worst = if *found > 0.0 { worst.max(f64::from((found / truth - 1.0).abs())) } else { worst };
        }
    }
    (worst, f64::from(known as u32) / f64::from(all))
}

#[test]
fn inverse_depth_is_aligned_to_the_points() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    // Values of a relative estimator with an arbitrary scale and shift; 30 % of the pixels are outliers.
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut wrong = Vec::new();
    write_depth(maps.path(), &capture, |z| {
        let is_wrong = random.random::<f32>() < 0.3;
        wrong.push(is_wrong);
        match (z > 0.0, is_wrong) {
            (false, _) => f32::NAN,
            (true, true) => random.random::<f32>() * 10.0,
            (true, false) => 20.0 / z - 1.0,
        }
    });
    let inverse = DepthParams { kind: DepthKind::InverseDepth, ..DepthParams::default() };
    let params = Params { depth: inverse, ..params() };
    let (_root, priors, measured) = run(&capture, maps.path(), &params).unwrap();
    assert!((measured["alignment_scale_median"].as_f64().unwrap() - 0.05).abs() <= 1e-3, "{measured}");
    // The error of the inliers.
    let mut wrong = wrong.into_iter();
    for (index, view) in capture.views.iter().enumerate() {
        let (found, truth) = (priors.load_depth(index).unwrap().unwrap(), capture.load_depth(view).unwrap().unwrap());
        for (found, truth) in found.depth_view.iter().zip(&truth.depth_view) {
            let is_wrong = wrong.next().unwrap();
            let error = (found - truth).abs();
            assert!(is_wrong || error <= 0.01 * truth, "{} {found} instead of {truth}", view.name);
        }
    }
}

#[test]
fn maps_that_contradict_the_points_are_rejected() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    let depth = DepthParams { kind: DepthKind::InverseDepth, ..DepthParams::default() };
    let params = Params { depth, ..params() };
    // Planted fault: depth that is declared as inverse depth, which swaps near and far.
    write_depth(maps.path(), &capture, |z| z);
    assert_refused(&capture, maps.path(), &params, &["no scale and shift fits", "is depth.kind right", "depth/"]);
    let mut random = ChaCha8Rng::seed_from_u64(1);
    write_depth(maps.path(), &capture, |_| random.random::<f32>());
    assert_refused(&capture, maps.path(), &params, &["no scale and shift fits"]);
    let mut without = capture.clone();
    without.has_points = false;
    scene::index_file::write(&dir.path().join("capture.json"), "a capture", &without).unwrap();
    assert_refused(&without, maps.path(), &params, &["no points to align depth with"]);
}

#[test]
fn ray_distances_become_depth() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    std::fs::create_dir_all(maps.path().join("depth")).unwrap();
    for view in &capture.views {
        let depth = capture.load_depth(view).unwrap().unwrap();
        let centers = pixels::centers(depth.width, depth.height);
        let length = |(center, z): (_, &f32)| (1000.0 * f64::from(*z) * view.camera.ray_view(center).length()) as u16;
        let values: Vec<u16> = centers.zip(&depth.depth_view).map(length).collect();
        let image = image::ImageBuffer::<image::Luma<u16>, _>::from_vec(depth.width, depth.height, values).unwrap();
        image.save(maps.path().join("depth").join(format!("{}.png", view.name))).unwrap();
    }
    let depth = |units_per_value, alignment| DepthParams { kind: DepthKind::RayDistance, units_per_value, alignment };
    assert_refused(
        &capture,
        maps.path(),
        &Params { depth: depth(None, None), ..params() },
        &["without a scale", ".png"],
    );
    let millimetres = Params { depth: depth(Some(0.001), None), ..params() };
    let (_root, priors, _) = run(&capture, maps.path(), &millimetres).unwrap();
    let (error, known) = depth_error(&capture, &priors);
    assert!(error <= 1e-3 && known == 1.0, "{error} {known}");
    // Alignment recovers an unknown unit.
    let unknown = Params { depth: depth(Some(0.07), Some(Alignment::Scale)), ..params() };
    let (_root, priors, _) = run(&capture, maps.path(), &unknown).unwrap();
    let (error, known) = depth_error(&capture, &priors);
    // Points lie anywhere in their pixels; the depth is that of the pixel centres.
    assert!(error <= 1e-2 && known == 1.0, "{error} {known}");
}

#[test]
fn missing_negative_empty_or_misshapen_maps_are_rejected() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    assert_refused(&capture, &maps.path().join("absent"), &params(), &["no such folder of maps", "absent"]);
    assert_refused(&capture, maps.path(), &params(), &["no maps in this folder", "flow_fwd"]);
    write_depth(maps.path(), &capture, |z| -z);
    assert_refused(&capture, maps.path(), &params(), &["is not a distance", ".exr"]);
    write_depth(maps.path(), &capture, |_| 0.0);
    assert_refused(&capture, maps.path(), &params(), &["the depth map has no value", ".exr"]);
    write_depth(maps.path(), &capture, |z| z);
    let flow = Params { maps: [MapKind::Flow].into(), ..params() };
    assert_refused(&capture, maps.path(), &flow, &["no maps of a kind", "flow_fwd"]);
    let first = capture.views_of(Split::Train).next().unwrap().1;
    let file = maps.path().join("depth").join(format!("{}.exr", first.name));
    scene::exr_file::write(&file, 20, 30, &[("Z", vec![1.0; 600])]).unwrap();
    assert_refused(&capture, maps.path(), &params(), &["20×30 pixels for a view of 48×32", "uncropped"]);
    std::fs::remove_file(&file).unwrap();
    assert_refused(&capture, maps.path(), &params(), &[&format!("view {} has no file in this folder", first.name)]);
    let (_root, priors, _) = run(&capture, maps.path(), &Params { allow_missing: true, ..params() }).unwrap();
    assert_eq!(priors.load_depth(0).unwrap(), None);
    std::fs::write(&file, b"no image").unwrap();
    assert_refused(&capture, maps.path(), &params(), &["not a readable EXR image", &first.name]);
    std::fs::write(file.with_extension("npy"), b"").unwrap();
    assert_refused(&capture, maps.path(), &params(), &["two files for one view"]);
}

/// Writes forward and backward flow of a static scene between successive training views as Middlebury files.
fn write_rigid_flow(folder: &Path, capture: &Capture) {
    let views: Vec<_> = capture.views_of(Split::Train).map(|(_, view)| view).collect();
    let depths: Vec<DepthMap> = views.iter().map(|view| capture.load_depth(view).unwrap().unwrap()).collect();
    let write = |kind: &str, name: &str, map: &FlowMap| {
        std::fs::create_dir_all(folder.join(kind)).unwrap();
        let values = map.flow_px.iter().flatten().map(|value| if value.is_nan() { 2e9 } else { *value });
        let size = [map.width, map.height].into_iter().flat_map(u32::to_le_bytes);
        let bytes: Vec<u8> = b"PIEH".iter().copied().chain(size).chain(values.flat_map(f32::to_le_bytes)).collect();
        std::fs::write(folder.join(kind).join(format!("{name}.flo")), bytes).unwrap();
    };
    for at in 1..views.len() {
        let (before, after) = (&views[at - 1], &views[at]);
        write("flow_fwd", &before.name, &FlowMap::rigid(&depths[at - 1], &before.camera, &after.camera));
        write("flow_bwd", &after.name, &FlowMap::rigid(&depths[at], &after.camera, &before.camera));
    }
}

#[test]
fn inconsistent_flow_between_frames_is_dropped() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    write_rigid_flow(maps.path(), &capture);
    let (_root, priors, measured) = run(&capture, maps.path(), &params()).unwrap();
    let train: Vec<usize> = capture.views_of(Split::Train).map(|(index, _)| index).collect();
    let (mut kept, mut hidden) = (0, 0);
    for pair in train.windows(2) {
        let flow = priors.load_flow(pair[0]).unwrap().unwrap();
        let (from, to) = (&capture.views[pair[0]], &capture.views[pair[1]]);
        assert_eq!((flow.view_to, flow.camera_to, flow.time_to_secs), (Some(pair[1]), to.camera, to.time_secs));
        // Kept flow ends where the depth of the target view is that of the moved point: both views see it.
        let (depth, depth_to) = (capture.load_depth(from).unwrap().unwrap(), capture.load_depth(to).unwrap().unwrap());
        let world_from_camera = from.camera.camera_from_world.inverse();
        for (center, (flow, z)) in pixels::centers(48, 32).zip(flow.map.flow_px.iter().zip(&depth.depth_view)) {
            if *z == 0.0 {
                assert!(flow[0].is_nan());
                continue;
            }
            let point = world_from_camera.apply(from.camera.ray_view(center) * f64::from(*z));
            let (arrival, z_to) = to.camera.project(point).unwrap();
            let inside = (1.0..47.0).contains(&arrival.x) && (1.0..31.0).contains(&arrival.y);
            let seen = if inside { depth_to.depth_view[arrival.y as usize * 48 + arrival.x as usize] } else { 0.0 };
            if flow[0].is_finite() && inside {
                kept += 1;
            } else if inside && f64::from(seen) < 0.8 * z_to {
                hidden += 1;
            }
        }
    }
    assert!(kept > 1000 && hidden > 10, "{kept} kept, {hidden} hidden: the test would be blind");
    assert!(priors.load_flow(*train.last().unwrap()).unwrap().is_none());
    assert!(measured["flow_kept_share_median"].as_f64().unwrap() > 0.3, "{measured}");
    // Planted fault: backward flow of another motion.
    for path in std::fs::read_dir(maps.path().join("flow_bwd")).unwrap() {
        let path = path.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[12..].fill(0);
        std::fs::write(&path, bytes).unwrap();
    }
    let strict = FlowParams { max_round_trip_px: 0.3, ..FlowParams::default() };
    let (_root, _, wrong) = run(&capture, maps.path(), &Params { flow: strict, ..params() }).unwrap();
    let share = |measured: &serde_json::Value| measured["flow_kept_share_median"].as_f64().unwrap();
    assert!(share(&wrong) < 0.5 * share(&measured), "{wrong} {measured}");
}

#[test]
fn normals_must_face_the_camera() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture(dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    std::fs::create_dir_all(maps.path().join("normal")).unwrap();
    for view in &capture.views {
        // Marigold's convention: x right, y up, z towards the camera.
        let [x, y, z] = [0.0, 0.6, 0.8].map(|value| vec![value; 48 * 32]);
        let path = maps.path().join("normal").join(format!("{}.exr", view.name));
        scene::exr_file::write(&path, 48, 32, &[("X", x), ("Y", y), ("Z", z)]).unwrap();
    }
    assert_refused(&capture, maps.path(), &params(), &["point away from the camera", "normals.axes"]);
    let opengl = Params { normals: NormalParams { axes: Axes::Opengl }, ..params() };
    let (_root, priors, _) = run(&capture, maps.path(), &opengl).unwrap();
    let normal = priors.load_normals(0).unwrap().unwrap().normals_view[7];
    assert!((glam::Vec3::from(normal) - glam::Vec3::new(0.0, -0.6, -0.8)).length() <= 1e-6, "{normal:?}");
}

/// A video whose views are called 1, 2, …, as frames that a video tool has written.
pub(super) fn numbered_from_one(dir: &Path, scene: SceneKind) -> Capture {
    let mut capture = capture(dir, scene, CameraPath::Arc);
    capture.views.retain(|view| view.split == Split::Train);
    for (at, view) in capture.views.iter_mut().enumerate() {
        view.name = format!("{:05}", at + 1);
    }
    scene::index_file::write(&dir.join("capture.json"), "a capture", &capture).unwrap();
    capture
}

/// Writes the depth of every view into a file with the number of its frame, from `first`.
fn write_numbered_depth(folder: &Path, capture: &Capture, first: usize) {
    std::fs::create_dir_all(folder.join("depth")).unwrap();
    for (at, view) in capture.views.iter().enumerate() {
        let depth = capture.load_depth(view).unwrap().unwrap();
        let path = folder.join("depth").join(format!("{:05}.exr", at + first));
        scene::exr_file::write(&path, depth.width, depth.height, &[("Z", depth.depth_view)]).unwrap();
    }
}

#[test]
fn maps_numbered_from_zero_beside_frames_numbered_from_one_are_never_shifted() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = numbered_from_one(dir.path(), SceneKind::BouncingSpheres);
    write_numbered_depth(maps.path(), &capture, 0);
    let count = capture.views.len();
    let by_name = format!("names of views ({} of {count} views have a file)", count - 1);
    let parts = [&by_name, "e.g. view 00001 has file 1 by its name and file 0", "naming = \"frames\"", "depth"];
    assert_refused(&capture, maps.path(), &params(), &parts);
    let frames = Params { naming: scene::Naming::Frames, ..params() };
    let (_root, priors, measured) = run(&capture, maps.path(), &frames).unwrap();
    assert_eq!((depth_error(&capture, &priors).0, &measured["files_without_a_view"]), (0.0, &0.into()));
}

#[test]
fn files_with_exactly_the_names_of_the_views_need_no_naming() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = numbered_from_one(dir.path(), SceneKind::BouncingSpheres);
    write_numbered_depth(maps.path(), &capture, 1);
    let (_root, priors, _) = run(&capture, maps.path(), &params()).unwrap();
    assert_eq!(depth_error(&capture, &priors).0, 0.0);
    // With one more file, the names could be frame numbers of a longer video.
    std::fs::copy(maps.path().join("depth/00001.exr"), maps.path().join("depth/00000.exr")).unwrap();
    assert_refused(&capture, maps.path(), &params(), &["fit the views in two ways"]);
    let views = Params { naming: scene::Naming::Views, ..params() };
    let (_root, priors, measured) = run(&capture, maps.path(), &views).unwrap();
    assert_eq!((depth_error(&capture, &priors).0, &measured["files_without_a_view"]), (0.0, &1.into()));
}

#[test]
fn hidden_files_are_left_out_and_depth_without_a_hit_is_unknown() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = numbered_from_one(dir.path(), SceneKind::BouncingSpheres);
    write_numbered_depth(maps.path(), &capture, 1);
    let folder = maps.path().join("depth");
    // macOS adds such files to archives.
    std::fs::write(folder.join("._00001.exr"), "no map").unwrap();
    let DepthMap { width, height, mut depth_view } = capture.load_depth(&capture.views[0]).unwrap().unwrap();
    depth_view[..2].copy_from_slice(&[1e10, 65504.0]);
    scene::exr_file::write(&folder.join("00001.exr"), width, height, &[("Z", depth_view)]).unwrap();
    let (_root, priors, measured) = run(&capture, maps.path(), &params()).unwrap();
    let first = priors.load_depth(0).unwrap().unwrap().depth_view;
    assert_eq!((depth_error(&capture, &priors).0, &first[..2]), (0.0, &[0.0; 2][..]));
    assert_eq!(measured["files_without_a_view"], 0);
}

#[test]
fn flow_of_other_frames_is_noticed_by_the_images() {
    for (name, fit, is_played_backwards) in
        [("flow_fwd", "flow_fits_images", false), ("flow_bwd", "backward_flow_fits_images", true)]
    {
        let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let mut capture = capture_of(12, dir.path(), SceneKind::BouncingSpheres, CameraPath::Rig);
        if is_played_backwards {
            // The flow to the next frame of the capture is then the flow to the frame before.
            play_backwards(&mut capture);
        }
        write_depth(maps.path(), &capture, |z| z); // backward flow alone is not imported
        let shift_of = |shift: i64| {
            write_flow_of_other_frames(&maps.path().join(name), &capture, shift);
            let allow_missing = Params { allow_missing: true, ..params() };
            let (_root, _, measured) = run(&capture, maps.path(), &allow_missing).unwrap();
            measured[&format!("{fit}_better_shifted_by_frames")].as_i64()
        };
        assert_eq!([0, 1, -1].map(shift_of), [None, Some(-1), Some(1)], "{name}");
    }
}

/// Reverses the time of a capture on disk.
fn play_backwards(capture: &mut Capture) {
    let end_secs = capture.views.iter().map(|view| view.time_secs).fold(0.0, f64::max);
    let last_frame = capture.views.iter().map(|view| view.frame_index).max().unwrap();
    for view in &mut capture.views {
        (view.time_secs, view.frame_index) = (end_secs - view.time_secs, last_frame - view.frame_index);
    }
    let order = |view: &scene::View| (view.split, view.time_secs, view.camera_index);
    capture.views.sort_by(|a, b| order(a).partial_cmp(&order(b)).unwrap());
    scene::index_file::write(&capture.dir.join("capture.json"), "a capture", capture).unwrap();
}

/// Writes for every view with flow the flow of the view `shift` frames later, or its own at the ends.
fn write_flow_of_other_frames(folder: &Path, capture: &Capture, shift: i64) {
    let videos = scene::Videos::of(capture);
    std::fs::create_dir_all(folder).unwrap();
    for view in capture.views.iter().filter(|view| view.flow.is_some()) {
        let shown = videos.after(view, shift).map(|at| &capture.views[at]).filter(|view| view.flow.is_some());
        let flow = capture.load_flow(shown.unwrap_or(view)).unwrap().unwrap();
        let channel = |axis: usize| flow.flow_px.iter().map(|step| step[axis]).collect::<Vec<f32>>();
        let path = folder.join(format!("{}.exr", view.name));
        scene::exr_file::write(&path, flow.width, flow.height, &[("X", channel(0)), ("Y", channel(1))]).unwrap();
    }
}

#[test]
fn maps_of_other_frames_are_noticed_by_the_changes_of_the_images() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut capture = capture_of(12, dir.path(), SceneKind::BouncingSpheres, CameraPath::Rig);
    capture.has_points = false;
    std::fs::write(dir.path().join("capture.json"), serde_json::to_string(&capture).unwrap()).unwrap();
    let videos = scene::Videos::of(&capture);
    let write = |kind: &str, name: &str, [width, height]: [u32; 2], channels: &[(&str, Vec<f32>)]| {
        std::fs::create_dir_all(maps.path().join(kind)).unwrap();
        scene::exr_file::write(&maps.path().join(kind).join(name), width, height, channels).unwrap();
    };
    let shifts_of = |shift: i64| {
        for view in &capture.views {
            let other = videos.after(view, shift).map_or(view, |at| &capture.views[at]);
            let (name, depth) = (format!("{}.exr", view.name), capture.load_depth(other).unwrap().unwrap());
            let size = [depth.width, depth.height];
            let normals = |part: fn(f32) -> f32| depth.depth_view.iter().map(|z| part(0.3 * z.sin())).collect();
            write(
                "normal",
                &name,
                size,
                &[("X", normals(f32::sin)), ("Y", normals(|_| 0.0)), ("Z", normals(|a| -a.cos()))],
            );
            write("depth", &name, size, &[("Z", depth.depth_view.clone())]);
        }
        let allow_missing = Params { allow_missing: true, ..params() };
        let (_root, _, measured) = run(&capture, maps.path(), &allow_missing).unwrap();
        ["depth_fits_images", "normals_fit_images"]
            .map(|fit| measured[&format!("{fit}_better_shifted_by_frames")].as_i64())
    };
    assert_eq!(shifts_of(0), [None; 2]);
    assert_eq!(shifts_of(1), [Some(-1); 2]);
    assert_eq!(shifts_of(-1), [Some(1); 2]);
}

/// The bytes of an `.npy` file of f32 values.
pub(super) fn npy(shape: &str, values: impl Iterator<Item = f32>) -> Vec<u8> {
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    header += &" ".repeat(63 - (10 + header.len()) % 64);
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(values.flat_map(f32::to_le_bytes));
    bytes
}

#[test]
fn one_array_may_hold_the_depth_of_a_whole_video() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = numbered_from_one(dir.path(), SceneKind::BouncingSpheres);
    let depth = |view: &scene::View| capture.load_depth(view).unwrap().unwrap();
    let (count, first) = (capture.views.len(), depth(&capture.views[0]));
    let folder = maps.path().join("depth");
    std::fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, frames: usize| {
        let values = capture.views[..frames].iter().flat_map(|view| depth(view).depth_view);
        let shape = format!("(1, {frames}, {}, {}, 1)", first.height, first.width);
        std::fs::write(folder.join(name), npy(&shape, values)).unwrap();
    };
    write("clip_depths.npy", count);
    let (_root, priors, _) = run(&capture, maps.path(), &params()).unwrap();
    assert_eq!(depth_error(&capture, &priors).0, 0.0);
    write("clip_depths.npy", count - 1);
    let message = format!("{} maps in one array for a video of {count} frames", count - 1);
    assert_refused(&capture, maps.path(), &params(), &[&message, "clip_depths.npy"]);
}
