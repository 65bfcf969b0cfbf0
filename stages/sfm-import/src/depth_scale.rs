//! Whether the depth maps of a capture have the scale of its cameras: files do not always state their unit.

use glam::DVec3;
use scene::statistics::median;

use crate::cloud_file::{CloudSource, visible_depths};
use crate::oddities::short;
use crate::source::{Frame, SourceCapture};

/// Number of depth maps that are read.
const SAMPLED: usize = 3;
/// Longest side of the sampled maps in pixels.
const SIDE: f64 = 128.0;
/// Factor between depth maps and the points of the cloud beyond which the unit is wrong. Points are denser on near surfaces.
const CONTRADICTION: f64 = 5.0;
/// Factor between depth maps and the point that the cameras look at, for captures without a cloud. That point may be far from
/// what the images show, but units differ by 1000.
const UNSURE_CONTRADICTION: f64 = 50.0;

/// The median depth of one map in scene units, with its frame.
pub(crate) struct MedianDepth<'a> {
    frame: &'a Frame,
    /// Scene units per stored unit.
    pub(crate) units_per_value: f64,
    /// The median of the known values.
    pub(crate) depth_view: f64,
}

/// The medians of a few maps, evenly spread over the capture. Maps that cannot be read are left out; the import reports them.
pub(crate) fn medians(capture: &SourceCapture) -> Vec<MedianDepth<'_>> {
    let with_depth: Vec<&Frame> = capture.frames.iter().filter(|frame| frame.depth.is_some()).collect();
    let step = with_depth.len().div_ceil(SAMPLED).max(1);
    with_depth.into_iter().step_by(step).filter_map(median_of).collect()
}

fn median_of(frame: &Frame) -> Option<MedianDepth<'_>> {
    let (file, target) = (frame.depth.as_ref()?, frame.camera().ok()?.intrinsics);
    let scale = (SIDE / f64::from(target.width.max(target.height))).min(1.0);
    let side = |length: u32| (f64::from(length) * scale).round().max(1.0) as u32;
    let map = file.read(&frame.lens, &target, (side(target.width), side(target.height))).ok()?;
    let known = map.depth_view.into_iter().filter(|depth| *depth > 0.0).map(f64::from);
    Some(MedianDepth { frame, units_per_value: file.units_per_value, depth_view: median(known)? })
}

/// A warning about depth maps that contradict the cloud, or else the point that the cameras look at, with the unit that fits.
pub(crate) fn warning(capture: &SourceCapture) -> Option<String> {
    let has_cloud = match &capture.cloud {
        Some(CloudSource::Depth) => return None, // its points have the scale of the maps
        _ => !capture.points.is_empty(),
    };
    let (least, what) = match has_cloud {
        true => (CONTRADICTION, "the points in view"),
        false => (UNSURE_CONTRADICTION, "what the cameras look at"),
    };
    let medians = medians(capture);
    let [low, high] = capture.bounds_world()?.map(DVec3::from);
    let expected = |frame: &Frame| match has_cloud {
        true => median(visible_depths(&frame.camera().ok()?, &capture.points)),
        false => Some(frame.camera_from_world.apply(0.5 * (low + high)).z).filter(|depth| *depth > 0.0),
    };
    let ratio = |found: &MedianDepth<'_>| Some(expected(found.frame)? / found.depth_view);
    let factor = median(medians.iter().filter_map(ratio))?;
    let first = medians.first()?;
    let unit = 10_f64.powi((first.units_per_value * factor).log10().round() as i32);
    (factor.ln().abs() > least.ln()).then(|| {
        format!(
            "depth maps are {} times as deep as {what}, at {} scene units per stored unit: set depth_unit = {unit:?} if it fits",
            short(factor.recip()),
            first.units_per_value
        )
    })
}
