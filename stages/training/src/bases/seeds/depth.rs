//! The depth of a moving subject of which only the depth of the static surroundings is known.

use engine::{Failure, FailureKind};
use scene::statistics::median;
use scene::{DepthMap, Mask};

use crate::data::LoadedView;
use crate::method::Start;

/// Components with fewer pixels are noise of a mask: they get the depth of the surroundings.
const MIN_PIXELS: usize = 8;

/// Half-width of the running median of depths of contact with the ground, in training views.
const WINDOW: usize = 4;

/// The depth that is given for a view.
pub(super) fn given_depth<'a>(start: &Start<'a>, view: &LoadedView) -> anyhow::Result<&'a DepthMap> {
    let found = start.supplements.view(view.index).and_then(|priors| priors.depth.as_ref());
    let name = &start.dataset.capture.views[view.index].name;
    let missing = || {
        Failure::new(FailureKind::BadInput, format!("view {name} has no depth for its moving pixels"))
            .hint("wire a depth-flow-import job to the port priors")
    };
    let depth = found.ok_or_else(missing)?;
    let size = [depth.width as usize, depth.height as usize];
    if size != [view.camera.width, view.camera.height] {
        let message = format!("depth of view {name} has {size:?} pixels, its image another size");
        return Err(Failure::new(FailureKind::BadInput, message).hint("import both at one size").into());
    }
    Ok(depth)
}

/// Depth maps of consecutive training views of one camera with the depth of the moving subject, from maps that show
/// only the static scene.
///
/// Every connected part of a mask gets the depth at which it touches the ground, i.e. that of the pixels below its
/// lowest row. A pixel where the static scene is nearer gets that depth instead. Both are multiplied by
/// `relative_depth`, so that the surroundings do not cover the subject.
///
/// Depth that is interpolated between a few points differs between frames by up to a factor of thirty. The depth of
/// contact of the largest part is therefore a running median over the views.
pub(super) fn standing_on_ground(views: &[(&DepthMap, &Mask)], relative_depth: f64) -> Vec<DepthMap> {
    let mut parts: Vec<Vec<Part>> = views.iter().map(|&(depth, moving)| parts(depth, moving)).collect();
    let contacts: Vec<Option<f64>> =
        parts.iter().map(|parts| parts.first().and_then(|largest| largest.contact)).collect();
    for (parts, median) in parts.iter_mut().zip(running_medians(&contacts)) {
        if let Some(largest) = parts.first_mut() {
            largest.contact = median;
        }
    }
    views.iter().zip(parts).map(|(&(depth, _), parts)| placed(depth, &parts, relative_depth)).collect()
}

/// The depth of a view with its moving parts at their contacts with the ground.
fn placed(depth: &DepthMap, parts: &[Part], relative_depth: f64) -> DepthMap {
    let mut found = depth.clone();
    for part in parts {
        let Some(contact) = part.contact else { continue };
        for &pixel in &part.pixels {
            let behind = f64::from(depth.depth_view[pixel]);
            let nearest = if behind > 0.0 { contact.min(behind) } else { contact };
            found.depth_view[pixel] = (relative_depth * nearest) as f32;
        }
    }
    found
}

/// A connected part of a mask.
struct Part {
    pixels: Vec<usize>,
    /// The depth at which it touches the ground, if that is known.
    contact: Option<f64>,
}

/// The connected parts of a mask, the largest first.
fn parts(depth: &DepthMap, moving: &Mask) -> Vec<Part> {
    let mut components = moving.components();
    components.retain(|component| component.len() >= MIN_PIXELS);
    components.sort_by_key(|component| std::cmp::Reverse(component.len()));
    components.into_iter().map(|pixels| Part { contact: contact(depth, &pixels), pixels }).collect()
}

/// The depth below the lowest row of a part of a mask.
fn contact(depth: &DepthMap, part: &[usize]) -> Option<f64> {
    let width = depth.width as usize;
    let lowest = part.iter().map(|at| at / width).max()?;
    let below = (lowest + 1).min(depth.height as usize - 1);
    let feet = part.iter().filter(|&&at| at / width == lowest).map(|at| below * width + at % width);
    median(feet.map(|at| f64::from(depth.depth_view[at])).filter(|&depth| depth > 0.0))
}

/// The median of the known values within [`WINDOW`] of each; `None` where there are none.
fn running_medians(values: &[Option<f64>]) -> Vec<Option<f64>> {
    let around = |at: usize| &values[at.saturating_sub(WINDOW)..(at + WINDOW + 1).min(values.len())];
    (0..values.len()).map(|at| median(around(at).iter().flatten().copied())).collect()
}
