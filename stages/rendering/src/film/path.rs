//! The path of a film's camera through the cameras of capture views.

use std::f64::consts::{PI, TAU};

use glam::{DMat3, DQuat, DVec3};
use scene::{Camera, RigidTransform};

/// A path that passes cameras in order at an even pace: around the point at which all of them look, or in straight
/// lines if there is no such point. The pinhole is that of the first camera.
pub(super) struct CameraPath<'a> {
    cameras: &'a [Camera],
    orbit: Option<Orbit>,
}

impl<'a> CameraPath<'a> {
    /// `cameras` must not be empty; with one camera, the path is constant.
    pub(super) fn through(cameras: &'a [Camera]) -> Self {
        Self { cameras, orbit: Orbit::of(cameras) }
    }

    /// The camera after a share of the path, in [0, 1].
    pub(super) fn at(&self, share: f64) -> Camera {
        let last = self.cameras.len() - 1;
        let place = share * last as f64;
        let first = (place as usize).min(last.saturating_sub(1));
        let [from, to] = [first, (first + 1).min(last)].map(|at| self.cameras[at].camera_from_world.inverse());
        let along = place - first as f64;
        let world_from_camera = match &self.orbit {
            Some(orbit) => orbit.between(&from, &to, along),
            None => straight(&from, &to, along),
        };
        Camera { intrinsics: self.cameras[0].intrinsics, camera_from_world: world_from_camera.inverse() }
    }
}

fn straight(from: &RigidTransform, to: &RigidTransform, along: f64) -> RigidTransform {
    RigidTransform {
        rotation: slerp(from.rotation, to.rotation, along),
        translation: from.translation.lerp(to.translation, along),
    }
}

fn slerp(from: DMat3, to: DMat3, along: f64) -> DMat3 {
    DMat3::from_quat(DQuat::from_mat3(&from).slerp(DQuat::from_mat3(&to), along).normalize())
}

/// Spherical coordinates around the point that all cameras look at.
struct Orbit {
    focus_world: DVec3,
    /// Two horizontal axes and up, as columns.
    world_from_orbit: DMat3,
}

/// A position on an orbit.
#[derive(Clone, Copy)]
struct OrbitPlace {
    azimuth: f64,
    elevation: f64,
    distance: f64,
}

impl Orbit {
    /// Smallest determinant of the sum of the planes across the optical axes, divided by the cubed number of cameras.
    /// Below it, the axes are nearly parallel (5° apart for two cameras) and their intersection is ill-conditioned.
    const MIN_DETERMINANT: f64 = 1e-3;

    /// Returns `None` where the cameras share no focus: fewer than two cameras, parallel axes, or a camera that looks
    /// away.
    fn of(cameras: &[Camera]) -> Option<Self> {
        let poses: Vec<RigidTransform> = cameras.iter().map(|camera| camera.camera_from_world.inverse()).collect();
        // The point nearest to all optical axes: Σ (I − f·fᵀ)·(x − position) = 0.
        let across = |pose: &RigidTransform| {
            let forward = pose.rotation.z_axis;
            DMat3::IDENTITY - DMat3::from_cols(forward * forward.x, forward * forward.y, forward * forward.z)
        };
        let planes = poses.iter().map(across).fold(DMat3::ZERO, |sum, plane| sum + plane);
        if planes.determinant() < Self::MIN_DETERMINANT * (cameras.len() as f64).powi(3) {
            return None;
        }
        let sum: DVec3 = poses.iter().map(|pose| across(pose) * pose.translation).sum();
        let focus_world = planes.inverse() * sum;
        let looks_there = |pose: &RigidTransform| (focus_world - pose.translation).dot(pose.rotation.z_axis) > 0.0;
        let up = -poses.iter().map(|pose| pose.rotation.y_axis).sum::<DVec3>().try_normalize()?;
        let x = up.any_orthonormal_vector();
        let world_from_orbit = DMat3::from_cols(x, up.cross(x), up);
        poses.iter().all(looks_there).then_some(Self { focus_world, world_from_orbit })
    }

