//! The point behind one pixel.

use glam::{DVec2, DVec3};

use super::view::{Patch, View, correlation};

/// Depths that are tried, evenly spread in inverse depth: a step moves the projection by about a pixel.
const DEPTHS: usize = 96;
/// Least correlation, as the mean over the better half of the neighbours.
const LEAST_SCORE: f32 = 0.85;
/// Least margin of the best depth over all depths that are not adjacent to it.
const LEAST_LEAD: f32 = 0.04;
/// How far from the projection the patch is searched for in a neighbour, in steps.
const SEARCH_STEPS: i32 = 4;
/// The length of such a step in pixels.
const SEARCH_STEP_PX: f64 = 0.5;
/// Largest mean distance between the projections and the matches of the patch in the neighbours, in pixels of the matched size.
const MAX_ERROR_PX: f64 = 1.0;

/// A point that several views agree on.
pub(super) struct Found {
    pub(super) position: DVec3,
    pub(super) color: [u8; 3],
    /// Mean correlation with the better half of the neighbours.
    pub(super) score: f32,
    /// Mean distance between its projections and the matches of its patch in the neighbours, in pixels of the matched size.
    pub(super) error_px: f64,
    /// Distance to the next tried pixel, at the depth of the point.
    pub(super) spacing: f64,
}

/// The point behind a pixel, if one depth stands out and the neighbours confirm it; `step_px` is the distance to the next
/// pixel that is tried.
pub(super) fn point(view: &View, near: &[&View], pixel: DVec2, step_px: f64) -> Option<Found> {
    let own = view.patch(pixel, DVec2::X, DVec2::Y)?;
    let (depth_view, score) = best_depth(view, near, pixel, &own)?;
    let distances: Vec<f64> =
        near.iter().filter_map(|other| distance_px(view, other, pixel, depth_view, &own)).collect();
    let error_px = distances.iter().sum::<f64>() / distances.len().max(1) as f64;
    if distances.len() < 2 || !(error_px <= MAX_ERROR_PX) {
        return None;
    }
    let spacing = step_px * depth_view / view.camera.intrinsics.focal_x;
    Some(Found { position: view.point(pixel, depth_view), color: view.color_at(pixel), score, error_px, spacing })
}

/// The depth that stands out, between two tried ones, and its score.
fn best_depth(view: &View, near: &[&View], pixel: DVec2, own: &Patch) -> Option<(f64, f32)> {
    let [nearest, farthest] = view.depth_view;
    let step = (nearest.recip() - farthest.recip()) / (DEPTHS - 1) as f64;
    let depth_at = |index: f64| (farthest.recip() + index * step).recip();
    let score = |index: usize| {
        let compared = |other: &&View| {
            let [center, right, down] = other.appearance(view, pixel, depth_at(index as f64))?;
            Some(correlation(own, &other.patch(center, right, down)?))
        };
        better_half(near.iter().filter_map(compared).collect()).unwrap_or(-1.0)
    };
    let scores: Vec<f32> = (0..DEPTHS).map(score).collect();
    let (best, &top) = scores.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let rivals = scores.iter().enumerate().filter(|(index, _)| index.abs_diff(best) > 2).map(|(_, score)| *score);
    let stands_out = top >= LEAST_SCORE && rivals.fold(-1.0, f32::max) <= top - LEAST_LEAD;
    if !stands_out || best == 0 || best + 1 == DEPTHS {
        return None;
    }
    // The vertex of the parabola through the best depth and the two adjacent ones.
    let [before, after] = [scores[best - 1], scores[best + 1]];
    let offset = f64::from(0.5 * (before - after) / (before - 2.0 * top + after).min(-1e-6)).clamp(-0.5, 0.5);
    Some((depth_at(best as f64 + offset), top))
}

/// The mean over the better half of the values, at least two: the point may be occluded in a neighbour.
fn better_half(mut values: Vec<f32>) -> Option<f32> {
    if values.len() < 2 {
        return None;
    }
    values.sort_by(|a, b| b.total_cmp(a));
    let half = values.len().div_ceil(2).max(2);
    Some(values[..half].iter().sum::<f32>() / half as f32)
}

/// The distance between the projection of the point and the match of its patch in a neighbour; `None` without a match.
fn distance_px(view: &View, other: &View, pixel: DVec2, depth_view: f64, own: &Patch) -> Option<f64> {
    let [center, right, down] = other.appearance(view, pixel, depth_view)?;
    let range = -SEARCH_STEPS..=SEARCH_STEPS;
    let offsets = range.clone().flat_map(|y| range.clone().map(move |x| DVec2::new(f64::from(x), f64::from(y))));
    let compared = offsets.filter_map(|offset| {
        let offset = SEARCH_STEP_PX * offset;
        Some((correlation(own, &other.patch(center + offset, right, down)?), offset.length()))
    });
    let (best, distance) = compared.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best >= LEAST_SCORE).then_some(distance)
}
