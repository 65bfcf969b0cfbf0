//! Momentum against closed forms, sampling against its distribution, and the stage on synthetic captures.

use depth_flow_import::{FlowPrior, PriorView, Priors, ViewMaps};
use engine::Artifact as _;
use glam::{DMat3, DVec3};
use scene::{Camera, Capture, DepthMap, FlowMap, Intrinsics, RigidTransform};
use scene_synthesis::{CameraPath, Params as SceneParams, SceneKind, Truth};

use crate::maps::MotionView;
use crate::momentum::{momentum, surface_point};
use crate::run::sample;
use crate::{Instants, Params, Particles, sampling};

const WIDTH: u32 = 20;
const HEIGHT: u32 = 12;
const FOCAL: f64 = 25.0;
const DEPTH: f32 = 3.0;

/// A camera at `x` on the x axis that looks along +z.
fn camera(x: f64) -> Camera {
    let intrinsics = Intrinsics {
        width: WIDTH,
        height: HEIGHT,
        focal_x: FOCAL,
        focal_y: FOCAL,
        center_x: f64::from(WIDTH) / 2.0,
        center_y: f64::from(HEIGHT) / 2.0,
    };
    let translation = DVec3::new(-x, 0.0, 0.0);
    Camera { intrinsics, camera_from_world: RigidTransform { rotation: DMat3::IDENTITY, translation } }
}

/// View number `index` of a camera that moves by `step` along x per frame in front of a wall at `DEPTH`. The left half
/// of the wall moves by `own_px` per frame.
fn wall(index: usize, step: f64, own_px: f32) -> MotionView {
    let pixels = (WIDTH * HEIGHT) as usize;
    let camera_px = (-FOCAL * step / f64::from(DEPTH)) as f32;
    let flow = |pixel: usize| {
        let moves = pixel % (WIDTH as usize) < WIDTH as usize / 2;
        [camera_px + if moves { own_px } else { 0.0 }, 0.0]
    };
    MotionView {
        camera: camera(index as f64 * step),
        depth: DepthMap { width: WIDTH, height: HEIGHT, depth_view: vec![DEPTH; pixels] },
        flow: Some(FlowPrior {
            map: FlowMap { width: WIDTH, height: HEIGHT, flow_px: (0..pixels).map(flow).collect() },
            camera_to: camera((index + 1) as f64 * step),
            time_to_secs: (index + 1) as f64,
            view_to: Some(index + 1),
        }),
    }
}

#[test]
fn only_object_motion_has_momentum() {
    let (step, own_px) = (0.06, 0.25); // the camera contributes half a pixel per frame
    let params = Params { strides: vec![1, 2], ..Params::default() };
    let found = momentum(&wall(0, step, own_px), &params, &|index| Ok(wall(index, step, own_px))).unwrap();
    assert_eq!(found.strides, [1, 2]);
    for (pixel, squared_norm) in found.squared_norm.iter().enumerate() {
        let column = pixel % WIDTH as usize;
        // In the other columns, the second step leaves the image or crosses the border of the moving half.
        let expected = match column {
            2..=8 => 2.0 * f64::from(own_px).powi(2),
            10.. => 0.0,
            _ => continue,
        };
        let error = (squared_norm.unwrap() - expected).abs();
        assert!(error <= 1e-6, "column {column}: {squared_norm:?} instead of {expected}");
    }
}

#[test]
fn a_wrong_pose_causes_momentum() {
    let mut view = wall(0, 0.06, 0.0);
    let params = Params { strides: vec![1], ..Params::default() };
    let largest = |view: &MotionView| {
        let found = momentum(view, &params, &|index| Ok(wall(index, 0.06, 0.0))).unwrap();
        found.squared_norm.into_iter().flatten().fold(0.0, f64::max)
    };
    assert!(largest(&view) <= 1e-12);
    view.flow.as_mut().unwrap().camera_to = view.camera;
    assert!(largest(&view) > 0.1);
}

