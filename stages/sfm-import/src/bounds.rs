//! The bounds of a scene: stated by its files, or around its cloud, or around the common view volume of its cameras.

use glam::DVec3;
use scene::camera::common_view_volume;
use scene::{Camera, inner_box};

use crate::cloud_file::Points;

/// The lower and the upper corner of a box in world coordinates.
pub(crate) type BoxWorld = [[f64; 3]; 2];

/// Margin around a cloud, relative to each side of its box: surfaces extend beyond the points on them.
const MARGIN: f64 = 0.1;
/// Fewer points than this do not show the extent of a scene.
const FEW_POINTS: usize = 100;

/// What the files of a capture state about its bounds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct StatedBounds {
    /// The bounds.
    pub(crate) exact_world: Option<BoxWorld>,
    /// A box that the scene does not exceed, but which may be far too large.
    pub(crate) limit_world: Option<BoxWorld>,
}

/// The bounds of what `cameras` see; `None` without a usable camera.
pub(crate) fn bounds(cameras: &[Camera], points: &Points, stated: &StatedBounds) -> Option<BoxWorld> {
    if stated.exact_world.is_some() {
        return stated.exact_world;
    }
    if points.len() >= FEW_POINTS {
        return Some(around(points));
    }
    let usable: Vec<Camera> = cameras.iter().filter(|camera| camera.check().is_ok()).copied().collect();
    let seen = common_view_volume(&usable)?.bounds_world();
    let [low, high] = seen.map(DVec3::from);
    let limited = stated.limit_world.map(|[least, most]| [low.max(least.into()), high.min(most.into())]);
    let limited = limited.filter(|[low, high]| low.cmplt(*high).all());
    Some(limited.map_or(seen, |corners| corners.map(|corner| corner.to_array())))
}

/// The box around a cloud, without outliers and with a margin.
fn around(points: &Points) -> BoxWorld {
    let [mut low, mut high] = inner_box(points.iter().map(|(position, _)| *position));
    for axis in 0..3 {
        let margin = MARGIN * (high[axis] - low[axis]);
        low[axis] -= margin;
        high[axis] += margin;
    }
    [low, high]
}
