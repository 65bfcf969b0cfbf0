use glam::{DMat3, DVec2, DVec3};

use super::*;

fn camera() -> Camera {
    let intrinsics = Intrinsics { width: 64, height: 48, focal_x: 60.0, focal_y: 55.0, center_x: 33.0, center_y: 23.0 };
    Camera::look_at(intrinsics, DVec3::new(3.0, -2.0, 1.5), DVec3::new(0.0, 0.5, 0.0), DVec3::Z)
}

#[test]
fn projection_inverts_rays() {
    let camera = camera();
    for pixel in [DVec2::new(0.5, 0.5), DVec2::new(63.2, 7.0), DVec2::new(33.0, 23.0)] {
        let depth_view = 2.75;
        let world = camera.unproject(pixel, depth_view);
        let (projected, z) = camera.project(world).unwrap();
        assert!(projected.distance(pixel) <= 1e-11 && (z - depth_view).abs() <= 1e-12, "{projected} {z}");
    }
}

#[test]
fn look_at_centers_the_target_with_up_upwards() {
    let camera = camera();
    let (target, _) = camera.project(DVec3::new(0.0, 0.5, 0.0)).unwrap();
    assert!(target.distance(DVec2::new(33.0, 23.0)) <= 1e-11);
    let (above, _) = camera.project(DVec3::new(0.0, 0.5, 0.1)).unwrap();
    assert!(above.y < 22.0, "y points down in the image: {above}");
    assert!(camera.position_world().distance(DVec3::new(3.0, -2.0, 1.5)) <= 1e-12);
    assert!(camera.project(DVec3::new(6.0, -4.5, 3.0)).is_none(), "behind the camera");
}

#[test]
fn resizing_keeps_the_field_of_view() {
    let small = camera().resized(32, 12);
    let point = DVec3::new(0.3, 0.1, -0.2);
    let (pixel, _) = camera().project(point).unwrap();
    let (pixel_small, _) = small.project(point).unwrap();
    assert!(pixel_small.distance(pixel * DVec2::new(0.5, 0.25)) <= 1e-12);
}

#[test]
fn invalid_cameras_are_rejected() {
    camera().check().unwrap();
    let damage: [fn(&mut Camera); 6] = [
        |camera| camera.intrinsics.width = 0,
        |camera| camera.intrinsics.focal_x = f64::NAN,
        |camera| camera.intrinsics.center_y = f64::INFINITY,
        |camera| camera.camera_from_world.translation.x = f64::NAN,
        |camera| camera.camera_from_world.rotation *= 1.001,
        |camera| camera.camera_from_world.rotation *= DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0)),
    ];
    for (index, damage) in damage.iter().enumerate() {
        let mut camera = camera();
        damage(&mut camera);
        assert!(camera.check().is_err(), "damage {index} was accepted");
    }
}

/// Cameras of D-NeRF's field of view that look at `target` from the given positions.
fn looking_at(target: DVec3, positions: impl IntoIterator<Item = DVec3>) -> Vec<Camera> {
    let focal = 400.0 / 19.8_f64.to_radians().tan();
    let intrinsics =
        Intrinsics { width: 800, height: 800, focal_x: focal, focal_y: focal, center_x: 400.0, center_y: 400.0 };
    positions.into_iter().map(|position| Camera::look_at(intrinsics, position, target, DVec3::Z)).collect()
}

/// Positions on a hemisphere around `center`.
fn hemisphere(center: DVec3, distance: f64) -> Vec<DVec3> {
    let at = |index: usize| {
        let (azimuth, elevation) = (2.4 * index as f64, 0.1 + 0.05 * index as f64);
        let direction = DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
        center + distance * direction
    };
    (0..24).map(at).collect()
}

#[test]
fn cameras_on_a_hemisphere_share_the_ball_that_touches_their_frusta() {
    for (center, scale) in [
        (DVec3::ZERO, 1.0),
        (DVec3::ZERO, 1e-8),
        (DVec3::new(50.0, -3.0, 7.0), 0.01),
        (DVec3::new(-1.0, 2.0, 0.0), 300.0),
    ] {
        let cameras = looking_at(center, hemisphere(center, 4.0 * scale));
        let ball = common_view_volume(&cameras).unwrap();
        assert!(ball.center_world.distance(center) <= 1e-9 * (scale + center.length()), "{ball:?}");
        let expected = 4.0 * scale * 19.8_f64.to_radians().sin();
        assert!((ball.radius - expected).abs() <= 1e-6 * expected, "{ball:?}, expected {expected}");
    }
}

#[test]
fn parallel_cameras_share_a_ball_in_front_of_them() {
    let row: Vec<DVec3> = (0..5).map(|index| DVec3::new(0.25 * f64::from(index), 0.0, 0.0)).collect();
    let cameras: Vec<Camera> = row.iter().flat_map(|&at| looking_at(at + 10.0 * DVec3::Y, [at])).collect();
    let ball = common_view_volume(&cameras).unwrap();
    assert!(ball.center_world.distance(DVec3::new(0.5, 5.0, 0.0)) <= 1e-9, "{ball:?}");
    assert!(cameras.iter().all(|camera| camera.project(ball.center_world).is_some()) && ball.radius > 1.0);
}

#[test]
fn cameras_with_reversed_axes_face_away_from_where_they_meet() {
    let arc: Vec<DVec3> =
        (0..12).map(|at| 4.0 * DVec3::new((0.05 * f64::from(at)).cos(), (0.05 * f64::from(at)).sin(), 0.3)).collect();
    let cameras = looking_at(DVec3::ZERO, arc);
    assert_eq!(share_facing_away(&cameras), Some(0.0));
    let turned = |camera: &Camera| {
        let flip = glam::DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let RigidTransform { rotation, translation } = camera.camera_from_world;
        let camera_from_world = RigidTransform { rotation: flip * rotation, translation: flip * translation };
        Camera { camera_from_world, ..*camera }
    };
    let reversed: Vec<Camera> = cameras.iter().map(turned).collect();
    assert_eq!(share_facing_away(&reversed), Some(1.0));
    assert_eq!(share_facing_away(&[cameras[0]; 3]), None);
}

#[test]
fn every_set_of_cameras_has_a_finite_volume() {
    assert_eq!(common_view_volume(&[]), None);
    let lone = looking_at(DVec3::ZERO, [DVec3::new(0.0, -3.0, 1.0)]);
    let mut same_place = [lone[0]; 3];
    same_place[1].camera_from_world.translation.x += 1e-14; // rounding
    let outwards: Vec<Camera> =
        hemisphere(DVec3::ZERO, 2.0).into_iter().flat_map(|at| looking_at(3.0 * at, [at])).collect();
    for cameras in [&lone[..], &same_place, &outwards] {
        let Ball { center_world, radius } = common_view_volume(cameras).unwrap();
        assert!(center_world.is_finite() && radius.is_finite() && radius > 0.1, "{center_world} {radius}");
    }
}
