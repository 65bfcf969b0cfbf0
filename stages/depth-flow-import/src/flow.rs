//! Optical flow from files: unit conversion and the forward–backward consistency check.

use glam::Vec2;
use scene::{FloatImage, FlowMap};

use crate::params::FlowParams;

/// Flow in pixels of the view, from a file with `1 / scale` times as many pixels per axis.
pub(crate) fn flow_map(values: &FloatImage, scale: [f32; 2]) -> FlowMap {
    let flow_px = values.values.chunks_exact(2).map(|flow| [flow[0] * scale[0], flow[1] * scale[1]]).collect();
    FlowMap { width: values.width, height: values.height, flow_px }
}

/// The forward flow f, with NaN where it leaves the image or is inconsistent with the backward flow b (if given):
/// `|f(x) + b(x + f(x))| > max_round_trip_px + max_round_trip_share · |f(x)|` (Sundaram et al. 2010).
pub(crate) fn consistent(forward: &FlowMap, backward: Option<&FlowMap>, params: &FlowParams) -> FlowMap {
    let (width, height) = (forward.width, forward.height);
    let keep = |(at, flow): (usize, &[f32; 2])| {
        let flow = Vec2::from(*flow);
        let start = Vec2::new((at as u32 % width) as f32 + 0.5, (at as u32 / width) as f32 + 0.5);
        let end = start + flow;
        let inside = end.x >= 0.0 && end.y >= 0.0 && end.x <= width as f32 && end.y <= height as f32;
        let limit_px = params.max_round_trip_px as f32 + params.max_round_trip_share as f32 * flow.length();
        let returns = backward.is_none_or(|backward| (flow + bilinear(backward, end)).length() <= limit_px);
        if inside && returns { flow.to_array() } else { [f32::NAN; 2] }
    };
    FlowMap { width, height, flow_px: forward.flow_px.iter().enumerate().map(keep).collect() }
}

/// Share of pixels with known flow, in [0, 1].
pub(crate) fn known_share(map: &FlowMap) -> f64 {
    let known = map.flow_px.iter().filter(|flow| flow[0].is_finite()).count();
    known as f64 / map.flow_px.len().max(1) as f64
}

/// Bilinear interpolation of the flow at a position, clamped at the border; NaN if any of the four pixels is unknown.
fn bilinear(map: &FlowMap, position: Vec2) -> Vec2 {
    let last = Vec2::new(map.width as f32 - 1.0, map.height as f32 - 1.0);
    let place = (position - 0.5).clamp(Vec2::ZERO, last);
    let low = place.floor();
    let share = place - low;
    let high = (low + 1.0).min(last);
    let at = |x: f32, y: f32| Vec2::from(map.flow_px[y as usize * map.width as usize + x as usize]);
    let top = at(low.x, low.y).lerp(at(high.x, low.y), share.x);
    let bottom = at(low.x, high.y).lerp(at(high.x, high.y), share.x);
    top.lerp(bottom, share.y)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(width: u32, height: u32, flow: impl Fn(f32, f32) -> [f32; 2]) -> FlowMap {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x as f32 + 0.5, y as f32 + 0.5)));
        FlowMap { width, height, flow_px: pixels.map(|(x, y)| flow(x, y)).collect() }
    }

    #[test]
    fn a_shift_is_kept_where_it_stays_inside() {
        let (forward, backward) = (map(8, 4, |_, _| [2.0, 0.0]), map(8, 4, |_, _| [-2.0, 0.0]));
        let kept = consistent(&forward, Some(&backward), &FlowParams::default());
        for (at, flow) in kept.flow_px.iter().enumerate() {
            assert_eq!(flow[0].is_finite(), at % 8 < 6, "pixel {at}: {flow:?}");
        }
        assert_eq!(known_share(&kept), 0.75);
        assert_eq!(known_share(&consistent(&forward, None, &FlowParams::default())), 0.75);
    }

    #[test]
    fn flow_that_does_not_return_is_dropped() {
        let forward = map(16, 16, |_, _| [3.0, 1.0]);
        // One patch has the backward flow of another motion, one has unknown backward flow.
        let backward = map(16, 16, |x, y| match (x, y) {
            (x, y) if x > 4.0 && x < 8.0 && y < 8.0 => [0.0, 0.0],
            (x, y) if x > 10.0 && x < 14.0 && y > 8.0 => [f32::NAN; 2],
            _ => [-3.0, -1.0],
        });
        let kept = consistent(&forward, Some(&backward), &FlowParams::default());
        let known = |x: usize, y: usize| kept.flow_px[y * 16 + x][0].is_finite();
        assert!(!known(3, 3) && !known(8, 9) && known(3, 12) && known(8, 3));
        let loose = FlowParams { max_round_trip_px: 10.0, ..FlowParams::default() };
        let kept = consistent(&forward, Some(&backward), &loose);
        assert!(kept.flow_px[3 * 16 + 3][0].is_finite(), "a larger limit keeps it");
    }

    #[test]
    fn a_linear_field_is_interpolated_exactly() {
        let field = map(9, 7, |x, y| [0.1 * x - 0.3 * y, 0.2 * y]);
        let found = bilinear(&field, Vec2::new(3.7, 4.1));
        assert!((found - Vec2::new(0.37 - 1.23, 0.82)).length() <= 1e-5, "{found}");
    }
}
