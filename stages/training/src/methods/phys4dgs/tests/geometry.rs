//! Observations of a moving wall from a moving camera.

use glam::DVec3;
use scene::{Camera, FlowMap, Intrinsics, VelocityMap};
use shaders::arrays::rows::weighted_mean_squared_difference;
use shaders::check::{agree, test_gpu};
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::{Device, Real, Tape, Tensor};

use crate::data::FlowPrior;
use crate::methods::phys4dgs::observation::{
    Arrival, Observed, ProjectedPoints, displacement_map, flow_displacements, flow_map, true_displacements,
};

/// A camera at `position` that looks along +z.
fn camera_at(position: DVec3) -> Camera {
    let (width, height) = (40, 30);
    let intrinsics = Intrinsics { width, height, focal_x: 50.0, focal_y: 50.0, center_x: 20.0, center_y: 15.0 };
    Camera::look_at(intrinsics, position, position + DVec3::Z, DVec3::NEG_Y)
}

/// A wall at z = 4 that moves by (0.2, −0.1, 0.5) within two frames, while the camera moves by (0.3, 0, −0.2).
struct MovingWall {
    before: Camera,
    after: Camera,
    displacement: DVec3,
}

impl MovingWall {
    fn new() -> Self {
        let (before, after) = (camera_at(DVec3::ZERO), camera_at(DVec3::new(0.3, 0.0, -0.2)));
        Self { before, after, displacement: DVec3::new(0.2, -0.1, 0.5) }
    }

    fn depth<T: Real>(z: f64) -> Tensor<T> {
        Tensor::full([30, 40], T::from_f64(z))
    }

    /// Six points with weights: on the wall left of the centre, on the wall near the right border, behind the wall,
    /// outside the image, behind the camera, and on the wall with weight 0.
    fn points<T: Real>() -> [Tensor<T>; 2] {
        let points =
            [[-0.3, 0.4, 4.0], [1.5, 0.0, 4.0], [0.2, 0.2, 5.0], [9.0, 0.0, 4.0], [0.1, 0.1, -4.0], [0.1, 0.1, 4.0]];
        let values = points.as_flattened().iter().map(|&value| T::from_f64(value)).collect();
        let weights = [1.0, 1.0, 1.0, 1.0, 1.0, 0.0].map(T::from_f64);
        [Tensor::from_vec([6, 3], values), Tensor::from_vec([6], weights.to_vec())]
    }

    fn projected<T: Real>(&self, device: Device) -> ProjectedPoints<T> {
        let [points, weights] = Self::points();
        ProjectedPoints::of(device, [&points, &weights], &PinholeCamera::from(&self.before), 0.2, Self::depth(4.0))
    }

    fn flow(&self) -> FlowPrior {
        let flow_at = |pixel: usize| {
            let here = glam::DVec2::new((pixel % 40) as f64 + 0.5, (pixel / 40) as f64 + 0.5);
            let moved = self.before.ray_view(here) * 4.0 + self.displacement;
            let (there, _) = self.after.project(moved).unwrap();
            (there - here).to_array().map(|value| value as f32)
        };
        let map = FlowMap { width: 40, height: 30, flow_px: (0..1200).map(flow_at).collect() };
        FlowPrior { map, camera_to: self.after, time_to_secs: 1.0, view_to: None }
    }

    fn observed(&self, flow: &FlowPrior) -> Observed<f64> {
        self.observed_on(Device::Cpu, flow)
    }

    fn observed_on<T: Real>(&self, device: Device, flow: &FlowPrior) -> Observed<T> {
        // The wall moved 0.5 away and the camera 0.2 back.
        self.arrived_on(device, flow, [self.displacement; 6])
    }

    /// What the flow shows, if the model moves the points by these displacements.
    fn arrived_on<T: Real>(&self, device: Device, flow: &FlowPrior, by: [DVec3; 6]) -> Observed<T> {
        let [camera, camera_to] = [&self.before, &flow.camera_to].map(PinholeCamera::from);
        let [mut moved, _] = Self::points::<T>();
        let by = by.iter().flat_map(|by| by.to_array());
        moved.make_mut().iter_mut().zip(by).for_each(|(at, by)| *at = T::from_f64(at.to_f64() + by));
        let surface_depth = &Self::depth(4.7);
        let to = Arrival { camera: &camera_to, surface_depth, moved: &moved, frames: 2.0 };
        flow_displacements(&self.projected(device), &camera, &flow_map(&flow.map), &to)
    }
}