    /// Interpolates azimuth, elevation, distance and the camera's rotation relative to looking at the focus.
    fn between(&self, from: &RigidTransform, to: &RigidTransform, along: f64) -> RigidTransform {
        let [a, b] = [from, to].map(|pose| self.place(pose.translation));
        let turn = (b.azimuth - a.azimuth + PI).rem_euclid(TAU) - PI;
        let place = OrbitPlace {
            azimuth: a.azimuth + along * turn,
            elevation: a.elevation + along * (b.elevation - a.elevation),
            distance: a.distance + along * (b.distance - a.distance),
        };
        let facing = |place: OrbitPlace| self.world_from_orbit * place.facing_focus();
        let relative = |pose: &RigidTransform, place| facing(place).transpose() * pose.rotation;
        RigidTransform {
            rotation: facing(place) * slerp(relative(from, a), relative(to, b), along),
            translation: self.focus_world + self.world_from_orbit * (place.distance * place.direction()),
        }
    }

    fn place(&self, position_world: DVec3) -> OrbitPlace {
        let offset = self.world_from_orbit.transpose() * (position_world - self.focus_world);
        OrbitPlace {
            azimuth: offset.y.atan2(offset.x),
            elevation: offset.z.atan2(offset.truncate().length()),
            distance: offset.length(),
        }
    }
}

impl OrbitPlace {
    /// The unit vector from the focus, in axes of the orbit.
    fn direction(self) -> DVec3 {
        let ((sin_a, cos_a), (sin_e, cos_e)) = (self.azimuth.sin_cos(), self.elevation.sin_cos());
        DVec3::new(cos_e * cos_a, cos_e * sin_a, sin_e)
    }

    /// The axes (right, down, forward) of a camera here that looks at the focus.
    fn facing_focus(self) -> DMat3 {
        let (sin, cos) = self.azimuth.sin_cos();
        let (forward, right) = (-self.direction(), DVec3::new(-sin, cos, 0.0));
        DMat3::from_cols(right, forward.cross(right), forward)
    }
}

#[cfg(test)]
mod tests {
    use scene::Intrinsics;

    use super::*;

    const INTRINSICS: Intrinsics =
        Intrinsics { width: 20, height: 10, focal_x: 9.0, focal_y: 9.0, center_x: 10.0, center_y: 5.0 };

    fn assert_passes(cameras: &[Camera]) {
        let path = CameraPath::through(cameras);
        for (index, camera) in cameras.iter().enumerate() {
            let found = path.at(index as f64 / (cameras.len() - 1).max(1) as f64);
            let [found, expected] = [found, *camera].map(|camera| camera.camera_from_world);
            assert!(found.rotation.abs_diff_eq(expected.rotation, 1e-9), "{index}: {found:?}");
            assert!(found.translation.abs_diff_eq(expected.translation, 1e-9), "{index}: {found:?}");
        }
    }

    #[test]
    fn cameras_with_one_focus_are_passed_around_it() {
        let focus = DVec3::new(0.3, -0.2, 0.1);
        let at = |x: f64, y: f64, z: f64| Camera::look_at(INTRINSICS, focus + DVec3::new(x, y, z), focus, DVec3::Z);
        let cameras = [at(3.0, 0.0, 1.0), at(0.0, 3.0, 1.0), at(-2.0, 0.5, 0.0)];
        assert_passes(&cameras);
        let path = CameraPath::through(&cameras);
        for step in 0..=20 {
            let camera = path.at(f64::from(step) / 20.0);
            let (pixel, depth) = camera.project(focus).unwrap();
            assert!(pixel.abs_diff_eq(glam::DVec2::new(10.0, 5.0), 1e-6), "{step}: {pixel}");
            assert!(depth > 2.0 && depth < 3.2, "{step}: {depth}");
        }
        let halfway = CameraPath::through(&cameras[..2]).at(0.5).position_world() - focus;
        assert!((halfway.x - halfway.y).abs() < 1e-9 && (halfway.length() - 10.0_f64.sqrt()).abs() < 1e-9, "{halfway}");
    }

    #[test]
    fn parallel_cameras_are_passed_in_a_straight_line() {
        let cameras = [0.0, 1.0].map(parallel_camera);
        assert!(Orbit::of(&cameras).is_none());
        assert_passes(&cameras);
        let position = CameraPath::through(&cameras).at(0.25).position_world();
        assert!(position.abs_diff_eq(DVec3::new(0.25, 0.0, 0.0), 1e-12));
    }

    #[test]
    fn a_single_camera_stands_still() {
        let cameras = [parallel_camera(1.0)];
        let found = CameraPath::through(&cameras).at(0.7).camera_from_world;
        assert!(found.translation.abs_diff_eq(cameras[0].camera_from_world.translation, 1e-12));
    }

    fn parallel_camera(x: f64) -> Camera {
        let position = DVec3::new(x, 0.0, 0.0);
        Camera::look_at(INTRINSICS, position, position + DVec3::Y, DVec3::Z)
    }
}
