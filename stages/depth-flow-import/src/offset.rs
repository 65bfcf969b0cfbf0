//! Checks with the images and the points whether maps belong to other frames than their names state.

use captures::{better_shift, shift_by_changes};
use glam::Vec2;
use image::{Rgb, RgbImage};
use scene::statistics::median;
use scene::{FlowMap, Split, pixels};

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

/// The mean absolute difference in grey levels between `to` and `from` forward-warped along the flow, over the pixels
/// of `to` that the warp reaches; none if it reaches no pixel. Of several pixels that arrive at one, that whose flow
/// differs most from the median wins, because objects that move against the background mostly occlude it. Disoccluded
/// pixels are not reached and thus add no error.
fn warp_error(from: &RgbImage, to: &RgbImage, flow: &FlowMap) -> Option<f64> {
    let (width, height) = to.dimensions();
    let axis = |axis: usize| flow.flow_px.iter().map(move |step| f64::from(step[axis])).filter(|step| step.is_finite());
    let background = Vec2::new(median(axis(0))? as f32, median(axis(1))? as f32);
    let mut shown: Vec<Option<(f32, Rgb<u8>)>> = vec![None; (width * height) as usize];
    for (at, step) in flow.flow_px.iter().enumerate() {
        let (x, y, step) = (at as u32 % flow.width, at as u32 / flow.width, Vec2::from(*step));
        let end = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) + step;
        let inside = end.x >= 0.0 && end.y >= 0.0 && end.x < width as f32 && end.y < height as f32;
        if !inside {
            continue;
        }
        let place = &mut shown[end.y as usize * width as usize + end.x as usize];
        let speed = (step - background).length_squared();
        if place.is_none_or(|(other, _)| speed > other) {
            *place = Some((speed, *from.get_pixel(x, y)));
        }
    }
    let reached = shown.into_iter().zip(to.pixels());
    pixels::mean_difference(reached.filter_map(|(moved, there)| Some((moved?.1.0, there.0))))
}
