//! Three frame rates: rasterisation alone, with the motion model, and delivered as encoded 8-bit images.

use std::time::{Duration, Instant};

use scene::image_file::encode_rgb;
use serde::{Deserialize, Serialize};
use shaders::geometry::camera::PinholeCamera;
use training::Player;

use crate::quantize::to_image;

/// Uncounted frames that warm the caches.
const WARM_UP: usize = 2;
/// Maximum number of counted frames.
const MAX_FRAMES: usize = 60;
/// No frame starts after this time, so that large images do not delay a recipe.
const TIME_LIMIT: Duration = Duration::from_secs(4);

/// Seconds of one frame, by part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FrameTimes {
    /// Motion model.
    pub(crate) motion_secs: f64,
    /// Projection, binning, blending.
    pub(crate) raster_secs: f64,
    /// Conversion to 8 bits and PNG encoding.
    pub(crate) delivery_secs: f64,
}

/// Statistics of one frame rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct FrameRate {
    /// Frames per second of the median frame.
    pub(crate) median: f64,
    /// Mean frames per second over all frames.
    pub(crate) mean: f64,
    /// 95th percentile of the time per frame, in milliseconds.
    pub(crate) p95_ms: f64,
    /// Number of counted frames.
    pub(crate) frames: usize,
}

/// Renders the given times (seconds) and cameras in turn and times the parts of every frame.
pub(crate) fn measure(player: &Player, moments: &[(f64, PinholeCamera)]) -> anyhow::Result<Vec<FrameTimes>> {
    let start = Instant::now();
    let mut times = Vec::new();
    for (time_secs, camera) in moments.iter().cycle().take(WARM_UP + MAX_FRAMES) {
        if times.len() > WARM_UP && start.elapsed() > TIME_LIMIT {
            break;
        }
        times.push(time_frame(player, *time_secs, camera)?);
    }
    Ok(times.split_off(WARM_UP.min(times.len().saturating_sub(1))))
}

fn time_frame(player: &Player, time_secs: f64, camera: &PinholeCamera) -> anyhow::Result<FrameTimes> {
    let mut since = Instant::now();
    let mut lap = || std::mem::replace(&mut since, Instant::now()).elapsed().as_secs_f64();
    let mut tape = player.tape();
    let splats = player.splats(&mut tape, time_secs, camera)?;
    tape.device().wait();
    let motion_secs = lap();
    let rendered = player.rasterize(&mut tape, &splats, None, camera, &player.raster_settings())?;
    tape.device().wait();
    let raster_secs = lap();
    let encoded = encode_rgb(&to_image(tape.value(rendered.color)))?;
    let delivery_secs = lap();
    anyhow::ensure!(!encoded.is_empty(), "an image without bytes");
    Ok(FrameTimes { motion_secs, raster_secs, delivery_secs })
}

impl FrameRate {
    /// The rate of frames that cost `secs` each; `times` must not be empty.
    pub(crate) fn of(times: &[FrameTimes], secs: impl Fn(&FrameTimes) -> f64) -> Self {
        let mut sorted: Vec<f64> = times.iter().map(secs).collect();
        sorted.sort_by(f64::total_cmp);
        let frames = sorted.len();
        let rank = |share: f64| sorted[((share * frames as f64).ceil() as usize).clamp(1, frames) - 1];
        let total: f64 = sorted.iter().sum();
        Self { median: 1.0 / rank(0.5), mean: frames as f64 / total, p95_ms: 1e3 * rank(0.95), frames }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_known_times_are_exact() {
        let times: Vec<FrameTimes> = (1..=20)
            .map(|at| FrameTimes { motion_secs: 0.0, raster_secs: at as f64 * 0.01, delivery_secs: 9.0 })
            .collect();
        let rate = FrameRate::of(&times, |frame| frame.motion_secs + frame.raster_secs);
        assert!((rate.median - 10.0).abs() <= 1e-9, "{}", rate.median);
        assert!((rate.mean - 20.0 / 2.1).abs() <= 1e-9, "{}", rate.mean);
        assert!((rate.p95_ms - 190.0).abs() <= 1e-9, "{}", rate.p95_ms);
        assert_eq!(rate.frames, 20);
        assert_eq!(FrameRate::of(&times[..1], |frame| frame.raster_secs).p95_ms, 10.0);
    }
}
