//! Whether the files of flow belong to other frames than their names say, judged by the images.

use glam::Vec2;
use image::RgbImage;
use scene::FlowMap;

use crate::from_files::Files;

/// Maximum number of views that are checked.
const CHECKED: usize = 12;
/// Minimum number of views that must agree on a shift, so that one bad map shows nothing.
const MIN_CHECKED: usize = 3;
/// A shift fits a view better if its photometric error is below this share of the error without it.
const BETTER: f64 = 0.8;
/// Share of the checked views that a shift must fit better.
const MAJORITY: f64 = 0.75;

/// The shift by one frame, −1 or 1, with which the flow explains the images clearly better; none if there is none, or
/// if too little flow can be checked.
pub(crate) fn better_shift(files: &Files<'_>) -> anyhow::Result<Option<i64>> {
    let count = files.capture().views.len();
    let candidates: Vec<usize> = (0..count).step_by(count.div_ceil(CHECKED).max(1)).collect();
    for shift in [-1, 1] {
        let (mut checked, mut better) = (0, 0);
        for &index in &candidates {
            let (Some(own), Some(shifted)) = (error(files, index, 0)?, error(files, index, shift)?) else { continue };
            checked += 1;
            better += usize::from(shifted < BETTER * own);
        }
        if checked >= MIN_CHECKED && better as f64 >= MAJORITY * checked as f64 {
            return Ok(Some(shift));
        }
    }
    Ok(None)
}

/// The mean absolute difference between a view and the view where its flow leads, along the flow of the file of the view
/// `shift` frames later, over the three channels in grey levels; none without such flow.
fn error(files: &Files<'_>, index: usize, shift: i64) -> anyhow::Result<Option<f64>> {
    let Some((flow, to)) = files.shifted_flow(index, shift)? else { return Ok(None) };
    let capture = files.capture();
    Ok(warp_error(&capture.load_image(&capture.views[index])?, &capture.load_image(to)?, &flow))
}

/// The mean absolute difference in grey levels between the pixels of `from` and those of `to` where the flow leads; none
/// if it leads nowhere.
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
