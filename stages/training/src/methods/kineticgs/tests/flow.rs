//! Tests of the energy-flow targets and loss.

use glam::DVec3;
use scene::{Camera, DepthMap, FlowMap, Intrinsics};

use shaders::geometry::point_lookup::flow_targets;

use super::super::energy_flow::{FlowView, energy_flow};
use super::*;
use crate::data::{FlowPrior, ViewPriors};

/// A camera at the origin and a wall at depth 2 whose pixels flow two px to the right; `depth_to` is the depth at the
/// end of the flow.
fn wall(depth_to: Option<f32>) -> (Camera, ViewPriors, Supplements) {
    let (width, height) = (8, 8);
    let intrinsics = Intrinsics { width, height, focal_x: 8.0, focal_y: 8.0, center_x: 4.0, center_y: 4.0 };
    let camera = Camera::look_at(intrinsics, DVec3::ZERO, DVec3::Z, DVec3::NEG_Y);
    let map = |depth: f32| DepthMap { width, height, depth_view: vec![depth; 64] };
    let mut flow_px = vec![[2.0, 0.0]; 64];
    flow_px[0] = [f32::NAN; 2];
    let flow = FlowPrior {
        map: FlowMap { width, height, flow_px },
        camera_to: camera,
        time_to_secs: 0.5,
        view_to: depth_to.map(|_| 1),
    };
    let first = ViewPriors { depth: Some(map(2.0)), flow: Some(flow), ..ViewPriors::default() };
    let second = ViewPriors { depth: depth_to.map(map), ..ViewPriors::default() };
    let supplements = Supplements { priors: vec![first.clone(), second], ..Supplements::default() };
    (camera, first, supplements)
}

/// The target of a point in the test scene's first view with the camera of [`wall`], and its free direction.
fn target(depth_to: Option<f32>, position: DVec3) -> Option<[DVec3; 2]> {
    let dir = tempfile::tempdir().unwrap();
    let mut dataset = Dataset::load(TestScene::default().write(dir.path()), 1).unwrap();
    let (camera, _, supplements) = wall(depth_to);
    dataset.capture.views[0].camera = camera;
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let maps = FlowView::of(&dataset, &supplements, 0).unwrap().maps(Device::Cpu, &ViewConstants::default());
    let point = tape.constant(Tensor::from_vec([1, 3], position.to_array().to_vec()));
    let found = flow_targets(&mut tape, point, &maps);
    let rows = [found.positions, found.free].map(|var| DVec3::from_slice(tape.value(var).as_slice()));
    (tape.value(found.seen).as_slice() == [1.0]).then_some(rows)
}

#[test]
fn targets_follow_flow_and_depth() {
    // With a focal length of 8 px, two pixels are half a unit at depth 2 and one unit at depth 4.
    let seen = DVec3::new(0.1, 0.0, 2.0);
    let [position, free] = target(Some(4.0), seen).unwrap();
    assert!(position.distance(DVec3::new(0.1 * 2.0 + 1.0, 0.0, 4.0)) <= 1e-9 && free == DVec3::ZERO);
    let [position, free] = target(None, seen).unwrap();
    assert!(position.distance(DVec3::new(0.6, 0.0, 2.0)) <= 1e-9);
    assert!(free.distance(position.normalize()) <= 1e-9);
}

#[test]
fn hidden_or_unknown_points_have_no_target() {
    let hidden = [DVec3::new(0.1, 0.0, 2.2), DVec3::new(0.1, 0.0, 1.8), DVec3::new(9.0, 0.0, 2.0), DVec3::NEG_Z];
    assert!(hidden.iter().all(|&position| target(None, position).is_none()));
    // The first pixel has no flow.
    assert!(target(None, DVec3::new(-0.95, -0.95, 2.0)).is_none());
    assert!(target(None, DVec3::new(0.1, 0.0, 2.05)).is_some());
}

#[test]
fn moving_pixels_are_masked_in_coarse() {
    let world = World::new(&ALL, Settings::tiny(), COARSE);
    let (outcome, _) = world.step(COARSE, 3);
    let [moving, pixels] = outcome.skipped["moving pixels in coarse"];
    assert!(0 < moving && moving < pixels);
    let all_pixels = World::new(&ALL, Settings { coarse_all: true, ..Settings::tiny() }, COARSE);
    let (unmasked, _) = all_pixels.step(COARSE, 3);
    assert!(unmasked.skipped.is_empty());
    assert!(unmasked.losses()["photometric"] > outcome.losses()["photometric"]);
}

/// The energy-flow loss of three particles at (0.1, 0, 2) on the wall, displaced by `shift` along x at all times, and
/// its gradient with respect to the shift (x, y, z).
fn loss_and_gradient(depth_to: Option<f32>, shift: f64) -> (f64, Vec<f64>) {
    let mut world = World::fine(&[MOTION, MOMENTUM_INIT, ENERGY_FLOW]);
    let (camera, _, supplements) = wall(depth_to);
    world.dataset.capture.views[0].camera = camera;
    let maps = FlowView::of(&world.dataset, &supplements, 0).unwrap().maps(Device::Cpu, &ViewConstants::default());
    let mut positions = world.state.get("anchors.positions").unwrap().clone();
    for particle in positions.make_mut().as_chunks_mut::<3>().0.iter_mut().rev().take(3) {
        *particle = [0.1, 0.0, 2.0];
    }
    world.state.insert("anchors.positions", positions);
    let bias = "anchor_network.position.1.bias";
    world.state.insert(bias, Tensor::from_vec([3], vec![shift, 0.0, 0.0]));
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let model = world.state.bind(&mut tape, |name| name == bias);
    let particles = world.method.particles(&mut tape, &model, &world.dataset.scene);
    let moved = world.method.motion.at(&mut tape, &model, &particles, 0.0);
    let followed = energy_flow(&mut tape, &model, &world.method.motion, &particles, &moved, &maps, 0.25).unwrap();
    assert_eq!(tape.value(followed.count).as_slice(), [3.0]);
    let distance = followed.distance;
    let gradient = tape.backward(&[(distance, Tensor::scalar(1.0))]).take(model.get(bias)).unwrap();
    (tape.value(distance).as_slice()[0], gradient.into_vec())
}

#[test]
fn static_particles_are_pulled_along_the_flow() {
    // The field displaces particles equally at both times, so the target moves along and they miss it by half a unit.
    // Targets are observations, however, so the gradient only moves the particles.
    for shift in [0.0, 0.05] {
        let (distance, gradient) = loss_and_gradient(Some(2.0), shift);
        assert!((distance - 0.5).abs() <= 1e-9, "{distance}");
        let expected = [-1.0, 0.0, 0.0];
        assert!(
            gradient.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= 1e-9),
            "{gradient:?}"
        );
    }
}

#[test]
fn unknown_target_depth_leaves_the_ray_free() {
    let (distance, gradient) = loss_and_gradient(None, 0.0);
    let ray = DVec3::new(0.6, 0.0, 2.0).normalize();
    let missed = DVec3::new(-0.5, 0.0, 0.0);
    let across = missed - ray * ray.dot(missed);
    assert!((distance - across.length()).abs() <= 1e-9, "{distance}");
    let pull = across.normalize();
    assert!(DVec3::from_slice(&gradient).distance(pull) <= 1e-9, "{gradient:?}");
    assert!(pull.dot(ray).abs() <= 1e-12);
}
