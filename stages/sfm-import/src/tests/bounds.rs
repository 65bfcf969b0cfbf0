//! Bounds from cameras, clouds and files.

use glam::DVec3;
use scene::Camera;
use scene::camera::common_view_volume;

use super::support::intrinsics;
use crate::bounds::{StatedBounds, bounds};

/// Cameras on a circle around the origin.
fn circle() -> Vec<Camera> {
    let position = |index: i32| DVec3::new((0.5 * f64::from(index)).cos(), (0.5 * f64::from(index)).sin(), 0.4) * 5.0;
    (0..12).map(|index| Camera::look_at(intrinsics(), position(index), DVec3::ZERO, DVec3::Z)).collect()
}

#[test]
fn cameras_without_points_bound_what_they_have_in_common() {
    let cameras = circle();
    let expected = common_view_volume(&cameras).unwrap().bounds_world();
    assert_eq!(bounds(&cameras, &Vec::new(), &StatedBounds::default()), Some(expected));
    let few = vec![([50.0; 3], [0; 3]); 9];
    assert_eq!(bounds(&cameras, &few, &StatedBounds::default()), Some(expected), "nine points do not show an extent");
    let mut damaged = cameras.clone();
    damaged[0].camera_from_world.translation.x = f64::NAN;
    let found = bounds(&damaged, &Vec::new(), &StatedBounds::default()).unwrap();
    assert!(found.iter().flatten().all(|value| value.is_finite()), "{found:?}");
    assert_eq!(bounds(&[], &Vec::new(), &StatedBounds::default()), None);
}

#[test]
fn clouds_bound_the_scene_without_their_outliers() {
    let cloud: Vec<_> = (0..1000).map(|i| ([f64::from(i) / 500.0 - 1.0, 2.0, 0.0], [0; 3])).collect();
    let mut with_outlier = cloud.clone();
    with_outlier[7].0 = [1e5, -1e5, 1e5];
    for points in [cloud, with_outlier] {
        let found = bounds(&circle(), &points, &StatedBounds::default()).unwrap();
        for (found, expected) in found.iter().flatten().zip([-1.2, 2.0, 0.0, 1.2, 2.0, 0.0]) {
            assert!((found - expected).abs() <= 0.02, "{found} instead of {expected}");
        }
    }
}

#[test]
fn stated_bounds_take_precedence() {
    let cameras = circle();
    let seen = common_view_volume(&cameras).unwrap().bounds_world();
    let limit_world = Some([[-0.1, -99.0, -99.0], [99.0; 3]]);
    let stated = StatedBounds { limit_world, ..StatedBounds::default() };
    assert_eq!(bounds(&cameras, &Vec::new(), &stated), Some([[-0.1, seen[0][1], seen[0][2]], seen[1]]));
    let elsewhere = StatedBounds { limit_world: Some([[90.0; 3], [99.0; 3]]), ..StatedBounds::default() };
    assert_eq!(bounds(&cameras, &Vec::new(), &elsewhere), Some(seen), "cameras that look elsewhere decide");
    let exact_world = Some([[0.0; 3], [1.0; 3]]);
    assert_eq!(bounds(&cameras, &Vec::new(), &StatedBounds { exact_world, ..stated }), exact_world);
}