#[test]
fn confidence_falls_with_slope_and_depth_error() {
    let params = Params { strides: vec![1], ..Params::default() };
    let (mut start, pixel) = (wall(0, 0.0, 0.5), 5 * WIDTH as usize + 4);
    let squared_norm = |start: &MotionView, next_depth: f32| {
        let next = |index: usize| {
            let mut view = wall(index, 0.0, 0.5);
            view.depth.depth_view[pixel + 1] = next_depth; // half a pixel to the right of a centre
            Ok(view)
        };
        momentum(start, &params, &next).unwrap().squared_norm
    };
    assert!((squared_norm(&start, DEPTH)[pixel].unwrap() - 0.25).abs() <= 1e-9);
    // A depth that deviates from its surroundings by 5 % gives a confidence of 1/e.
    let expected = 0.25 * (-2.0_f64).exp();
    assert!((squared_norm(&start, 1.05 * DEPTH)[pixel].unwrap() - expected).abs() <= 1e-6);
    start.depth.depth_view[pixel + 1] = 1.05 * DEPTH;
    assert!((squared_norm(&start, DEPTH)[pixel].unwrap() - expected).abs() <= 1e-6);
    // A pixel without depth is no candidate, and its neighbour has confidence 0.
    start.depth.depth_view[pixel + 1] = 0.0;
    let found = squared_norm(&start, DEPTH);
    assert_eq!((found[pixel], found[pixel + 1]), (Some(0.0), None));
    start.flow.as_mut().unwrap().map.flow_px[pixel - 1] = [f32::NAN; 2];
    assert_eq!(squared_norm(&start, DEPTH)[pixel - 1], Some(0.0));
}

#[test]
fn motion_towards_the_camera_keeps_its_weight() {
    let params = Params { strides: vec![1], ..Params::default() };
    let approaching = |index: usize| {
        let mut view = wall(index, 0.0, 0.5);
        if index > 0 {
            view.depth.depth_view.fill(0.8 * DEPTH);
        }
        Ok(view)
    };
    let found = momentum(&wall(0, 0.0, 0.5), &params, &approaching).unwrap().squared_norm;
    assert!((found[5 * WIDTH as usize + 4].unwrap() - 0.25).abs() <= 1e-9, "half a pixel per frame, fully weighted");
}

#[test]
fn unprojection_inverts_projection() {
    let view = wall(3, 0.2, 0.0);
    for pixel in [0, 37, (WIDTH * HEIGHT) as usize - 1] {
        let (position, depth) = view.camera.project(surface_point(&view, pixel).unwrap()).unwrap();
        let expected = scene::pixels::center(pixel, WIDTH);
        assert!(position.distance(expected) <= 1e-9 && (depth - f64::from(DEPTH)).abs() <= 1e-9);
    }
}

#[test]
fn draws_follow_the_distribution_without_replacement() {
    let energies = [0.7, 0.2, 0.1, 0.0];
    let draws = 4000;
    let mut first = [0.0; 4];
    for seed in 0..draws {
        let mut order = sampling::draw_order(&energies, 0.9, seed);
        first[order[0]] += 1.0 / draws as f64;
        order.sort_unstable();
        assert_eq!(order, [0, 1, 2, 3]);
    }
    for (share, energy) in first.iter().zip(energies) {
        let expected: f64 = 0.9 * energy + 0.1 / 4.0;
        // Four standard deviations of a share in this many draws.
        let tolerance = 4.0 * (expected * (1.0 - expected) / draws as f64).sqrt();
        assert!((share - expected).abs() <= tolerance, "{share} instead of {expected}");
    }
    // Zero energies, and zero weight for one candidate, still give a complete order.
    assert_eq!(sampling::draw_order(&[0.0; 5], 1.0, 1).len(), 5);
    assert_eq!(sampling::draw_order(&[0.5, 0.0, 0.5], 1.0, 1)[2], 1);
    assert_eq!(sampling::energies(&[0.0, 0.0]), [0.0, 0.0]);
    assert_eq!(sampling::energies(&[1.0, 3.0]), [0.25, 0.75]);
}

#[test]
fn a_voxel_keeps_its_first_candidate() {
    let positions = [0.01, 0.09, 0.11, -0.01, 0.35].map(|x| DVec3::new(x, 0.0, 0.0));
    let order = [1, 0, 2, 3, 4];
    let kept = |size, count| sampling::one_per_voxel(&order, |at| positions[at], size, count);
    assert_eq!(kept(0.1, 9), [1, 2, 3, 4]);
    assert_eq!(kept(0.1, 2), [1, 2]);
    assert_eq!(kept(0.0, 9), order);
}

/// Renders a small capture with depth, flow and true velocity.
fn capture(dir: &std::path::Path, scene: SceneKind, camera: CameraPath) -> Capture {
    let params = SceneParams {
        scene,
        camera,
        width: 64,
        height: 64,
        frames: 10,
        rig_cameras: 2,
        val_views: 0,
        test_views: 0,
        samples_per_pixel: 1,
        truths: [Truth::Depth, Truth::Flow, Truth::Velocity].into(),
        ..SceneParams::default()
    };
    scene_synthesis::synthesize(&params, dir, 1, |_, _| Ok(())).unwrap()
}

