//! The size of a scene, and the length that is the unit of constants in scene units.

use std::ops::RangeInclusive;

use glam::DVec3;

use super::{Capture, Split};
use crate::camera::{Camera, common_view_volume, spread};
use crate::statistics::median;

/// Factor on the radius of the camera positions (Kerbl et al. 2023, `getNerfppNorm`).
const EXTENT_MARGIN: f64 = 1.1;
/// Smallest extent of a scene, as a share of the distance of the cameras from it.
const MIN_EXTENT: f64 = 0.25;
/// The data sets whose papers state constants in the data set's own unit of length, and the range of camera distances
/// in which their captures are not scaled.
const PUBLISHED: [&str; 6] = ["nerfies", "dycheck", "n3v", "enerf-outdoor", "mobilestage", "cmu-panoptic"];
const PUBLISHED_DISTANCES: RangeInclusive<f64> = 1.0..=40.0;
/// The range of camera distances in which other captures are not scaled. D-NeRF and the synthetic scenes are at 4 units;
/// the learning rates of a field that is trained in an eight times larger unit are eight times too high.
const COMMON_DISTANCES: RangeInclusive<f64> = 1.75..=9.0;
/// The camera distance that other scenes are scaled to: that of the synthetic scenes for which most constants were chosen.
const TYPICAL_DISTANCE: f64 = 4.0;

/// Two lengths of a scene, both in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneScale {
    /// The size of the scene: 1.1 times the largest distance of a training camera from the mean of all training cameras
    /// (Kerbl et al. 2023), and at least a quarter of the viewing distance, so that a camera that hardly moves does not
    /// give a scene of almost zero size. If all training cameras share one position, it is half the diagonal of the
    /// bounds, or 1 without bounds.
    pub extent: f64,
    /// The length by which published constants in scene units (e.g. the near plane at 0.2) are multiplied: 1 if cameras
    /// are 1.75 to 9 units away from the scene, or 1 to 40 units in data sets whose papers state constants in their units;
    /// otherwise a quarter of the distance, so that the scene is trained like one with cameras 4 units away.
    pub unit: f64,
}

impl Capture {
    /// The size of the scene and the unit of published constants, from the training cameras.
    pub fn scale(&self) -> SceneScale {
        let cameras: Vec<Camera> = self.views_of(Split::Train).map(|(_, view)| view.camera).collect();
        let centers: Vec<DVec3> = cameras.iter().map(Camera::position_world).collect();
        let distance = viewing_distance(&cameras, &centers);
        let extent = match spread(&centers) {
            Some(radius) => (EXTENT_MARGIN * radius).max(MIN_EXTENT * distance),
            None => self.bounds_world.map_or(1.0, half_diagonal),
        };
        let is_published = PUBLISHED.contains(&self.protocol.dataset.as_str());
        let unscaled = if is_published { PUBLISHED_DISTANCES } else { COMMON_DISTANCES };
        let unit = if unscaled.contains(&distance) { 1.0 } else { distance / TYPICAL_DISTANCE };
        SceneScale { extent, unit }
    }
}

/// Median distance of the cameras from the centre of their common view volume; 1 without cameras.
fn viewing_distance(cameras: &[Camera], centers: &[DVec3]) -> f64 {
    let Some(volume) = common_view_volume(cameras) else { return 1.0 };
    let distance = median(centers.iter().map(|center| center.distance(volume.center_world)));
    distance.filter(|&distance| distance > 0.0).unwrap_or(1.0)
}

fn half_diagonal([low, high]: [[f64; 3]; 2]) -> f64 {
    0.5 * DVec3::from(low).distance(DVec3::from(high))
}
