//! `transforms_{train,val,test}.json`: D-NeRF and the synthetic scenes of NeRF (Pumarola et al. 2021, Mildenhall et
//! al. 2020).
//!
//! `camera_angle_x` is the horizontal field of view in radians. `transform_matrix` maps camera to world coordinates with
//! Blender's axes (x right, y up, looking along −z). `time` is in [0, 1] and missing for a static scene. `file_path` names
//! a PNG without its extension. Focal lengths, principal point and distortion are used if a file or a frame states them.

mod stated_lens;

use std::path::{Component, Path, PathBuf};

use glam::{DMat4, DVec4};
use scene::{RigidTransform, Split, TimeMap};
use serde::Deserialize;

use self::stated_lens::StatedLens;
use crate::error::{Result, bad};
use crate::files::{self, image_size, read_bytes};
use crate::params::{Format, Params, TestSplit};
use crate::source::{Frame, SourceCapture, time_range_secs};
use crate::split;

/// Half the side of the cube in which D-NeRF loaders sample initial points.
const BOUND: f64 = 1.3;
/// Tolerance for the last row of a homogeneous matrix.
const LAST_ROW_TOLERANCE: f64 = 1e-6;

/// A flaw of the benchmark. Published tables omit the scene or test on its validation split.
const LEGO: &str = "D-NeRF's lego: the test images show a different state of the scene than the training images; \
                    set test_split = \"val\" to test on the validation images";

#[derive(Deserialize)]
struct Transforms {
    #[serde(flatten)]
    lens: StatedLens,
    frames: Vec<TransformFrame>,
}

#[derive(Deserialize)]
struct TransformFrame {
    file_path: String,
    time: Option<f64>,
    transform_matrix: [[f64; 4]; 4],
    #[serde(flatten)]
    lens: StatedLens,
}

/// One parsed split file.
struct SplitFile {
    path: PathBuf,
    label: &'static str,
    split: Split,
    transforms: Transforms,
}

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join("transforms_train.json").is_file()
}

/// Reads the split files that the parameters ask for.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let split_files = split_files(dir, params, &mut warnings)?;
    let times = || split_files.iter().flat_map(|file| &file.transforms.frames).map(|frame| frame.time);
    let timed = times().filter(Option::is_some).count();
    if timed != 0 && timed != times().count() {
        let untimed = |file: &&SplitFile| file.transforms.frames.iter().any(|frame| frame.time.is_none());
        let path = split_files.iter().find(untimed).map_or(dir, |file| &file.path);
        let hint = "add the missing times, or remove all of them for a static scene";
        return Err(bad("some frames have a time and others do not").hint(hint).at(path));
    }
    let is_static = params.static_scene || timed == 0;
    if timed == 0 && !params.static_scene {
        warnings.push("no frame has a time: imported as a static scene".into());
    }
    if timed > 0 && dir.ends_with("lego") && params.test_split == TestSplit::Test {
        warnings.push(LEGO.into());
    }
    let images = split_files.iter().map(|file| image_paths(dir, file)).collect::<Result<Vec<_>>>()?;
    let size = any_image_size(images.concat())?;
    let mut frames = Vec::new();
    for (file, images) in split_files.iter().zip(images) {
        let first_camera = if is_static { Some(frames.len()) } else { None };
        frames.extend(file_frames(file, images, size, first_camera)?);
    }
    let mut rules = vec![split_name(params).to_owned()];
    let time_map = time_map(&frames, is_static);
    rules.extend(split::refine(&mut frames, params));
    Ok(SourceCapture {
        name: files::name(dir),
        format: Format::Blender,
        dataset: if timed > 0 { "dnerf" } else { "blender" },
        wants_test: true,
        split_rule: rules.join(", "),
        time_rule: if is_static { "one instant".into() } else { "(file time - min) / (max - min)".into() },
        time_map,
        frames,
        points: Vec::new(),
        bounds_world: Some([[-BOUND; 3], [BOUND; 3]]),
        quality: None,
        warnings,
    })
}

/// Parses the training file, the test file, and the official validation file unless that serves as the test file.
fn split_files(dir: &Path, params: &Params, warnings: &mut Vec<String>) -> Result<Vec<SplitFile>> {
    let load = |label, split| {
        let path = dir.join(format!("transforms_{label}.json"));
        Ok(SplitFile { transforms: parse(&path)?, path, label, split })
    };
    let train = load("train", Split::Train)?;
    if params.test_split == TestSplit::Val {
        return Ok(vec![train, load("val", Split::Test)?]);
    }
    if dir.join("transforms_val.json").is_file() {
        return Ok(vec![train, load("val", Split::Val)?, load("test", Split::Test)?]);
    }
    warnings.push(
        "transforms_val.json is missing: no official validation views (set val_count to hold out training views)"
            .into(),
    );
    Ok(vec![train, load("test", Split::Test)?])
}

fn split_name(params: &Params) -> &'static str {
    match params.test_split {
        TestSplit::Test => "official",
        TestSplit::Val => "official, tested on val",
    }
}

