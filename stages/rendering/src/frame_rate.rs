//! Three frame rates: rasterisation alone, with the motion model, and delivered as encoded 8-bit images.

use std::time::{Duration, Instant};

use scene::image_file::encode_rgb;
use serde::{Deserialize, Serialize};
use shaders::geometry::camera::PinholeCamera;
use training::Player;

use crate::delivery::deliver;
use crate::quantize::to_image;

/// Uncounted frames that warm the caches.
const WARM_UP: usize = 2;
/// Maximum number of counted frames.
const MAX_FRAMES: usize = 60;
/// No frame of a measurement starts after this time, so that large images do not delay a recipe.
const TIME_LIMIT: Duration = Duration::from_secs(2);

/// Seconds of each frame in two measurements.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FrameTimes {
    /// Projection, binning and blending, of one frame at a time.
    pub(crate) raster_secs: Vec<f64>,
    /// The motion model, of the same frames.
    pub(crate) motion_secs: Vec<f64>,
    /// Frames that are also converted to 8 bits and encoded as PNG, several at a time: means over as many consecutive frames as
    /// can be in flight.
    pub(crate) delivered_secs: Vec<f64>,
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

type Moment = (f64, PinholeCamera);

/// Renders the given times (seconds) and cameras in turn and times the frames.
pub(crate) fn measure(player: &Player, moments: &[Moment]) -> anyhow::Result<FrameTimes> {
    let mut times = FrameTimes::default();
    for moment in timed_moments(moments) {
        let [motion_secs, raster_secs] = time_frame(player, moment)?;
        times.motion_secs.push(motion_secs);
        times.raster_secs.push(raster_secs);
    }
    for secs in [&mut times.motion_secs, &mut times.raster_secs] {
        secs.drain(..WARM_UP.min(secs.len().saturating_sub(1)));
    }
    times.delivered_secs = delivered(player, moments)?;
    Ok(times)
}

/// The moments of a measurement, repeated until it ends.
fn timed_moments(moments: &[Moment]) -> impl Iterator<Item = &Moment> {
    let start = Instant::now();
    let is_due = move |&(index, _): &(usize, &Moment)| index <= WARM_UP || start.elapsed() <= TIME_LIMIT;
    moments.iter().cycle().take(WARM_UP + MAX_FRAMES).enumerate().take_while(is_due).map(|(_, moment)| moment)
}

/// Seconds of the motion model and of the rasterisation of one frame.
fn time_frame(player: &Player, (time_secs, camera): &Moment) -> anyhow::Result<[f64; 2]> {
    let mut since = Instant::now();
    let mut lap = || std::mem::replace(&mut since, Instant::now()).elapsed().as_secs_f64();
    let mut tape = player.tape();
    let splats = player.splats(&mut tape, *time_secs, camera)?;
    tape.device().wait();
    let motion_secs = lap();
    player.rasterize(&mut tape, &splats, None, camera, &player.raster_settings())?;
    tape.device().wait();
    Ok([motion_secs, lap()])
}

/// Seconds per frame of frames that are delivered as PNG files ([`FrameTimes::delivered_secs`]).
fn delivered(player: &Player, moments: &[Moment]) -> anyhow::Result<Vec<f64>> {
    let mut starts = Vec::new();
    let render = |(time_secs, camera): &&Moment| {
        starts.push(Instant::now());
        player.render(*time_secs, camera)
    };
    deliver(timed_moments(moments), render, |_, color| Ok(encode_rgb(&to_image(color))?))?;
    starts.push(Instant::now());
    Ok(means_over(&starts, rayon::current_num_threads()))
}

/// Mean seconds per frame over every `frames` consecutive frames, or over all if there are fewer. Frames begin at these
/// instants; the last one is the end of all frames.
fn means_over(starts: &[Instant], frames: usize) -> Vec<f64> {
    let frames = frames.min(starts.len() - 1);
    starts.windows(frames + 1).map(|part| (part[frames] - part[0]).as_secs_f64() / frames as f64).collect()
}

impl FrameRate {
    /// The rate of frames that take these seconds each; there must be at least one frame.
    pub(crate) fn of(secs: impl IntoIterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = secs.into_iter().collect();
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
    fn frames_that_start_in_bursts_have_their_mean_rate() {
        let start = Instant::now();
        let starts: Vec<Instant> = [0, 0, 0, 30, 30, 30, 60].map(|ms| start + Duration::from_millis(ms)).to_vec();
        let near = |found: Vec<f64>, expected: &[f64]| {
            found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-9)
        };
        assert!(near(means_over(&starts, 3), &[0.01; 4]));
        assert!(near(means_over(&starts, 100), &[0.01]));
    }

    #[test]
    fn statistics_of_known_times_are_exact() {
        let rate = FrameRate::of((1..=20).map(|at| f64::from(at) * 0.01));
        assert!((rate.median - 10.0).abs() <= 1e-9, "{}", rate.median);
        assert!((rate.mean - 20.0 / 2.1).abs() <= 1e-9, "{}", rate.mean);
        assert!((rate.p95_ms - 190.0).abs() <= 1e-9, "{}", rate.p95_ms);
        assert_eq!(rate.frames, 20);
        assert_eq!(FrameRate::of([0.01]).p95_ms, 10.0);
    }
}
