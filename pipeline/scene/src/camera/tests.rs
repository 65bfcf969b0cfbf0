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
        let world = camera.camera_from_world.inverse().apply(camera.ray_view(pixel) * depth_view);
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
