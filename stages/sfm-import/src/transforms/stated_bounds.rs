//! Bounds that transforms files state.

use glam::DVec3;
use serde_json::Value;

use super::document::{Document, Offset, TransformsFile};
use crate::bounds::{BoxWorld, StatedBounds};

/// instant-ngp's default `scale`: its units per scene unit.
const NGP_SCALE: f64 = 0.33;
/// instant-ngp's default `offset`: the scene's origin in its units, the centre of the unit cube.
const NGP_OFFSET: [f64; 3] = [0.5; 3];

/// The bounds that a file states, in the original world.
pub(crate) fn stated_bounds(file: &TransformsFile, warnings: &mut Vec<String>) -> StatedBounds {
    let document = &file.document;
    let stated = document.aabb.as_ref().or_else(|| document.scene_box.as_ref()?.get("aabb"));
    let corners = stated.and_then(corners);
    if stated.is_some() && corners.is_none() {
        warnings.push("aabb is ignored: it is not two corners with three ordered numbers each".into());
    }
    StatedBounds {
        exact_world: corners.map(|corners| original(file, corners)),
        limit_world: instant_ngp_cube(document).map(|corners| original(file, corners)),
    }
}

/// Two ordered corners.
fn corners(stated: &Value) -> Option<BoxWorld> {
    let [low, high]: BoxWorld = serde_json::from_value(stated.clone()).ok()?;
    low.iter().zip(&high).all(|(low, high)| low < high).then_some([low, high])
}

/// The cube of side `aabb_scale` around the centre of instant-ngp's unit cube, outside of which it has no density.
fn instant_ngp_cube(document: &Document) -> Option<BoxWorld> {
    let side = document.aabb_scale.filter(|side| *side > 0.0 && side.is_finite())?;
    let scale = document.scale.unwrap_or(NGP_SCALE);
    let offset = match document.offset {
        Some(Offset::PerAxis(offset)) => offset,
        Some(Offset::Equal(offset)) => [offset; 3],
        None => NGP_OFFSET,
    };
    let corner = |sign: f64| offset.map(|offset| (0.5 + 0.5 * sign * side - offset) / scale);
    (scale > 0.0 && scale.is_finite()).then(|| [corner(-1.0), corner(1.0)])
}

/// The box around the corners of a box in the frame of the poses, in the original world.
fn original(file: &TransformsFile, corners: BoxWorld) -> BoxWorld {
    let corner =
        |index: usize| file.applied.undo(DVec3::from_array([0, 1, 2].map(|axis| corners[index >> axis & 1][axis])));
    let around = (1..8).map(corner).fold([corner(0); 2], |[low, high], point| [low.min(point), high.max(point)]);
    around.map(|corner| corner.to_array())
}
