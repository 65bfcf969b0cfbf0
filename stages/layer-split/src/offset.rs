//! Checks with the images whether masks belong to other frames than their names state.

use captures::{Memo, better_shift};
use glam::{DVec2, DVec3};
use image::RgbImage;
use scene::statistics::median;
use scene::{Camera, Capture, DepthMap, FlowMap, Mask, PointCloud, Videos, View, pixels};

/// Width in pixels of the ring around a mask that is compared with its inside. On two videos of DAVIS at 216 and 432 px, widths
/// from 2 to 8 distinguish shifted masks alike.
const RING_PX: u32 = 4;

/// The shift by one frame with which the masks fit the images clearly better; `None` without one, or if too few frames show
/// motion.
///
/// A pixel of a moving object differs from the frame before *and* from the frame after, once the motion of the camera is
/// removed. With the mask of the right frame, such pixels are inside; with the mask of another frame, many are also
/// around it. The comparison is also fair to masks that are wider than the object or contain its shadow.
pub(crate) fn of_masks(capture: &Capture, masks: &[Option<Mask>]) -> anyhow::Result<Option<i64>> {
    let images = Images { capture, videos: Videos::of(capture), points: capture.load_points()? };
    let changes = Memo::new(|view| images.changes(view));
    better_shift(capture, |view, file| {
        let Some(mask) = &masks[file] else { return Ok(None) };
        Ok(changes.get(view)?.and_then(|changes| misfit(&changes, mask)))
    })
}

/// [H, W]: difference of every pixel from the frame before or after, whichever is smaller, in grey levels; NaN where unknown.
type Changes = Vec<f32>;

/// The images of a capture.
struct Images<'a> {
    capture: &'a Capture,
    videos: Videos,
    points: Option<PointCloud>,
}

impl Images<'_> {
    /// The changes of a view; `None` if a neighbouring frame is not part of the capture, or if nothing is known of the depth.
    fn changes(&self, view: usize) -> anyhow::Result<Option<Changes>> {
        let view = &self.capture.views[view];
        let [before, after] = [-1, 1].map(|step| self.videos.after(view, step).map(|at| &self.capture.views[at]));
        let (Some(before), Some(after), Some(depth)) = (before, after, self.depth(view)?) else { return Ok(None) };
        let image = self.capture.load_image(view)?;
        let from = |other: &View| -> anyhow::Result<Changes> {
            let flow = FlowMap::rigid(&depth, &view.camera, &other.camera);
            Ok(differences(&image, &self.capture.load_image(other)?, &flow))
        };
        let (before, after) = (from(before)?, from(after)?);
        Ok(Some(
            before
                .iter()
                .zip(&after)
                .map(|(a, b)| if a.is_nan() || b.is_nan() { f32::NAN } else { a.min(*b) })
                .collect(),
        ))
    }

    /// The depth of the capture, or else a plane that faces the camera at the median depth of the points, or else at the depth of
    /// the middle of the scene.
    fn depth(&self, view: &View) -> anyhow::Result<Option<DepthMap>> {
        if let Some(depth) = self.capture.load_depth(view)? {
            return Ok(Some(depth));
        }
        let depth_of = |point: DVec3| view.camera.project(point).map(|(_, depth)| depth);
        let points = self.points.iter().flat_map(|points| &points.positions);
        let of_points = median(points.filter_map(|point| depth_of(point.map(f64::from).into())));
        let middle = self.capture.bounds_world.map(|[low, high]| 0.5 * (DVec3::from(low) + DVec3::from(high)));
        Ok(of_points.or_else(|| middle.and_then(depth_of)).map(|depth| plane(&view.camera, depth)))
    }
}

/// A constant depth.
fn plane(camera: &Camera, depth: f64) -> DepthMap {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    DepthMap { width, height, depth_view: vec![depth as f32; width as usize * height as usize] }
}

/// The mean difference over the channels between every pixel of `from` and the most similar one of the 3×3 pixels of `to` around
/// the end of its flow, because flow over a plane is not exact.
fn differences(from: &RgbImage, to: &RgbImage, flow: &FlowMap) -> Changes {
    let (width, height) = to.dimensions();
    let (from, to) = (from.as_raw().as_chunks::<3>().0, to.as_raw().as_chunks::<3>().0);
    let around = || (-1..=1).flat_map(|y| (-1..=1).map(move |x| DVec2::new(f64::from(x), f64::from(y))));
    let smallest = |(at, step): (usize, &[f32; 2])| {
        let end = pixels::center(at, flow.width) + DVec2::new(f64::from(step[0]), f64::from(step[1]));
        let found = around().filter_map(|offset| pixels::index_at(end + offset, width, height));
        found.map(|there| pixels::difference(from[at], to[there]) as f32).fold(f32::NAN, f32::min)
    };
    flow.flow_px.iter().enumerate().map(smallest).collect()
}

/// The mean change around a mask as a share of that inside; `None` if either is unknown, or nothing changes inside.
fn misfit(changes: &Changes, mask: &Mask) -> Option<f64> {
    let mean = |area: &Mask| {
        let inside = changes.iter().zip(&area.inside).filter(|(change, inside)| **inside && !change.is_nan());
        let (sum, count) =
            inside.fold((0.0, 0_usize), |(sum, count), (change, _)| (sum + f64::from(*change), count + 1));
        (count > 0).then(|| sum / count as f64)
    };
    let inside = mean(mask).filter(|inside| *inside > 0.0 && changes.len() == mask.inside.len())?;
    Some(mean(&mask.dilated(RING_PX).without(mask))? / inside)
}
