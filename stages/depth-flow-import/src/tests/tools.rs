//! Depth and flow laid out exactly as each tool writes them, for views called 00001, 00002, … as ffmpeg calls frames.

use std::io::Write as _;

use image::{ImageBuffer, Luma, Rgb};
use scene::maps::DepthKind;
use scene::{DepthMap, FlowMap, Naming, Split, View};

use super::files::{depth_error, npy, numbered_from_one, params};
use super::*;
use crate::params::{Alignment, Axes, DepthParams, MapKind, NormalParams};

/// A clip, a folder of maps, and its depth.
struct Clip {
    _dir: TempDir,
    capture: Capture,
    maps: TempDir,
    depths: Vec<DepthMap>,
}

impl Clip {
    fn new() -> Self {
        let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let capture = numbered_from_one(dir.path(), SceneKind::StaticBlocks);
        let depths = capture.views.iter().map(|view| capture.load_depth(view).unwrap().unwrap()).collect();
        std::fs::create_dir(maps.path().join("depth")).unwrap();
        Self { _dir: dir, capture, maps, depths }
    }

    /// Writes one file of depth per view: `bytes(values)` of `value(z)` for every pixel, with z = 0 where a ray hits nothing.
    fn write(&self, name: impl Fn(usize) -> String, value: impl Fn(f32) -> f32, bytes: impl Fn(Vec<f32>, &Path)) {
        for (at, depth) in self.depths.iter().enumerate() {
            let values = depth.depth_view.iter().map(|z| value(*z)).collect();
            bytes(values, &self.maps.path().join("depth").join(name(at)));
        }
    }

    /// The largest relative error of the imported depth.
    fn error(&self, kind: DepthKind, alignment: Option<Alignment>) -> f64 {
        self.error_with(Params { depth: DepthParams { kind, alignment, ..DepthParams::default() }, ..params() })
    }

    fn error_with(&self, params: Params) -> f64 {
        let (_root, priors, _) = run(&self.capture, self.maps.path(), &params).unwrap();
        let (error, known) = depth_error(&self.capture, &priors);
        assert!(known > 0.99, "{known}");
        error
    }
}

/// The name of a view.
fn name(at: usize) -> String {
    format!("{:05}", at + 1)
}

/// Relative inverse depth with an arbitrary scale and shift.
fn disparity(z: f32) -> f32 {
    if z > 0.0 { 20.0 / z - 1.0 } else { -1.0 }
}

fn write_npy(values: Vec<f32>, path: &Path) {
    std::fs::write(path, npy("(32, 48)", values.into_iter())).unwrap();
}

