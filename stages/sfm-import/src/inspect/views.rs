//! Consequences of the number and the positions of the training views for a reconstruction.

use glam::DVec3;
use scene::Split;

use crate::source::{Frame, SourceCapture};

/// Fewer training views leave most of a scene seen once: the sparse-view literature begins below it.
const FEW_VIEWS: usize = 10;
/// Largest distance between cameras, relative to their distance from the origin, that counts as one place.
const ONE_PLACE: f64 = 1e-6;

/// Problems that will degrade a training.
pub(super) fn warnings(source: &SourceCapture) -> Vec<String> {
    let train: Vec<&Frame> = source.frames.iter().filter(|frame| frame.split == Split::Train).collect();
    let mut warnings = Vec::new();
    if (1..FEW_VIEWS).contains(&train.len()) {
        warnings.push(format!("{} training views are few: expect holes and floaters in other views", train.len()));
    }
    let place = |frame: &&Frame| frame.camera_from_world.inverse().translation;
    let places: Vec<DVec3> = train.iter().map(place).collect();
    let is_one_place = |first: &DVec3| {
        let tolerance = ONE_PLACE * (1.0 + first.length());
        places.iter().all(|other| other.distance(*first) <= tolerance)
    };
    if places.len() > 1 && places.first().is_some_and(is_one_place) {
        warnings.push(
            "all training cameras are at one place: depth cannot be found; add cameras, or depth maps from an estimator"
                .into(),
        );
    }
    warnings
}
