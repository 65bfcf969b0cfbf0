//! The layout of Dynamic 3D Gaussians: `train_meta.json` and `test_meta.json` with a camera and a file per instant and
//! view, images in `ims/`, foreground masks in `seg/`, the points of the first instant in `init_pt_cld.npz`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use glam::{DMat3, DMat4, DVec3};
use scene::{Intrinsics, RigidTransform, Split, npy_file};
use serde::Deserialize;

use super::DATA_SET;
use crate::cloud_file::Points;
use crate::error::{Result, bad};
use crate::files::{inside, read_text};
use crate::lens::Lens;
use crate::params::{Format, Params};
use crate::rig;
use crate::source::{Frame, SourceCapture};
use crate::split;

const TRAIN: &str = "train_meta.json";
const TEST: &str = "test_meta.json";
const POINTS: &str = "init_pt_cld.npz";
/// Numbers per point: position, colour in [0, 1], and whether it is foreground.
const POINT_LENGTH: usize = 7;

/// Lists per instant with an item per view.
type PerView<T> = Vec<Vec<T>>;

/// One of the two files.
#[derive(Deserialize)]
struct Meta {
    w: u32,
    h: u32,
    /// Camera matrices, as rows.
    k: PerView<[[f64; 3]; 3]>,
    /// World to camera with OpenCV's axes, as rows.
    w2c: PerView<[[f64; 4]; 4]>,
    /// Paths below `ims`.
    #[serde(rename = "fn")]
    files: PerView<String>,
    cam_id: PerView<u32>,
}

pub(super) fn is_present(dir: &Path) -> bool {
    dir.join(TRAIN).is_file() && dir.join("ims").is_dir()
}

pub(super) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let mut frames = frames(dir, TRAIN, Split::Train, params)?;
    let has_test = dir.join(TEST).is_file();
    if has_test {
        frames.extend(self::frames(dir, TEST, Split::Test, params)?);
    }
    frames.sort_by_key(|frame| (frame.frame_index, frame.camera_index));
    let rules = if !params.test_cameras.is_empty() {
        hold_out(&mut frames, &params.test_cameras).map_err(|failure| failure.at(dir))?
    } else if has_test {
        "official".into()
    } else {
        warnings.push(format!("{TEST} is missing: every_nth chooses the test cameras"));
        split::hold_out(&mut frames, false, params)
    };
    let is_mirrored = mirror(&mut frames);
    let first = params.first_frame.unwrap_or(0);
    let last = params.frame_count.map_or(u64::MAX, |count| first.saturating_add(count.into()));
    frames.retain(|frame| (first..last).contains(&frame.frame_index.into()));
    frames.iter_mut().for_each(|frame| {
        frame.frame_index -= first as u32;
        frame.time_secs = f64::from(frame.frame_index) / params.fps;
    });
    let instants = frames.iter().map(|frame| frame.frame_index).collect::<BTreeSet<_>>().len();
    if instants == 0 {
        return Err(bad("no instant is left").hint("change first_frame or frame_count").at(dir.join(TRAIN)));
    }
    let rules = vec![rules, format!("{instants} frames")];
    let capture = rig::capture(dir, (Format::Panoptic, DATA_SET), frames, rules, params);
    let mut points = points(&dir.join(POINTS), &mut warnings)?;
    if is_mirrored {
        warnings.push("the poses are reflections (a left-handed world): the world is mirrored along x".into());
        points.iter_mut().for_each(|(position, _)| position[0] = -position[0]);
    }
    Ok(SourceCapture { wants_test: capture.wants_test || has_test, points, warnings, ..capture })
}

/// Makes the frames of the cameras with these numbers the only test views, and returns the rule.
fn hold_out(frames: &mut [Frame], held_out: &[String]) -> Result<String> {
    let known: BTreeSet<u32> = frames.iter().map(|frame| frame.camera_index).collect();
    let names: Vec<String> = known.iter().map(u32::to_string).collect();
    rig::hold_out_named(frames, held_out, &names, |name| name.parse().ok().filter(|camera| known.contains(camera)))
}

