//! The depth of a moving subject of which only the depth of the static surroundings is known.

use scene::{DepthMap, Mask};

/// The subject is placed this much nearer than its surroundings, so that they do not cover it.
const NEARER: f32 = 0.97;
/// Components with fewer pixels are noise of a mask: they get the depth of the surroundings.
const MIN_PIXELS: usize = 8;

/// Training views before and after a view, whose contacts with the ground are compared with its own.
const WINDOW: usize = 4;

/// The depths of consecutive training views of a camera, whose maps show only the static scene: every connected part of a mask
/// gets the depth at which it touches the ground, i.e. that of the pixels below its lowest row, and stays in front of its
/// surroundings.
///
/// Depth that is interpolated between a few points differs between frames by up to a factor of thirty. The largest part of a
/// mask therefore gets the median of the views around.
pub(super) fn standing_on_ground(views: &[(&DepthMap, &Mask)]) -> Vec<DepthMap> {
    let parts: Vec<Vec<Part>> = views.iter().map(|&(depth, moving)| parts(depth, moving)).collect();
    let largest: Vec<Option<f32>> = parts.iter().map(|parts| parts.first().and_then(|part| part.contact)).collect();
    let maps = views.iter().zip(parts).zip(running_medians(&largest));
    maps.map(|((&(depth, _), parts), contact)| placed(depth, &parts, contact)).collect()
}

/// The depth of a view with its moving parts, the largest first, at their contacts with the ground; `contact` is that of the
/// largest part.
fn placed(depth: &DepthMap, parts: &[Part], contact: Option<f32>) -> DepthMap {
    let mut found = depth.clone();
    for (at, part) in parts.iter().enumerate() {
        let contact = if at == 0 { contact } else { part.contact };
        let Some(contact) = contact else { continue };
        for &pixel in &part.pixels {
            let behind = depth.depth_view[pixel];
            found.depth_view[pixel] = NEARER * if behind > 0.0 { contact.min(behind) } else { contact };
        }
    }
    found
}

/// A connected part of a mask.
struct Part {
    pixels: Vec<usize>,
    /// The depth at which it touches the ground, if that is known.
    contact: Option<f32>,
}

/// The connected parts of a mask, the largest first.
fn parts(depth: &DepthMap, moving: &Mask) -> Vec<Part> {
    let mut components = moving.components();
    components.retain(|component| component.len() >= MIN_PIXELS);
    components.sort_by_key(|component| std::cmp::Reverse(component.len()));
    components.into_iter().map(|pixels| Part { contact: contact(depth, &pixels), pixels }).collect()
}

/// The depth below the lowest row of a part of a mask.
fn contact(depth: &DepthMap, part: &[usize]) -> Option<f32> {
    let width = depth.width as usize;
    let lowest = part.iter().map(|at| at / width).max()?;
    let below = (lowest + 1).min(depth.height as usize - 1);
    let feet = part.iter().filter(|&&at| at / width == lowest).map(|at| below * width + at % width);
    median(feet.map(|at| depth.depth_view[at]).filter(|&depth| depth > 0.0).collect())
}

/// The median of the known values within [`WINDOW`] of each; `None` where there are none.
fn running_medians(values: &[Option<f32>]) -> Vec<Option<f32>> {
    let around = |at: usize| &values[at.saturating_sub(WINDOW)..(at + WINDOW + 1).min(values.len())];
    (0..values.len()).map(|at| median(around(at).iter().flatten().copied().collect())).collect()
}

/// The upper median.
fn median(mut values: Vec<f32>) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}