fn parse(path: &Path) -> Result<Transforms> {
    let bytes = read_bytes(path)?;
    serde_json::from_slice(&bytes).map_err(|error| {
        let failure = bad(format!("not a valid transforms file ({error})")).at(path);
        let text = String::from_utf8_lossy(&bytes);
        match ["NaN", "Infinity"].iter().find(|word| text.contains(**word)) {
            Some(word) => failure.hint(format!("it contains {word}, which is not valid JSON: correct the pose")),
            None => failure,
        }
    })
}

/// The image path of every frame of one file.
fn image_paths(dir: &Path, file: &SplitFile) -> Result<Vec<PathBuf>> {
    let path = |frame| image_path(dir, frame).map_err(|failure| failure.at(&file.path));
    file.transforms.frames.iter().map(path).collect()
}

/// The size of the first existing image. Missing images and other sizes are reported later with all other problems.
fn any_image_size(images: Vec<PathBuf>) -> Result<(u32, u32)> {
    match images.iter().find(|image| image.is_file()).or(images.first()) {
        Some(image) => image_size(image),
        None => Ok((1, 1)), // a capture without frames is reported as a problem of its own
    }
}

/// The frames of one file, sorted by time. In a static scene each frame is a separate camera, numbered from
/// `first_camera`.
fn file_frames(
    file: &SplitFile,
    images: Vec<PathBuf>,
    size: (u32, u32),
    first_camera: Option<usize>,
) -> Result<Vec<Frame>> {
    let transforms = &file.transforms;
    let frame = |(index, (stated, image)): (usize, (&TransformFrame, PathBuf))| {
        let name = format!("{}_{index:03}", file.label);
        let lens = stated.lens.or(&transforms.lens).lens(size).map_err(|failure| failure.at(&file.path))?;
        let camera_from_world = camera_from_world(&stated.transform_matrix)
            .map_err(|failure| bad(format!("{} ({name}): {}", stated.file_path, failure.message)).at(&file.path))?;
        Ok(Frame {
            name,
            split: file.split,
            image,
            mask: None,
            lens,
            camera_from_world,
            camera_index: first_camera.map_or(0, |first| (first + index) as u32),
            frame_index: 0,
            time_secs: stated.time.filter(|_| first_camera.is_none()).unwrap_or_default(),
            stated_in: file.path.clone(),
        })
    };
    let mut frames: Vec<Frame> = transforms.frames.iter().zip(images).enumerate().map(frame).collect::<Result<_>>()?;
    if first_camera.is_none() {
        frames.sort_by(|a, b| a.time_secs.total_cmp(&b.time_secs));
        frames.iter_mut().zip(0..).for_each(|(frame, rank)| frame.frame_index = rank);
    }
    Ok(frames)
}

/// The image of a frame: `file_path`, with `.png` appended unless it names a PNG or JPEG. It must be inside the capture.
fn image_path(dir: &Path, frame: &TransformFrame) -> Result<PathBuf> {
    let stated = Path::new(&frame.file_path);
    if !stated.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(bad(format!("file_path {} points outside of the capture's folder", frame.file_path)));
    }
    let extension = stated.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let has_extension = matches!(extension.as_deref(), Some("png" | "jpg" | "jpeg"));
    let name = stated.components().filter(|part| matches!(part, Component::Normal(_))).collect::<PathBuf>();
    let name = if has_extension { name } else { PathBuf::from(format!("{}.png", name.display())) };
    Ok(dir.join(name))
}

/// Converts camera-to-world (y up, z backward) to world-to-camera (y down, z forward).
fn camera_from_world(rows: &[[f64; 4]; 4]) -> Result<RigidTransform> {
    let last_row = DVec4::from(rows[3]);
    if !(last_row.abs_diff_eq(DVec4::W, LAST_ROW_TOLERANCE)) {
        return Err(bad(format!("the last row of transform_matrix is {last_row} instead of [0, 0, 0, 1]")));
    }
    let blender = DMat4::from_cols_array_2d(rows).transpose();
    let flip = DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
    let world_from_camera = RigidTransform::from_matrix(blender * flip);
    world_from_camera.check().map_err(|error| bad(error.message))?;
    Ok(world_from_camera.inverse())
}

/// The time map over all splits; a frame lasts 1 / (training frames − 1) of the range.
fn time_map(frames: &[Frame], is_static: bool) -> TimeMap {
    let [start_secs, end_secs] = time_range_secs(frames);
    let train = frames.iter().filter(|frame| frame.split == Split::Train).count();
    if is_static || !(end_secs > start_secs) {
        let instant_secs = if start_secs.is_finite() { start_secs } else { 0.0 };
        return TimeMap { start_secs: instant_secs, end_secs: instant_secs, frame_secs: 1.0 };
    }
    TimeMap { start_secs, end_secs, frame_secs: (end_secs - start_secs) / train.saturating_sub(1).max(1) as f64 }
}