#[test]
fn flow_and_depth_recover_displacements_under_camera_motion() {
    let wall = MovingWall::new();
    let observed = wall.observed(&wall.flow());
    assert_eq!(
        observed.weights.as_slice(),
        [1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        "hidden points and points outside the image have no flow"
    );
    for row in 0..2 {
        let expected = (0.5 * wall.displacement).to_array();
        let error =
            observed.displacements.row(row).iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        // Flow is stored in f32 and interpolated.
        assert!(error <= 1e-3, "{:?}", observed.displacements.row(row));
    }
    // Planted fault: replacing the second camera with the first changes the result.
    let wrong = FlowPrior { camera_to: wall.before, ..wall.flow() };
    let off = (wall.observed(&wrong).displacements.row(0)[0] - 0.5 * wall.displacement.x).abs();
    assert!(off >= 0.1, "{off}");
}

#[test]
fn flow_into_holes_or_off_image_is_not_observed() {
    let wall = MovingWall::new();
    let mut flow = wall.flow();
    flow.map.flow_px.iter_mut().for_each(|flow| flow[0] += 12.0);
    assert_eq!(
        wall.observed(&flow).weights.as_slice(),
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        "the second point leaves the image"
    );
    flow.map.flow_px.fill([f32::NAN; 2]);
    let observed = wall.observed(&flow);
    assert_eq!(observed.weights.as_slice(), [0.0; 6]);
    assert!(observed.displacements.as_slice().iter().all(|&value| value == 0.0));
}

#[test]
fn flow_to_another_surface_is_not_observed() {
    let wall = MovingWall::new();
    let mut moved = [wall.displacement; 6];
    assert_eq!(wall.arrived_on::<f64>(Device::Cpu, &wall.flow(), moved).weights.as_slice()[..2], [1.0, 1.0]);
    // The model moves the first point off the surface that the flow leads to.
    moved[0].z -= 0.5;
    assert_eq!(wall.arrived_on::<f64>(Device::Cpu, &wall.flow(), moved).weights.as_slice()[..2], [0.0, 1.0]);
}

#[test]
fn changes_are_observed_where_both_motions_are() {
    let wall = MovingWall::new();
    let [earlier, mut later] = [0; 2].map(|_| wall.observed(&wall.flow()));
    later.weights.make_mut()[0] = 0.0;
    later.displacements.make_mut()[3] += 0.25;
    let change = Observed::change([&earlier, &later]);
    assert_eq!(change.weights.as_slice(), [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!([change.displacements.row(0), change.displacements.row(1)], [[0.0; 3], [0.25, 0.0, 0.0]]);
}

#[test]
fn exact_velocities_become_displacements_per_frame() {
    let wall = MovingWall::new();
    let velocity = VelocityMap { width: 40, height: 30, velocity_world: vec![[2.0, 0.0, -4.0]; 1200] };
    let observed = true_displacements(&wall.projected::<f64>(Device::Cpu), &displacement_map(&velocity, 0.25));
    assert_eq!(observed.weights.as_slice(), [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(observed.displacements.row(0), [0.5, 0.0, -1.0]);
}

#[test]
fn outliers_have_a_constant_gradient() {
    let wall = MovingWall::new();
    let observed = wall.observed(&wall.flow());
    let mut estimate = observed.displacements.clone();
    estimate.make_mut()[0] += 0.1;
    estimate.make_mut()[4] += 5.0;
    let near = |found: &[f64], expected: [f64; 18]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-12);
    let gradient = |estimate: &Tensor<f64>, limit: f64, least: f64| {
        gradient_of_mean(&observed.without_outliers(estimate, &Tensor::scalar(limit), least), estimate)
    };
    // The gradient of the mean over two points and three axes is a third of the distance within the limit, and of the
    // limit beyond it.
    let mut expected = [0.0; 18];
    (expected[0], expected[4]) = (0.1 / 3.0, 0.2 / 3.0);
    let found = gradient(&estimate, 0.2, 0.1);
    assert!(near(&found, expected), "{found:?}");
    assert!(near(&gradient(&estimate, 0.0, 0.2), expected), "the limit is at least `least`");
    // Nor does the gradient grow if all are outliers.
    estimate.make_mut()[0] += 7.0;
    expected[0] = 0.2 / 3.0;
    let found = gradient(&estimate, 0.2, 0.1);
    assert!(near(&found, expected), "{found:?}");
}

/// The gradient of the mean squared distance between an estimate [M, 3] and what was observed, by the estimate.
fn gradient_of_mean(observed: &Observed<f64>, estimate: &Tensor<f64>) -> Vec<f64> {
    let mut tape = Tape::new(Device::Cpu);
    let estimate = tape.leaf(estimate.clone());
    let [target, weights] = [&observed.displacements, &observed.weights].map(|of| tape.constant(of.clone()));
    let mean = weighted_mean_squared_difference(&mut tape, estimate, target, weights);
    tape.backward(&[(mean, Tensor::scalar(1.0))]).take(estimate).unwrap().into_vec()
}

#[test]
fn motion_along_a_ray_counts_as_much_as_depth_is_trusted() {
    let wall = MovingWall::new();
    let observed = wall.observed(&wall.flow());
    let ray = DVec3::from_slice(observed.rays.row(0));
    // The first point is seen from the origin.
    assert!(ray.dot(DVec3::new(-0.3, 0.4, 4.0).normalize()) >= 1.0 - 1e-9, "{ray}");
    let across = ray.any_orthonormal_vector();
    let mut estimate = observed.displacements.clone();
    let off = 0.3 * ray + 0.2 * across;
    estimate.make_mut()[..3].iter_mut().zip(off.to_array()).for_each(|(value, off)| *value += off);
    for (trust, along) in [(1.0, 0.3), (0.1, 0.03), (0.0, 0.0)] {
        let trusting = observed.trusting_depth(&estimate, trust);
        let left = DVec3::from_slice(estimate.row(0)) - DVec3::from_slice(trusting.displacements.row(0));
        assert!((left - (along * ray + 0.2 * across)).length() <= 1e-9, "{trust}: {left}");
        assert_eq!(trusting.weights, observed.weights);
    }
}

#[test]
fn outlier_limits_scale_with_the_median_observation() {
    let wall = MovingWall::new();
    let observed = wall.observed(&wall.flow());
    let length = observed.median_length(1e-3, 3.0).as_slice()[0];
    let expected = 1.5 * wall.displacement.length();
    assert!((length - expected).abs() <= 1e-2, "{length} instead of {expected}");
    // Static surfaces do not count: if only the first point moves, the median is that of the first.
    let mut mostly_still = observed;
    mostly_still.displacements.make_mut()[3..].fill(1e-6);
    mostly_still.weights = Tensor::full([6], 1.0);
    assert!((mostly_still.median_length(1e-3, 3.0).as_slice()[0] - expected).abs() <= 1e-2);
    assert!(mostly_still.median_length(0.0, 3.0).as_slice()[0] <= 1e-5);
    let mut nothing = wall.flow();
    nothing.map.flow_px.fill([f32::NAN; 2]);
    assert_eq!(wall.observed(&nothing).median_length(1e-3, 3.0).as_slice(), [0.0]);
}

#[test]
fn gpu_observations_agree_with_the_cpu() {
    let Some(gpu) = test_gpu() else { return };
    let wall = MovingWall::new();
    let mut flow = wall.flow();
    // A hole above the points.
    flow.map.flow_px[..200].fill([f32::NAN; 2]);
    let along_y = |pixel: usize| if pixel.is_multiple_of(7) { f32::NAN } else { 1.0 };
    let velocity_world = (0..1200).map(|pixel| [2.0, along_y(pixel), -4.0]).collect();
    let velocity = VelocityMap { width: 40, height: 30, velocity_world };
    let tensors = |device: Device| {
        let seen = wall.observed_on::<f32>(device, &flow);
        let limit = seen.median_length(1e-3, 0.5);
        let estimate = Tensor::from_vec([6, 3], (0..18).map(|at| at as f32 / 9.0).collect());
        let pulled = seen.without_outliers(&estimate, &limit, 1e-3);
        let exact = true_displacements(&wall.projected::<f32>(device), &displacement_map(&velocity, 0.25));
        [seen.displacements, seen.weights, limit, pulled.displacements, exact.displacements, exact.weights]
    };
    for (found, expected) in tensors(Device::Gpu(gpu)).iter().zip(tensors(Device::Cpu)) {
        agree(found, &expected, 1e-4).unwrap();
    }
}
