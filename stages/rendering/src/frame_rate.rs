//! Three frame rates: rasterisation alone, with the motion model, and delivered as encoded 8-bit images.

use std::time::{Duration, Instant};

use scene::image_file::encode_rgb;
use serde::{Deserialize, Serialize};
use shaders::geometry::camera::PinholeCamera;
use training::Player;

use crate::delivery::{deliver, max_in_flight};
use crate::quantize::image_of;

/// Uncounted frames that warm the caches.
const WARM_UP: usize = 2;
/// Number of counted frames, unless many threads need more.
const FRAMES: usize = 60;
/// No frame of a measurement starts after this time, so that large images do not delay a recipe.
const TIME_LIMIT: Duration = Duration::from_secs(2);
/// Maximum number of rounds in which the two measurements alternate, so that they see the same load of the machine.
const MAX_ROUNDS: usize = 4;
/// Minimum number of frames per thread in each of several rounds: the first frames of a delivery wait for no other.
const ROUND_FRAMES: usize = 6;

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

/// Renders the given times (seconds) and cameras in turn and times the frames. The two measurements alternate.
pub(crate) fn measure(player: &Player, moments: &[Moment]) -> anyhow::Result<FrameTimes> {
    for moment in moments.iter().cycle().take(WARM_UP) {
        time_frame(player, moment)?;
    }
    // The first frames in flight allocate memory that later ones use again.
    delivered(player, within(&moments.iter().cycle().take(max_in_flight()).collect::<Vec<_>>(), TIME_LIMIT))?;
    let mut times = FrameTimes::default();
    let rounds = rounds(moments, rayon::current_num_threads());
    let (start, limit) = (Instant::now(), TIME_LIMIT / rounds.len() as u32);
    for (index, round) in rounds.iter().enumerate() {
        if index > 0 && start.elapsed() > 2 * TIME_LIMIT {
            break;
        }
        for moment in within(round, limit) {
            let [motion_secs, raster_secs] = time_frame(player, moment)?;
            times.motion_secs.push(motion_secs);
            times.raster_secs.push(raster_secs);
        }
        times.delivered_secs.extend(delivered(player, within(round, limit))?);
    }
    Ok(times)
}

/// The moments of every round, repeated until there are enough.
fn rounds<M>(moments: &[M], threads: usize) -> Vec<Vec<&M>> {
    let frames = FRAMES.max(ROUND_FRAMES * threads);
    let count = (frames / (ROUND_FRAMES * threads)).min(MAX_ROUNDS);
    let all: Vec<&M> = moments.iter().cycle().take(frames).collect();
    all.chunks(frames / count).map(<[_]>::to_vec).collect()
}

/// The first moment, and those that begin before the limit.
fn within<'m>(round: &[&'m Moment], limit: Duration) -> impl Iterator<Item = &'m Moment> {
    let start = Instant::now();
    let is_due = move |&(index, _): &(usize, &&'m Moment)| index == 0 || start.elapsed() <= limit;
    round.iter().enumerate().take_while(is_due).map(|(_, moment)| *moment)
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
fn delivered<'m>(player: &Player, moments: impl Iterator<Item = &'m Moment>) -> anyhow::Result<Vec<f64>> {
    let mut starts = Vec::new();
    let start = |(time_secs, camera): &&Moment| {
        starts.push(Instant::now());
        player.start_frame(*time_secs, camera)
    };
    let encode =
        |(_, camera): &Moment, started| Ok(encode_rgb(&image_of(camera, player.finish_frame(started)?.values))?);
    deliver(moments, start, |frame| frame.wait(), encode)?;
    starts.push(Instant::now());
    Ok(means_over(&starts, max_in_flight()))
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
    fn rounds_are_long_enough_for_deliveries_and_cover_the_views_in_turn() {
        let moments: Vec<usize> = (0..7).collect();
        for (threads, expected) in [(1, 4), (2, 4), (3, 3), (4, 2), (16, 1), (200, 1)] {
            let rounds = rounds(&moments, threads);
            assert_eq!(rounds.len(), expected, "{threads} threads");
            assert!(rounds.iter().all(|round| round.len() >= ROUND_FRAMES * threads), "{threads} threads");
            let frames = rounds.iter().map(Vec::len).sum();
            assert!(rounds.concat().into_iter().copied().eq((0..frames).map(|at| at % 7)), "{threads} threads");
        }
    }

    #[test]
    fn a_round_ends_at_its_limit_but_has_a_frame() {
        let moments = [(0.0, camera()); 3];
        let round: Vec<&Moment> = moments.iter().collect();
        assert_eq!(within(&round, Duration::from_secs(3600)).count(), 3);
        let slow = within(&round, Duration::ZERO).inspect(|_| std::thread::sleep(Duration::from_millis(1)));
        assert_eq!(slow.count(), 1);
    }

    fn camera() -> PinholeCamera {
        let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        PinholeCamera { width: 1, height: 1, focal: [1.0; 2], center: [0.5; 2], rotation, translation: [0.0; 3] }
    }

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