/// The views of one file. Views that share a camera number are one camera.
fn frames(dir: &Path, name: &str, split: Split, params: &Params) -> Result<Vec<Frame>> {
    let path = dir.join(name);
    let not_valid = |error| bad(format!("not a valid file of Dynamic 3D Gaussians ({error})")).at(&path);
    let meta: Meta = serde_json::from_str(&read_text(&path)?).map_err(not_valid)?;
    let mut frames = Vec::new();
    let mut seen = BTreeMap::new();
    for (instant, files) in (0_u32..).zip(&meta.files) {
        let at = instant as usize;
        let lists = [meta.k.get(at).map(Vec::len), meta.w2c.get(at).map(Vec::len), meta.cam_id.get(at).map(Vec::len)];
        if lists != [Some(files.len()); 3] {
            let message =
                format!("instant {instant} has {} files, but k, w2c and cam_id have other lengths", files.len());
            return Err(bad(message).at(path));
        }
        for (view, file) in files.iter().enumerate() {
            let camera_index = meta.cam_id[at][view];
            if let Some(other) = seen.insert((instant, camera_index), view) {
                let message = format!("instant {instant}: camera {camera_index} has the views {other} and {view}");
                return Err(bad(message).at(path));
            }
            let named = |failure: engine::Failure| failure.at(&path);
            let image = dir.join("ims").join(inside(file, "ims").map_err(named)?);
            let mask = dir.join("seg").join(Path::new(file).with_extension("png"));
            frames.push(Frame {
                name: format!("{camera_index:02}_{instant:04}"),
                split,
                image,
                stored_image: None,
                mask: mask.is_file().then_some(mask),
                depth: None,
                lens: lens(&meta, at, view).map_err(named)?,
                camera_from_world: RigidTransform::from_matrix(
                    DMat4::from_cols_array_2d(&meta.w2c[at][view]).transpose(),
                ),
                camera_index,
                frame_index: instant,
                time_secs: f64::from(instant) / params.fps,
                stated_in: path.clone(),
            });
        }
    }
    Ok(frames)
}

/// Mirrors a left-handed world, in which every pose is a reflection, along x. The images stay as they are.
fn mirror(frames: &mut [Frame]) -> bool {
    let is_left_handed = frames.iter().all(|frame| frame.camera_from_world.rotation.determinant() < 0.0);
    if is_left_handed {
        let flip = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        frames.iter_mut().for_each(|frame| frame.camera_from_world.rotation *= flip);
    }
    is_left_handed
}

/// The principal point is off the centre and kept.
fn lens(meta: &Meta, instant: usize, view: usize) -> Result<Lens> {
    let [[focal_x, skew, center_x], [_, focal_y, center_y], _] = meta.k[instant][view];
    if skew != 0.0 {
        return Err(bad(format!("instant {instant}, view {view}: a skew of {skew} px is not supported")));
    }
    let intrinsics = Intrinsics { width: meta.w, height: meta.h, focal_x, focal_y, center_x, center_y };
    Ok(Lens::pinhole(intrinsics))
}

/// Positions and colours of the first instant.
fn points(path: &Path, warnings: &mut Vec<String>) -> Result<Points> {
    if !path.is_file() {
        warnings.push(format!("{POINTS} is missing: initial points will be random"));
        return Ok(Vec::new());
    }
    let array = npy_file::read_member(path, "data").map_err(|error| bad(error.message).at(path))?;
    let [_, POINT_LENGTH] = *array.shape.as_slice() else {
        return Err(bad(format!("the array has shape {:?} instead of [points, {POINT_LENGTH}]", array.shape)).at(path));
    };
    if let Some(at) = array.values.iter().position(|value| !value.is_finite()) {
        return Err(bad(format!("point {} is not finite", at / POINT_LENGTH)).at(path));
    }
    let byte = |value: &f64| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let point = |row: &[f64]| (DVec3::from_slice(row).to_array(), [&row[3], &row[4], &row[5]].map(byte));
    Ok(array.values.chunks_exact(POINT_LENGTH).map(point).collect())
}
