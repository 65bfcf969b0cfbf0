//! Consequences of the number and the positions of the training views for a reconstruction.

use glam::DVec3;
use scene::Split;
use scene::camera::share_facing_away;

use crate::cloud_file::share_in_view;
use crate::params::Format;
use crate::source::{Frame, SourceCapture};

/// Fewer training views leave most of a scene seen once: the sparse-view literature begins below it.
const FEW_VIEWS: usize = 10;
/// Largest distance between cameras, relative to their distance from the origin, that counts as one place.
const ONE_PLACE: f64 = 1e-6;

/// Share of the cameras behind which the axes meet, from which the axes are probably reversed.
const FACING_AWAY: f64 = 0.9;

/// Share of the points in view below which a cloud does not belong to the cameras.
const HARDLY_ANY: f64 = 0.01;

/// Whether there are points, and the cameras see some of them.
pub(super) fn has_points_in_view(source: &SourceCapture) -> bool {
    share_in_view(&source.points, &source.cameras()) >= HARDLY_ANY
}

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
    if !source.points.is_empty() && !source.cameras().is_empty() && !has_points_in_view(source) {
        warnings.push(format!(
            "hardly any of the {} points is inside the view of a training camera: the cloud does not fit the poses, but sets the \
             bounds; check that both are in the same coordinates and unit, or remove the cloud",
            source.points.len()
        ));
    }
    let states_axes = matches!(source.format, Format::Blender | Format::Nerfstudio);
    let has_reversed_axes = || {
        share_facing_away(&source.cameras()).is_some_and(|share| share >= FACING_AWAY) && !has_points_in_view(source)
    };
    if states_axes && train.len() >= FEW_VIEWS && has_reversed_axes() {
        warnings.push(
            "the optical axes meet behind the cameras: if these look at one scene, and not around in it, their poses have OpenCV's \
             axes; negate the second and third column of each rotation in transform_matrix"
                .into(),
        );
    }
    warnings
}
