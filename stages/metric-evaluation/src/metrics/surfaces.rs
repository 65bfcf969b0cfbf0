//! Figures of what a render says about surfaces, against maps that are exact at pixel centres.
//!
//! Every figure is per image and a mean over pixels: those that the truth covers, or those whose surface moves.

use std::collections::{BTreeMap, BTreeSet};

use rendering::SurfaceMaps;
use scene::{DepthMap, FlowMap, VelocityMap};

use super::{Metric, Score, psnr_from_mse};
use crate::Image;

/// A surface that is slower does not count as moving, scene units per second: far below any motion of a scene, far
/// above the rounding of positions.
const MOVING: f32 = 1e-3;
/// A rendered surface that is nearer than this share of the true depth floats before it.
const FLOATS_BEFORE: f32 = 0.9;

/// What the capture knows exactly of one view; whatever it does not know is absent.
#[derive(Clone, Debug, Default)]
pub struct Truths {
    /// View-space z; 0 where nothing is seen.
    pub depth: Option<DepthMap>,
    /// Velocity of the seen surface.
    pub velocity: Option<VelocityMap>,
    /// Flow to the next frame; NaN where there is none.
    pub flow: Option<FlowMap>,
}

impl Truths {
    /// Whether each pixel's surface moves, where that is known.
    pub fn moving(&self) -> Option<Vec<bool>> {
        let speed_squared = |velocity: &[f32; 3]| velocity.iter().map(|value| value * value).sum::<f32>();
        let is_moving = |velocity: &[f32; 3]| speed_squared(velocity) > MOVING * MOVING;
        Some(self.velocity.as_ref()?.velocity_world.iter().map(is_moving).collect())
    }
}

/// Every figure in `wanted` that the truths allow; figures whose truth is unknown are absent.
pub fn judge_surfaces(rendered: &SurfaceMaps, truths: &Truths, wanted: &BTreeSet<Metric>) -> BTreeMap<Metric, Score> {
    let moving = truths.moving();
    let depth = truths.depth.as_ref().map(|map| map.depth_view.as_slice());
    let velocity = truths.velocity.as_ref().map(|map| map.velocity_world.as_slice());
    let flow = truths.flow.as_ref().map(|map| map.flow_px.as_slice());
    let figures = [
        (
            Metric::VelocityError,
            velocity.zip(moving.as_deref()).map(|(truth, moving)| velocity_error(rendered, truth, moving)),
        ),
        (Metric::FlowError, flow.zip(moving.as_deref()).map(|(truth, moving)| flow_error(rendered, truth, moving))),
        (Metric::DepthError, depth.map(|truth| depth_error(rendered, truth))),
        (Metric::HoleArea, depth.map(|truth| hole_area(rendered, truth))),
        (Metric::FloaterArea, depth.map(|truth| floater_area(rendered, truth))),
    ];
    let wanted = |(metric, score): (Metric, Option<Score>)| wanted.contains(&metric).then_some((metric, score?));
    figures.into_iter().filter_map(wanted).collect()
}

/// PSNR over the pixels whose true surface moves, and the mean squared error and number of pixels behind it.
pub fn psnr_of_moving(render: &Image, truth: &Image, moving: &[bool]) -> (Score, Option<MovingError>) {
    let pixels = moving.iter().filter(|moving| **moving).count();
    if pixels == 0 {
        return (Score::undefined(NOTHING_MOVES), None);
    }
    let squared = |at: usize| (0..3).map(|c| (render.planes[c][at] - truth.planes[c][at]).powi(2)).sum::<f64>();
    let sum: f64 = (0..moving.len()).filter(|&at| moving[at]).map(squared).sum();
    let mse = sum / (3 * pixels) as f64;
    (Score::Value(psnr_from_mse(mse)), Some(MovingError { mse, pixels }))
}

/// The squared error on moving surfaces of one image.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MovingError {
    /// Mean over pixels and channels.
    pub mse: f64,
    /// Pixels whose surface moves.
    pub pixels: usize,
}

/// Why a figure of moving surfaces has no value.
const NOTHING_MOVES: &str = "nothing moves in the image";

/// Mean distance between rendered and true velocity over moving surfaces; a hole counts as standing still.
fn velocity_error(rendered: &SurfaceMaps, truth: &[[f32; 3]], moving: &[bool]) -> Score {
    let distance = |at: usize| {
        length(std::array::from_fn::<f64, 3, _>(|axis| difference(rendered.velocity_world[at][axis], truth[at][axis])))
    };
    mean_over(moving.len(), |at| moving[at], distance, NOTHING_MOVES)
}

/// Mean distance in pixels between rendered and true flow over moving surfaces that stay in sight.
fn flow_error(rendered: &SurfaceMaps, truth: &[[f32; 2]], moving: &[bool]) -> Score {
    let distance = |at: usize| {
        length(std::array::from_fn::<f64, 2, _>(|axis| difference(rendered.flow_px[at][axis], truth[at][axis])))
    };
    let counts = |at: usize| moving[at] && truth[at].iter().all(|value| value.is_finite());
    mean_over(moving.len(), counts, distance, "no moving surface stays in sight")
}

/// Mean |rendered − true| depth where both show a surface.
fn depth_error(rendered: &SurfaceMaps, truth: &[f32]) -> Score {
    let counts = |at: usize| truth[at] > 0.0 && rendered.alpha[at] >= SurfaceMaps::COVERED;
    let distance = |at: usize| difference(rendered.depth_view[at], truth[at]).abs();
    mean_over(truth.len(), counts, distance, "no pixel with a surface in render and truth")
}

