//! Metrics of rendered surfaces against maps that are exact at pixel centres.
//!
//! Each metric is a mean over pixels of one image: those that the ground truth covers, or those whose surface moves.

use std::collections::{BTreeMap, BTreeSet};

use rendering::SurfaceMaps;
use scene::{DepthMap, FlowMap, LabelMap, VelocityMap};

use super::metric::Metric;
use super::psnr::psnr_from_mse;
use super::score::Score;
use crate::image_file::Image;

/// Minimum speed of a moving surface, in units of the scene ([`scene::SceneScale::unit`]) per second: far below real motion,
/// far above the rounding of positions.
const MOVING: f64 = 1e-3;
/// A rendered surface nearer than this share of the true depth is a floater.
const FLOATS_BEFORE: f32 = 0.9;

/// The exact maps of one view; maps that the capture lacks are `None`.
#[derive(Clone, Debug)]
pub(crate) struct Truths {
    /// The unit of the scene's lengths, in scene units ([`scene::SceneScale::unit`]).
    pub(crate) unit: f64,
    /// View-space z; 0 where it is unknown or no surface is visible.
    pub(crate) depth: Option<DepthMap>,
    /// Pixels that show no surface, from alpha; without alpha, no pixel is known to be empty.
    pub(crate) empty: Option<Vec<bool>>,
    /// Velocity of the visible surface.
    pub(crate) velocity: Option<VelocityMap>,
    /// Flow to the next frame; NaN where it is undefined.
    pub(crate) flow: Option<FlowMap>,
}

impl Truths {
    /// Whether the surface of each pixel moves; `None` without a velocity map.
    pub(crate) fn moving(&self) -> Option<Vec<bool>> {
        let is_moving = |velocity: &[f32; 3]| length(velocity.map(f64::from)) > MOVING * self.unit;
        Some(self.velocity.as_ref()?.velocity_world.iter().map(is_moving).collect())
    }
}

/// The wanted metrics whose exact maps exist.
pub(crate) fn surface_scores(
    rendered: &SurfaceMaps,
    truths: &Truths,
    wanted: &BTreeSet<Metric>,
) -> BTreeMap<Metric, Score> {
    let moving = truths.moving();
    let depth = truths.depth.as_ref().map(|map| map.depth_view.as_slice());
    let velocity = truths.velocity.as_ref().map(|map| map.velocity_world.as_slice());
    let flow = truths.flow.as_ref().map(|map| map.flow_px.as_slice());
    let scores = [
        (
            Metric::VelocityError,
            velocity.zip(moving.as_deref()).map(|(truth, moving)| velocity_error(rendered, truth, moving)),
        ),
        (Metric::FlowError, flow.zip(moving.as_deref()).map(|(truth, moving)| flow_error(rendered, truth, moving))),
        (Metric::DepthError, depth.map(|truth| depth_error(rendered, truth))),
        (Metric::HoleArea, depth.map(|truth| hole_area(rendered, truth))),
        (Metric::FloaterArea, depth.map(|truth| floater_area(rendered, truth, truths.empty.as_deref()))),
    ];
    let wanted = |(metric, score): (Metric, Option<Score>)| wanted.contains(&metric).then_some((metric, score?));
    scores.into_iter().filter_map(wanted).collect()
}

/// The scores of a render without motion in the requested and defined metrics of motion.
pub(crate) fn scores_without_motion(truths: &Truths, wanted: &BTreeSet<Metric>) -> BTreeMap<Metric, f64> {
    let Some((velocity, moving)) = truths.velocity.as_ref().zip(truths.moving()) else { return BTreeMap::new() };
    let pixels = moving.len();
    let still = SurfaceMaps {
        velocity_world: vec![[0.0; 3]; pixels],
        flow_px: vec![[0.0; 2]; pixels],
        ..SurfaceMaps::default()
    };
    let flow = truths.flow.as_ref().map(|flow| flow_error(&still, &flow.flow_px, &moving));
    let scores = [
        (Metric::VelocityError, Some(velocity_error(&still, &velocity.velocity_world, &moving))),
        (Metric::FlowError, flow),
    ];
    let wanted = scores.into_iter().filter(|(metric, _)| wanted.contains(metric));
    wanted.filter_map(|(metric, score)| Some((metric, score?.value()?))).collect()
}