fn write_npz(path: &Path, member: &str, array: &[u8]) {
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    archive.start_file(format!("{member}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
    archive.write_all(array).unwrap();
    archive.finish().unwrap();
}

/// Values stretched to [0, `white`] per image, as tools do for PNG files.
fn stretched(values: &[f32], white: f32) -> Vec<f32> {
    let [low, high] = values.iter().fold([f32::MAX, f32::MIN], |[low, high], v| [low.min(*v), high.max(*v)]);
    values.iter().map(|value| white * (value - low) / (high - low)).collect()
}

#[test]
fn video_depth_anything_npz() {
    let clip = Clip::new();
    let values: Vec<f32> = clip.depths.iter().flat_map(|depth| &depth.depth_view).map(|z| disparity(*z)).collect();
    let array = npy(&format!("({}, 32, 48)", clip.depths.len()), values.into_iter());
    write_npz(&clip.maps.path().join("depth/clip_depths.npz"), "depths", &array);
    assert!(clip.error(DepthKind::InverseDepth, None) < 1e-2);
}

#[test]
fn video_depth_anything_exr() {
    let clip = Clip::new();
    let write = |values, path: &Path| scene::exr_file::write(path, 48, 32, &[("Z", values)]).unwrap();
    clip.write(|at| format!("frame_{at:05}.exr"), disparity, write);
    assert!(clip.error(DepthKind::InverseDepth, None) < 1e-2);
}

#[test]
fn prefixed_numbers_are_never_shifted() {
    let mut clip = Clip::new();
    for view in &mut clip.capture.views {
        view.name = format!("frame_{}", view.name);
    }
    scene::index_file::write(&clip.capture.dir.join("capture.json"), "a capture", &clip.capture).unwrap();
    clip.write(|at| format!("frame_{at:05}.npy"), |z| z, write_npy);
    assert_refused(&clip.capture, clip.maps.path(), &params(), &["fit the views in two ways", "frames-from-one"]);
    assert_eq!(clip.error_with(Params { naming: Naming::Frames, ..params() }), 0.0);
    // Views and files with another prefix each, the files from 1: only the number beyond the end shows it.
    let clip = Clip::new();
    clip.write(|at| format!("map_{}.npy", at + 1), |z| z, write_npy);
    assert_refused(&clip.capture, clip.maps.path(), &params(), &["do not start at 0", "frames-from-one"]);
    assert_eq!(clip.error_with(Params { naming: Naming::FramesFromOne, ..params() }), 0.0);
}

/// Flow has no file for the last frame, so that numbers from 1 fit frames from 0 if the first one needs no file.
#[test]
fn flow_numbered_from_one_is_never_shifted() {
    let mut clip = Clip::new();
    let folder = clip.maps.path().join("flow_fwd");
    std::fs::create_dir(&folder).unwrap();
    let maps = write_flow(&clip, |at, values| {
        std::fs::write(folder.join(format!("map_{:05}.npy", at + 1)), npy("(2, 32, 48)", values.into_iter())).unwrap();
    });
    // The first frame is held out, so no flow is missing.
    let first = clip.capture.views.remove(0);
    clip.capture.views.push(View { split: Split::Test, ..first });
    scene::index_file::write(&clip.capture.dir.join("capture.json"), "a capture", &clip.capture).unwrap();
    let flow = Params { maps: [MapKind::Flow].into(), ..params() };
    assert_refused(&clip.capture, clip.maps.path(), &flow, &["do not start at 0", "frames-from-one"]);
    assert_flow(&clip, Naming::FramesFromOne, &maps[1..]);
}

#[test]
fn depth_anything_v2_png() {
    let clip = Clip::new();
    // With --pred-only --grayscale: three equal channels of 8 bits.
    let write = |values: Vec<f32>, path: &Path| {
        let bytes = stretched(&values, 255.0).into_iter().flat_map(|value| [value as u8; 3]).collect();
        ImageBuffer::<Rgb<u8>, _>::from_vec(48, 32, bytes).unwrap().save(path).unwrap();
    };
    clip.write(|at| format!("{}.png", name(at)), disparity, write);
    let error = clip.error(DepthKind::InverseDepth, None);
    assert!(error < 0.05, "{error}");
}

#[test]
fn depth_anything_v2_metric_npy() {
    let clip = Clip::new();
    // With --save-numpy: metres, in a scene of another unit.
    clip.write(|at| format!("{}_raw_depth_meter.npy", name(at)), |z| 0.3 * z, write_npy);
    assert!(clip.error(DepthKind::Z, Some(Alignment::Scale)) < 1e-2);
}

/// Writes a grey PNG of 16 bits.
fn write_png(values: Vec<f32>, path: &Path) {
    let bytes = values.into_iter().map(|value| value as u16).collect();
    ImageBuffer::<Luma<u16>, _>::from_vec(48, 32, bytes).unwrap().save(path).unwrap();
}

#[test]
fn midas_png_npy_and_pfm() {
    let ending = |at: usize, ending: &str| format!("{}-dpt_beit_large_512.{ending}", name(at));
    let clip = Clip::new();
    clip.write(|at| ending(at, "png"), disparity, |values, path| write_png(stretched(&values, 65535.0), path));
    assert!(clip.error(DepthKind::InverseDepth, None) < 1e-2);
    let clip = Clip::new();
    clip.write(
        |at| ending(at, "pfm"),
        disparity,
        |values, path| {
            let rows = values.chunks_exact(48).rev().flatten().flat_map(|value| value.to_le_bytes());
            std::fs::write(path, b"Pf\n48 32\n-1\n".iter().copied().chain(rows).collect::<Vec<u8>>()).unwrap();
        },
    );
    assert!(clip.error(DepthKind::InverseDepth, None) < 1e-2);
    let clip = Clip::new();
    clip.write(|at| format!("{}.npy", name(at)), disparity, write_npy);
    assert!(clip.error(DepthKind::InverseDepth, None) < 1e-2);
}

#[test]
fn depth_pro_npz() {
    let clip = Clip::new();
    let write = |values: Vec<f32>, path: &Path| write_npz(path, "depth", &npy("(32, 48)", values.into_iter()));
    // Metres, in a scene of another unit.
    clip.write(|at| format!("{}.npz", name(at)), |z| 0.3 * z, write);
    assert!(clip.error(DepthKind::Z, Some(Alignment::Scale)) < 1e-2);
}

#[test]
fn marigold_depth() {
    let clip = Clip::new();
    // Affine-invariant depth in [0, 1]; it has no value for the sky.
    clip.write(|at| format!("{}_pred.npy", name(at)), |z| if z > 0.0 { (z - 1.0) / 9.0 } else { f32::NAN }, write_npy);
    assert!(clip.error(DepthKind::AffineDepth, None) < 1e-2);
    let wrong = DepthParams { kind: DepthKind::InverseDepth, ..DepthParams::default() };
    assert_refused(&clip.capture, clip.maps.path(), &Params { depth: wrong, ..params() }, &["is depth.kind right"]);
    let clip = Clip::new();
    clip.write(|at| format!("{}_pred.png", name(at)), |z| 65535.0 * z / 20.0, write_png);
    assert!(clip.error(DepthKind::AffineDepth, None) < 1e-2);
}

#[test]
fn marigold_normals() {
    let clip = Clip::new();
    let folder = clip.maps.path().join("normal");
    std::fs::create_dir(&folder).unwrap();
    // [3, H, W]: x right, y up, z towards the camera.
    let stored = |at: usize| if at.is_multiple_of(2) { [0.0, 0.6, 0.8] } else { [0.28, 0.0, 0.96] };
    for at in 0..clip.capture.views.len() {
        let values = stored(at).into_iter().flat_map(|value| [value; 48 * 32]);
        std::fs::write(folder.join(format!("{}_pred.npy", name(at))), npy("(3, 32, 48)", values)).unwrap();
    }
    let opengl = NormalParams { axes: Axes::Opengl };
    let params = Params { maps: [MapKind::Normals].into(), normals: opengl, ..params() };
    let (_root, priors, _) = run(&clip.capture, clip.maps.path(), &params).unwrap();
    for at in 0..clip.capture.views.len() {
        let [x, y, z] = stored(at);
        let found = priors.load_normals(at).unwrap().unwrap().normals_view[7];
        assert!((glam::Vec3::from(found) - glam::Vec3::new(x, -y, -z)).length() <= 1e-6, "view {at}: {found:?}");
    }
}

/// Writes the flow between successive views with `write(index of the pair, values as [2, H, W])`.
fn write_flow(clip: &Clip, mut write: impl FnMut(usize, Vec<f32>)) -> Vec<FlowMap> {
    let views = &clip.capture.views;
    let flow = |at: usize| FlowMap::rigid(&clip.depths[at], &views[at].camera, &views[at + 1].camera);
    let maps: Vec<FlowMap> = (0..views.len() - 1).map(flow).collect();
    for (at, map) in maps.iter().enumerate() {
        let axis = |axis: usize| map.flow_px.iter().map(move |flow| flow[axis]);
        write(at, axis(0).chain(axis(1)).collect());
    }
    maps
}

/// Asserts that the flow of every training view is the expected one.
fn assert_flow(clip: &Clip, naming: Naming, expected: &[FlowMap]) {
    let params = Params { maps: [MapKind::Flow].into(), naming, ..params() };
    let (_root, priors, _) = run(&clip.capture, clip.maps.path(), &params).unwrap();
    let is_training = |at: usize| clip.capture.views[at].split == Split::Train;
    for (at, expected) in expected.iter().enumerate().filter(|(at, _)| is_training(*at)) {
        let found = priors.load_flow(at).unwrap().unwrap().map;
        let known = found.flow_px.iter().zip(&expected.flow_px).filter(|(found, _)| found[0].is_finite());
        let errors: Vec<f32> = known.map(|(a, b)| (a[0] - b[0]).abs().max((a[1] - b[1]).abs())).collect();
        assert!(errors.len() > 500 && errors.iter().all(|error| *error < 1e-4), "frame {at}: {}", errors.len());
    }
}

#[test]
fn raft_arrays_have_a_batch_axis() {
    let clip = Clip::new();
    let folder = clip.maps.path().join("flow_fwd");
    std::fs::create_dir(&folder).unwrap();
    let maps = write_flow(&clip, |at, values| {
        std::fs::write(folder.join(format!("{}.npy", name(at))), npy("(1, 2, 32, 48)", values.into_iter())).unwrap();
    });
    // The last view has no flow, so the numbers alone leave open whether they count from 0 or from 1.
    assert_flow(&clip, Naming::Views, &maps);
}

#[test]
fn unimatch_names_end_with_pred() {
    let clip = Clip::new();
    let folder = clip.maps.path().join("flow_fwd");
    std::fs::create_dir(&folder).unwrap();
    let maps = write_flow(&clip, |at, values| {
        let (u, v) = values.split_at(48 * 32);
        let size = [48_u32, 32].into_iter().flat_map(u32::to_le_bytes);
        let pixels = u.iter().zip(v).flat_map(|(u, v)| [*u, *v]).map(|value| if value.is_nan() { 2e9 } else { value });
        let bytes: Vec<u8> = b"PIEH".iter().copied().chain(size).chain(pixels.flat_map(f32::to_le_bytes)).collect();
        std::fs::write(folder.join(format!("{}_pred.flo", name(at))), bytes).unwrap();
        std::fs::write(folder.join(format!("{}_flow.png", name(at))), b"a picture of the flow").unwrap();
    });
    assert_flow(&clip, Naming::Views, &maps);
}

#[test]
fn flow_of_a_whole_video_in_one_array() {
    let clip = Clip::new();
    let folder = clip.maps.path().join("flow_fwd");
    std::fs::create_dir(&folder).unwrap();
    let mut all = Vec::new();
    let maps = write_flow(&clip, |_, values| all.extend(values));
    let shape = format!("({}, 2, 32, 48)", maps.len());
    std::fs::write(folder.join("sea_raft.npy"), npy(&shape, all.into_iter())).unwrap();
    assert_flow(&clip, Naming::Views, &maps);
}

#[test]
fn depth_of_other_frames_is_noticed_by_the_points() {
    let (dir, maps) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let capture = capture_of(12, dir.path(), SceneKind::StaticBlocks, CameraPath::Arc);
    std::fs::create_dir(maps.path().join("depth")).unwrap();
    let shift_of = |shift: usize| {
        let train: Vec<_> = capture.views_of(scene::Split::Train).map(|(_, view)| view).collect();
        for (at, view) in train.iter().enumerate() {
            let depth = capture.load_depth(train[(at + shift).min(train.len() - 1)]).unwrap().unwrap();
            depth.write(&maps.path().join(format!("depth/{}.exr", view.name))).unwrap();
        }
        let (_root, _, measured) = run(&capture, maps.path(), &params()).unwrap();
        measured["depth_fits_points_better_shifted_by_frames"].clone()
    };
    assert_eq!(shift_of(0), serde_json::Value::Null);
    assert_eq!(shift_of(1), serde_json::json!(-1));
}
