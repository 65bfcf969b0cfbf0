//! Forward flow from the tracks of points through a whole video: CoTracker and TAPIR.
//!
//! Every pixel takes the motion of the nearest track that is visible in both frames, if it is no farther away than tracks are
//! from each other: a grid of tracks covers the image, scattered tracks cover their surroundings.

use std::path::{Path, PathBuf};

use captures::frame_numbers;
use engine::{Failure, FailureKind};
use glam::{DVec2, Vec2};
use scene::npy_file::{self, NpyArray};
use scene::point_tree::PointTree;
use scene::statistics::median;
use scene::{Capture, FlowMap, View, ViewFolder, pixels};

use crate::params::FlowParams;

/// Names of the array of positions: CoTracker's, TAPIR's, and those of scripts around them.
const POSITIONS: [&str; 3] = ["tracks", "pred_tracks", "trajectories"];
/// Names of the array of visibility, with the layout that is meant where the axes have equal lengths.
const VISIBILITY: [(&str, Layout); 4] = [
    ("visibility", Layout::FramesFirst),
    ("pred_visibility", Layout::FramesFirst),
    ("visibilities", Layout::FramesFirst),
    ("visibles", Layout::TracksFirst),
];
/// Visibility above this value means visible; TAPIR and CoTracker store 0 and 1, or a probability.
const VISIBLE: f64 = 0.5;
/// Largest share of visible positions outside the image; above it, they belong to a video of another size.
const MAX_OUTSIDE: f64 = 0.1;

/// The order of the first two axes.
#[derive(Clone, Copy, PartialEq)]
enum Layout {
    /// CoTracker.
    FramesFirst,
    /// TAPIR.
    TracksFirst,
}

/// Positions of points over a video.
pub(crate) struct Tracks {
    count: usize,
    /// [frames, tracks] in pixels of the views; none where a point is hidden.
    positions: Vec<Option<Vec2>>,
}