/// Share of the truly covered pixels where the render shows nothing.
fn hole_area(rendered: &SurfaceMaps, truth: &[f32]) -> Score {
    let is_hole = |at: usize| f64::from(u8::from(rendered.alpha[at] < SurfaceMaps::COVERED));
    mean_over(truth.len(), |at| truth[at] > 0.0, is_hole, "the truth shows no surface")
}

/// Share of all pixels where the render shows a surface before the true one, or where there is none.
fn floater_area(rendered: &SurfaceMaps, truth: &[f32]) -> Score {
    let floats = |at: usize| {
        let before = truth[at] <= 0.0 || rendered.depth_view[at] < FLOATS_BEFORE * truth[at];
        f64::from(u8::from(rendered.alpha[at] >= SurfaceMaps::COVERED && before))
    };
    mean_over(truth.len(), |_| true, floats, "no pixels")
}

/// The mean of `value` over the pixels that count.
fn mean_over(
    pixels: usize,
    counts: impl Fn(usize) -> bool,
    value: impl Fn(usize) -> f64,
    why_undefined: &str,
) -> Score {
    let (mut sum, mut count) = (0.0, 0_usize);
    for at in (0..pixels).filter(|&at| counts(at)) {
        sum += value(at);
        count += 1;
    }
    if count == 0 { Score::undefined(why_undefined) } else { Score::Value(sum / count as f64) }
}

fn difference(rendered: f32, truth: f32) -> f64 {
    f64::from(rendered) - f64::from(truth)
}

fn length<const N: usize>(vector: [f64; N]) -> f64 {
    vector.iter().map(|value| value * value).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 4;

    /// A row of four pixels: a moving surface that stays in sight, one that leaves, one that stands still, and nothing.
    fn truths() -> Truths {
        let (width, height) = (PIXELS as u32, 1);
        let nothing = [f32::NAN; 2];
        Truths {
            depth: Some(DepthMap { width, height, depth_view: vec![2.0, 2.0, 4.0, 0.0] }),
            velocity: Some(VelocityMap {
                width,
                height,
                velocity_world: vec![[3.0, 0.0, 4.0], [0.0, 1.0, 0.0], [0.0; 3], [0.0; 3]],
            }),
            flow: Some(FlowMap { width, height, flow_px: vec![[6.0, 8.0], nothing, [0.0; 2], nothing] }),
        }
    }

    /// What a perfect render shows.
    fn perfect() -> SurfaceMaps {
        SurfaceMaps {
            width: PIXELS as u32,
            height: 1,
            alpha: vec![1.0, 1.0, 1.0, 0.0],
            depth_view: vec![2.0, 2.0, 4.0, 0.0],
            velocity_world: vec![[3.0, 0.0, 4.0], [0.0, 1.0, 0.0], [0.0; 3], [0.0; 3]],
            flow_px: vec![[6.0, 8.0], [0.0; 2], [0.0; 2], [0.0; 2]],
        }
    }

    fn judged(rendered: &SurfaceMaps, truths: &Truths) -> BTreeMap<Metric, Score> {
        judge_surfaces(rendered, truths, &Metric::ALL.into())
    }

    #[test]
    fn a_perfect_render_has_no_error() {
        let scores = judged(&perfect(), &truths());
        assert_eq!(scores.len(), 5);
        assert!(scores.values().all(|score| *score == Score::Value(0.0)), "{scores:?}");
    }

    #[test]
    fn standing_still_costs_the_mean_speed_and_the_whole_flow() {
        let mut still = perfect();
        still.velocity_world.fill([0.0; 3]);
        still.flow_px.fill([0.0; 2]);
        let scores = judged(&still, &truths());
        assert_eq!(scores[&Metric::VelocityError], Score::Value((5.0 + 1.0) / 2.0));
        assert_eq!(scores[&Metric::FlowError], Score::Value(10.0), "over the one pixel that stays in sight");
    }

    #[test]
    fn holes_and_floaters_are_shares_of_pixels() {
        let mut bad = perfect();
        bad.alpha = vec![0.4, 1.0, 1.0, 0.9];
        bad.depth_view = vec![0.0, 1.0, 4.0, 3.0];
        let scores = judged(&bad, &truths());
        assert_eq!(scores[&Metric::HoleArea], Score::Value(1.0 / 3.0));
        assert_eq!(scores[&Metric::FloaterArea], Score::Value(2.0 / 4.0), "one nearer, one where nothing is");
        assert_eq!(scores[&Metric::DepthError], Score::Value(1.0 / 2.0));
    }

    #[test]
    fn without_truth_there_is_no_figure_and_without_motion_no_value() {
        assert!(judged(&perfect(), &Truths::default()).is_empty());
        let mut still = truths();
        still.velocity.as_mut().unwrap().velocity_world.fill([0.0; 3]);
        let scores = judged(&perfect(), &still);
        assert_eq!(scores[&Metric::VelocityError], Score::undefined(NOTHING_MOVES));
        assert!(scores[&Metric::FlowError].value().is_none());
        assert_eq!(scores[&Metric::HoleArea], Score::Value(0.0));
    }

    #[test]
    fn the_moving_part_is_judged_alone() {
        let plane = |values: [f64; 2]| values.to_vec();
        let image = |values: [f64; 2]| Image { width: 2, height: 1, planes: [0, 1, 2].map(|_| plane(values)) };
        let (render, truth) = (image([0.5, 0.9]), image([0.4, 0.1]));
        let (score, error) = psnr_of_moving(&render, &truth, &[true, false]);
        assert!((score.value().unwrap() - 20.0).abs() <= 1e-9);
        assert_eq!(error.unwrap().pixels, 1);
        assert_eq!(psnr_of_moving(&render, &truth, &[false; 2]), (Score::undefined(NOTHING_MOVES), None));
    }
}
