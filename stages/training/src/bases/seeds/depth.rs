//! The depth of a moving subject of which only the depth of the static surroundings is known.

use scene::{DepthMap, Mask};

/// The subject is placed this much nearer than its surroundings, so that they do not cover it.
const NEARER: f32 = 0.97;
/// Components with fewer pixels are noise of a mask: they get the depth of the surroundings.
const MIN_PIXELS: usize = 8;

/// The depth of a view whose map shows only the static scene: every connected part of the mask gets the depth at which
/// it touches the ground, i.e. that of the pixels below its lowest row, and stays in front of its surroundings.
pub(super) fn standing_on_ground(depth: &DepthMap, moving: &Mask) -> DepthMap {
    let (width, mut found) = (depth.width as usize, depth.clone());
    for component in moving.components().iter().filter(|component| component.len() >= MIN_PIXELS) {
        let lowest = component.iter().map(|at| at / width).max().unwrap_or(0);
        let below = (lowest + 1).min(depth.height as usize - 1);
        let feet = component.iter().filter(|&&at| at / width == lowest).map(|at| below * width + at % width);
        let mut depths: Vec<f32> = feet.map(|at| depth.depth_view[at]).filter(|&depth| depth > 0.0).collect();
        if depths.is_empty() {
            continue;
        }
        let middle = depths.len() / 2;
        let contact = *depths.select_nth_unstable_by(middle, f32::total_cmp).1;
        for &at in component {
            let behind = depth.depth_view[at];
            found.depth_view[at] = NEARER * if behind > 0.0 { contact.min(behind) } else { contact };
        }
    }
    found
}