impl Tracks {
    /// Reads the only npz or npy file in a folder; none without the folder.
    pub(crate) fn find(dir: &Path, capture: &Capture, params: &FlowParams) -> anyhow::Result<Option<Self>> {
        let Some(folder) = ViewFolder::open(dir, &["npz", "npy"])? else { return Ok(None) };
        let Some((_, path)) = folder.only_file() else {
            let message = "the tracks of a video are one npz or npy file; this folder has none or several";
            let hint = "write an archive with the arrays `tracks` and `visibility`";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(dir).into());
        };
        let (frames, _) = frame_numbers(capture, path)?;
        let intrinsics = capture.views[0].camera.intrinsics;
        let scale = f64::from(intrinsics.width) / f64::from(params.track_width.unwrap_or(intrinsics.width));
        let tracks = Self::read(path, frames as usize, scale)?;
        tracks.check_inside(intrinsics.width, intrinsics.height, path)?;
        Ok(Some(tracks))
    }

    fn read(path: &Path, frames: usize, scale: f64) -> anyhow::Result<Self> {
        let (positions, visibility, stated) = arrays(path)?;
        let wrong = |hint: &str| {
            let message = format!("tracks of shape {:?} for a video of {frames} frames", positions.shape);
            Failure::new(FailureKind::BadInput, message).hint(hint).at(path)
        };
        let expected =
            "CoTracker writes [frames, tracks, 2] and TAPIR [tracks, frames, 2], of all frames of the capture";
        let [first, second, 2] = *without_batch(&positions.shape, 3) else { return Err(wrong(expected).into()) };
        let layout = match (first == frames, second == frames, stated) {
            (true, true, None) => return Err(wrong("name the array of visibility `visibility` or `visibles`").into()),
            (true, true, Some(stated)) => stated,
            (true, false, _) => Layout::FramesFirst,
            (false, true, _) => Layout::TracksFirst,
            (false, false, _) => return Err(wrong(expected).into()),
        };
        if let Some(visibility) = visibility.as_ref().filter(|it| it.values.len() != first * second) {
            let message = format!("visibility of shape {:?} for {first}×{second} positions", visibility.shape);
            return Err(Failure::new(FailureKind::BadInput, message).at(path).into());
        }
        let count = if layout == Layout::FramesFirst { second } else { first };
        let position = |at: usize| {
            let (frame, track) = (at / count, at % count);
            let from = if layout == Layout::FramesFirst { frame * count + track } else { track * frames + frame };
            let place = DVec2::new(positions.values[2 * from], positions.values[2 * from + 1]) * scale;
            let is_visible = visibility.as_ref().is_none_or(|visibility| visibility.values[from] > VISIBLE);
            (is_visible && place.is_finite()).then(|| place.as_vec2())
        };
        Ok(Self { count, positions: (0..frames * count).map(position).collect() })
    }

    /// Refuses positions of a video of another size.
    fn check_inside(&self, width: u32, height: u32, path: &Path) -> anyhow::Result<()> {
        let size = Vec2::new(width as f32, height as f32);
        let visible = self.positions.iter().flatten();
        let inside = visible.clone().filter(|at| at.cmpge(-Vec2::ONE).all() && at.cmple(size + 1.0).all()).count();
        let outside = visible.count() - inside;
        if outside as f64 <= MAX_OUTSIDE * (outside + inside) as f64 {
            return Ok(());
        }
        let message =
            format!("{outside} of {} visible positions are outside of {width}×{height} pixels", outside + inside);
        let hint = "set flow.track_width to the width of the video in which the points were tracked";
        Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into())
    }

    /// The flow between two views of the video; NaN far from every track.
    pub(crate) fn flow(&self, from: &View, to: &View) -> FlowMap {
        let (width, height) = (from.camera.intrinsics.width, from.camera.intrinsics.height);
        let at = |view: &View| &self.positions[view.frame_index as usize * self.count..][..self.count];
        let pairs: Vec<(Vec2, Vec2)> = at(from).iter().zip(at(to)).filter_map(|(a, b)| (*a).zip(*b)).collect();
        let starts: Vec<[f64; 2]> = pairs.iter().map(|(start, _)| start.as_dvec2().to_array()).collect();
        let unknown = || FlowMap { width, height, flow_px: vec![[f32::NAN; 2]; width as usize * height as usize] };
        let tree = PointTree::new(&starts);
        let Some(reach2) = reach2(&starts, &tree) else { return unknown() };
        let motion = |center: DVec2| {
            let near = tree.nearest(&center.to_array()).filter(|near| near.squared_distance <= reach2);
            near.map_or([f32::NAN; 2], |near| {
                let (start, end) = pairs[near.index];
                (end - start).to_array()
            })
        };
        FlowMap { width, height, flow_px: pixels::centers(width, height).map(motion).collect() }
    }
}

/// The square of the median distance of a track from the nearest other one; none for fewer than two tracks.
fn reach2(starts: &[[f64; 2]], tree: &PointTree<'_, [f64; 2]>) -> Option<f64> {
    let nearest = |start: &[f64; 2]| tree.nearests(start, 2).get(1).map(|near| near.squared_distance);
    median(starts.iter().filter_map(nearest))
}

/// The array of positions and, if there is one, that of visibility with the layout that its name implies.
fn arrays(path: &Path) -> anyhow::Result<(NpyArray, Option<NpyArray>, Option<Layout>)> {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npy")) {
        return Ok((npy_file::read(path)?, None, None));
    }
    let member = |name: &str| -> anyhow::Result<Option<NpyArray>> {
        let exists = npy_file::member_shape(path, name)?.is_some();
        Ok(if exists { Some(npy_file::read_member(path, name)?) } else { None })
    };
    let mut positions = None;
    for name in POSITIONS {
        positions = positions.or(member(name)?);
    }
    let missing = || {
        let message = format!("the archive has none of the arrays {}", POSITIONS.join(", "));
        Failure::new(FailureKind::BadInput, message).at(PathBuf::from(path))
    };
    let positions = positions.ok_or_else(missing)?;
    for (name, layout) in VISIBILITY {
        if let Some(visibility) = member(name)? {
            return Ok((positions, Some(visibility), Some(layout)));
        }
    }
    Ok((positions, None, None))
}

/// A shape without leading axes of length 1, down to `axes` axes.
fn without_batch(shape: &[usize], axes: usize) -> &[usize] {
    let excess = shape.len().saturating_sub(axes);
    let batch = shape.iter().take(excess).take_while(|side| **side == 1).count();
    &shape[batch..]
}
