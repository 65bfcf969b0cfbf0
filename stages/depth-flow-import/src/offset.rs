//! Checks with the images and the points whether maps belong to other frames than their names state.

use captures::{better_shift, shift_by_changes};
use glam::Vec2;
use image::RgbImage;
use scene::{FlowMap, Split};

use crate::from_files::{Direction, Files, Still};

/// The shift by one frame with which the flow in this direction explains the images clearly better; none without one.
pub(crate) fn of_flow(files: &Files<'_>, direction: Direction) -> anyhow::Result<Option<i64>> {
    let capture = files.capture();
    better_shift(capture, |view, file| {
        let Some((flow, to)) = files.flow_of(direction, view, file)? else { return Ok(None) };
        Ok(warp_error(&capture.load_image(&capture.views[view])?, &capture.load_image(to)?, &flow))
    })
}

/// The shift by one frame with which the depth fits the points of the capture clearly better; none without one.
pub(crate) fn of_depth(files: &Files<'_>) -> anyhow::Result<Option<i64>> {
    better_shift(files.capture(), |view, file| match files.capture().views[view].split {
        Split::Train => files.depth_misfit(view, file),
        _ => Ok(None),
    })
}

/// The shift by one frame with which maps change where the images change; none without one.
pub(crate) fn of_changes(files: &Files<'_>, kind: Still) -> anyhow::Result<Option<i64>> {
    shift_by_changes(files.capture(), |view| files.stored(kind, view))
}

/// The mean absolute difference in grey levels between the pixels of `from` and those of `to` where the flow leads;
/// none if it leads to no pixel.
fn warp_error(from: &RgbImage, to: &RgbImage, flow: &FlowMap) -> Option<f64> {
    let differences = flow.flow_px.iter().enumerate().filter_map(|(at, step)| {
        let (x, y) = (at as u32 % flow.width, at as u32 / flow.width);
        let end = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) + Vec2::from(*step);
        let inside = end.x >= 0.0 && end.y >= 0.0 && end.x < to.width() as f32 && end.y < to.height() as f32;
        inside.then(|| {
            let seen = to.get_pixel(end.x as u32, end.y as u32);
            from.get_pixel(x, y).0.iter().zip(seen.0).map(|(a, b)| f64::from(a.abs_diff(b))).sum::<f64>() / 3.0
        })
    });
    let (sum, count) = differences.fold((0.0, 0_usize), |(sum, count), difference| (sum + difference, count + 1));
    (count > 0).then(|| sum / count as f64)
}