/// PSNR over the pixels whose true surface moves, with its mean squared error and number of pixels.
pub(crate) fn psnr_of_moving(render: &Image, truth: &Image, moving: &[bool]) -> (Score, Option<MovingError>) {
    let pixels = moving.iter().filter(|moving| **moving).count();
    if pixels == 0 {
        return (Score::undefined(NOTHING_MOVES), None);
    }
    let squared = |at: usize| (0..3).map(|c| (render.planes[c][at] - truth.planes[c][at]).powi(2)).sum::<f64>();
    let sum: f64 = (0..moving.len()).filter(|&at| moving[at]).map(squared).sum();
    let mse = sum / (3 * pixels) as f64;
    (Score::Value(psnr_from_mse(mse)), Some(MovingError { mse, pixels }))
}

/// The squared error of one image on moving surfaces.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MovingError {
    /// Mean squared error over pixels and channels.
    pub mse: f64,
    /// Number of pixels whose surface moves.
    pub pixels: usize,
}

/// Reason for an undefined metric of moving surfaces.
const NOTHING_MOVES: &str = "nothing moves in the image";

/// Intersection over union of the covered pixels where most of the weight is of Gaussians that move, and the pixels with a
/// label; undefined where no pixel has one.
pub(crate) fn silhouette_iou(rendered: &SurfaceMaps, labels: &LabelMap) -> Score {
    let (mut both, mut either, mut labelled) = (0.0, 0.0, 0_usize);
    for (at, &label) in labels.labels.iter().enumerate() {
        let moves = rendered.alpha[at] >= SurfaceMaps::COVERED && rendered.moving[at] >= 0.5;
        labelled += usize::from(label != 0);
        both += f64::from(u8::from(moves && label != 0));
        either += f64::from(u8::from(moves || label != 0));
    }
    if labelled == 0 { Score::undefined(NOTHING_MOVES) } else { Score::Value(both / either) }
}

/// Mean distance between rendered and true velocity over moving surfaces; holes have velocity 0.
fn velocity_error(rendered: &SurfaceMaps, truth: &[[f32; 3]], moving: &[bool]) -> Score {
    let distance = |at: usize| {
        length(std::array::from_fn::<f64, 3, _>(|axis| difference(rendered.velocity_world[at][axis], truth[at][axis])))
    };
    mean_over(moving.len(), |at| moving[at], distance, NOTHING_MOVES)
}

/// Mean distance in pixels between rendered and true flow over moving surfaces that stay visible.
fn flow_error(rendered: &SurfaceMaps, truth: &[[f32; 2]], moving: &[bool]) -> Score {
    let distance = |at: usize| {
        length(std::array::from_fn::<f64, 2, _>(|axis| difference(rendered.flow_px[at][axis], truth[at][axis])))
    };
    let counts = |at: usize| moving[at] && truth[at].iter().all(|value| value.is_finite());
    mean_over(moving.len(), counts, distance, "no moving surface stays visible")
}

/// Mean |rendered − true| depth where both images show a surface.
fn depth_error(rendered: &SurfaceMaps, truth: &[f32]) -> Score {
    let counts = |at: usize| truth[at] > 0.0 && rendered.alpha[at] >= SurfaceMaps::COVERED;
    let distance = |at: usize| difference(rendered.depth_view[at], truth[at]).abs();
    mean_over(truth.len(), counts, distance, "render and ground truth have no common surface pixel")
}

/// Share of the covered pixels of the ground truth where the render shows no surface.
fn hole_area(rendered: &SurfaceMaps, truth: &[f32]) -> Score {
    let is_hole = |at: usize| f64::from(u8::from(rendered.alpha[at] < SurfaceMaps::COVERED));
    mean_over(truth.len(), |at| truth[at] > 0.0, is_hole, "the ground truth shows no surface")
}