/// Priors with the maps of the capture; its flow leads to what the same camera pose sees one frame later.
fn priors(capture: &Capture, dir: &std::path::Path) -> Priors {
    let view_priors = |view: &scene::View| -> PriorView {
        let next = |other: &scene::View| other.camera == view.camera && other.frame_index == view.frame_index + 1;
        let flow = |map| FlowPrior {
            map,
            camera_to: view.camera,
            time_to_secs: view.time_secs + capture.time_map.frame_secs,
            view_to: capture.views.iter().position(next),
        };
        let maps = ViewMaps {
            depth: capture.load_depth(view).unwrap(),
            flow: capture.load_flow(view).unwrap().map(flow),
            ..ViewMaps::default()
        };
        Priors::write_view(dir, &view.name, view.camera, &maps).unwrap()
    };
    let priors = Priors::save(dir, "capture", capture.views.iter().map(view_priors).collect()).unwrap();
    priors.check().unwrap();
    priors
}

#[test]
fn particles_concentrate_on_moving_surfaces() {
    for scene in [SceneKind::BouncingSpheres, SceneKind::SwingingArm, SceneKind::WavingCloth, SceneKind::Occluder] {
        for (path, strides, views) in [(CameraPath::Rig, &[1, 2, 4, 8][..], 2), (CameraPath::Arc, &[1], 10)] {
            let dir = tempfile::tempdir().unwrap();
            let capture = capture(&dir.path().join("capture"), scene, path);
            let priors = priors(&capture, &dir.path().join("priors"));
            let out = dir.path().join("particles");
            std::fs::create_dir(&out).unwrap();
            let sampled = sample(&capture, &priors, &Params::default(), &out).unwrap();
            sampled.particles.check().unwrap();
            assert_eq!(sampled.particles, Particles::open(&out).unwrap());
            assert_eq!(sampled.particles.strides, strides, "{scene:?} {path:?}");
            assert_eq!(sampled.particles.canonical_views.len(), views);
            let moving = sampled.moving.unwrap();
            let odds = |share: f64| share / (1.0 - share);
            let gain = odds(moving.of_particles) / odds(moving.of_area);
            assert!(gain >= 15.0, "{scene:?} {path:?}: {moving:?}");
        }
    }
}

#[test]
fn a_static_scene_is_sampled_reproducibly() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::StaticBlocks, CameraPath::Rig);
    let priors = priors(&capture, &dir.path().join("priors"));
    let draw = |name: &str, seed: u64| {
        let out = dir.path().join(name);
        std::fs::create_dir(&out).unwrap();
        let sampled = sample(&capture, &priors, &Params { seed, ..Params::default() }, &out).unwrap();
        sampled.particles.check().unwrap();
        assert_eq!(sampled.moving.unwrap().of_area, 0.0);
        (sampled.particles.count, std::fs::read(out.join("particles.ply")).unwrap())
    };
    let (count, bytes) = draw("first", 0);
    assert!(count > 50);
    assert!(draw("second", 0).1 == bytes && draw("third", 1).1 != bytes);
}

#[test]
fn incomplete_or_foreign_priors_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let capture = capture(&dir.path().join("capture"), SceneKind::Occluder, CameraPath::Arc);
    let complete = priors(&capture, &dir.path().join("priors"));
    let refusal = |change: fn(&mut Priors)| {
        let mut priors = complete.clone();
        change(&mut priors);
        let params = Params { instants: Instants::First, ..Params::default() };
        let Err(error) = sample(&capture, &priors, &params, dir.path()) else { panic!("accepted") };
        format!("{error:#}")
    };
    for change in
        [|priors: &mut Priors| priors.views[0].flow = None, |priors: &mut Priors| priors.views[0].depth = None]
    {
        let message = refusal(change);
        assert!(message.contains("train_0000 has both depth and flow"), "{message}");
    }
    let message = refusal(|priors| priors.views[3].name = "other".into());
    assert!(message.contains("another capture"), "{message}");
}

#[test]
fn invalid_parameters_are_reported() {
    assert!(Params::default().problems().is_empty());
    let keys = |params: Params| params.problems().into_iter().map(|problem| problem.key).collect::<Vec<_>>();
    assert_eq!(keys(Params { strides: vec![2, 1], ..Params::default() }), ["strides"]);
    assert_eq!(keys(Params { strides: vec![], ..Params::default() }), ["strides"]);
    assert_eq!(keys(Params { strides: vec![0, 1], ..Params::default() }), ["strides"]);
    assert_eq!(
        keys(Params { energy_weight: f64::NAN, voxel_size: -1.0, ..Params::default() }),
        ["energy_weight", "voxel_size"]
    );
}