/// Share of the pixels with true depth or no true surface where the render shows a surface in front of the true one, or a
/// surface where there is none.
fn floater_area(rendered: &SurfaceMaps, truth: &[f32], empty: Option<&[bool]>) -> Score {
    let is_known = |at: usize| truth[at] > 0.0 || empty.is_some_and(|empty| empty[at]);
    let floats = |at: usize| {
        let before = truth[at] <= 0.0 || rendered.depth_view[at] < FLOATS_BEFORE * truth[at];
        f64::from(u8::from(rendered.alpha[at] >= SurfaceMaps::COVERED && before))
    };
    mean_over(truth.len(), is_known, floats, "the ground truth has neither depth nor empty pixels")
}

/// The mean of `value` over the counted pixels.
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

    /// A row of four pixels: a moving surface that stays visible, one that leaves the image, a static one, and empty space.
    fn truths() -> Truths {
        let (width, height) = (PIXELS as u32, 1);
        let nothing = [f32::NAN; 2];
        Truths {
            unit: 1.0,
            depth: Some(DepthMap { width, height, depth_view: vec![2.0, 2.0, 4.0, 0.0] }),
            empty: Some(vec![false, false, false, true]),
            velocity: Some(VelocityMap {
                width,
                height,
                velocity_world: vec![[3.0, 0.0, 4.0], [0.0, 1.0, 0.0], [0.0; 3], [0.0; 3]],
            }),
            flow: Some(FlowMap { width, height, flow_px: vec![[6.0, 8.0], nothing, [0.0; 2], nothing] }),
        }
    }

    /// A view without maps.
    fn without_maps() -> Truths {
        Truths { depth: None, empty: None, velocity: None, flow: None, ..truths() }
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
            moving: vec![1.0, 1.0, 0.0, 0.0],
        }
    }

    fn scores(rendered: &SurfaceMaps, truths: &Truths) -> BTreeMap<Metric, Score> {
        surface_scores(rendered, truths, &Metric::ALL.into())
    }

    #[test]
    fn a_perfect_render_has_no_error() {
        let scores = scores(&perfect(), &truths());
        assert_eq!(scores.len(), 5);
        assert!(scores.values().all(|score| *score == Score::Value(0.0)), "{scores:?}");
    }

    #[test]
    fn a_static_render_has_the_mean_speed_as_error() {
        let mut still = perfect();
        still.velocity_world.fill([0.0; 3]);
        still.flow_px.fill([0.0; 2]);
        let scores = scores(&still, &truths());
        assert_eq!(scores[&Metric::VelocityError], Score::Value((5.0 + 1.0) / 2.0));
        assert_eq!(scores[&Metric::FlowError], Score::Value(10.0), "over the one pixel that stays visible");
    }

    #[test]
    fn what_moves_does_not_depend_on_the_unit_of_length() {
        let moving = |unit: f64, scale: f32| {
            let mut scaled = Truths { unit, ..truths() };
            let velocities = &mut scaled.velocity.as_mut().unwrap().velocity_world;
            velocities.iter_mut().flatten().for_each(|value| *value *= scale);
            scaled.moving().unwrap()
        };
        assert_eq!(moving(1.0, 1.0), [true, true, false, false]);
        assert_eq!(moving(3e-4, 3e-4), moving(1.0, 1.0), "speeds of 0.0015 and 0.0003 scene units per second");
        assert_eq!(moving(1e3, 1e3), moving(1.0, 1.0));
        assert_eq!(moving(1.0, 3e-4), [true, false, false, false], "slow for a scene of this unit");
    }

    #[test]
    fn no_motion_scores_like_a_static_render() {
        let mut still = perfect();
        still.velocity_world.fill([0.0; 3]);
        still.flow_px.fill([0.0; 2]);
        let trivial = scores_without_motion(&truths(), &Metric::ALL.into());
        assert_eq!(trivial.keys().copied().collect::<Vec<_>>(), [Metric::VelocityError, Metric::FlowError]);
        let scores = scores(&still, &truths());
        assert!(trivial.iter().all(|(metric, score)| scores[metric] == Score::Value(*score)), "{trivial:?}");
        assert!(scores_without_motion(&without_maps(), &Metric::ALL.into()).is_empty());
        let mut nothing_moves = truths();
        nothing_moves.velocity.as_mut().unwrap().velocity_world.fill([0.0; 3]);
        assert!(scores_without_motion(&nothing_moves, &Metric::ALL.into()).is_empty());
    }

    #[test]
    fn the_silhouette_is_where_most_of_the_weight_moves() {
        let labels = |labels: [u8; 4]| LabelMap { width: 4, height: 1, labels: labels.to_vec() };
        assert_eq!(silhouette_iou(&perfect(), &labels([3, 1, 0, 0])), Score::Value(1.0));
        assert_eq!(silhouette_iou(&perfect(), &labels([1, 0, 1, 0])), Score::Value(1.0 / 3.0));
        let thin = SurfaceMaps { alpha: vec![0.4, 1.0, 1.0, 0.0], ..perfect() };
        assert_eq!(silhouette_iou(&thin, &labels([1, 1, 0, 0])), Score::Value(0.5), "an uncovered pixel shows nothing");
        assert!(silhouette_iou(&perfect(), &labels([0; 4])).value().is_none());
    }

    #[test]
    fn holes_and_floaters_are_shares_of_pixels() {
        let mut bad = perfect();
        bad.alpha = vec![0.4, 1.0, 1.0, 0.9];
        bad.depth_view = vec![0.0, 1.0, 4.0, 3.0];
        let scores = scores(&bad, &truths());
        assert_eq!(scores[&Metric::HoleArea], Score::Value(1.0 / 3.0));
        assert_eq!(
            scores[&Metric::FloaterArea],
            Score::Value(2.0 / 4.0),
            "one nearer surface, one surface in empty space"
        );
        assert_eq!(scores[&Metric::DepthError], Score::Value(1.0 / 2.0));
    }

    #[test]
    fn a_surface_at_unknown_depth_is_no_floater() {
        let floaters = |rendered: &SurfaceMaps, truths: &Truths| scores(rendered, truths)[&Metric::FloaterArea].clone();
        let mut holes = truths();
        holes.depth.as_mut().unwrap().depth_view[0] = 0.0;
        assert_eq!(floaters(&perfect(), &holes), Score::Value(0.0));
        let mut nearer = perfect();
        nearer.depth_view[1] = 1.0;
        assert_eq!(floaters(&nearer, &holes), Score::Value(1.0 / 3.0), "the unknown pixel is left out");
        holes.empty = None;
        assert_eq!(floaters(&nearer, &holes), Score::Value(1.0 / 2.0), "two pixels have depth");
        holes.depth.as_mut().unwrap().depth_view.fill(0.0);
        assert!(floaters(&perfect(), &holes).value().is_none());
    }

    #[test]
    fn metrics_without_maps_are_absent_and_without_motion_undefined() {
        assert!(scores(&perfect(), &without_maps()).is_empty());
        let mut still = truths();
        still.velocity.as_mut().unwrap().velocity_world.fill([0.0; 3]);
        let scores = scores(&perfect(), &still);
        assert_eq!(scores[&Metric::VelocityError], Score::undefined(NOTHING_MOVES));
        assert!(scores[&Metric::FlowError].value().is_none());
        assert_eq!(scores[&Metric::HoleArea], Score::Value(0.0));
    }

    #[test]
    fn psnr_of_moving_ignores_static_pixels() {
        let plane = |values: [f64; 2]| values.to_vec();
        let image = |values: [f64; 2]| Image { width: 2, height: 1, planes: [0, 1, 2].map(|_| plane(values)) };
        let (render, truth) = (image([0.5, 0.9]), image([0.4, 0.1]));
        let (score, error) = psnr_of_moving(&render, &truth, &[true, false]);
        assert!((score.value().unwrap() - 20.0).abs() <= 1e-9);
        assert_eq!(error.unwrap().pixels, 1);
        assert_eq!(psnr_of_moving(&render, &truth, &[false; 2]), (Score::undefined(NOTHING_MOVES), None));
    }
}
