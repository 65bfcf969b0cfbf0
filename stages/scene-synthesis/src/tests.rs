//! Maps against closed forms and definitions, determinism, and the properties of every scene.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use engine::{JobContext, PlanContext, Stage};
use glam::{DVec2, DVec3};
use scene::{Camera, Capture, Frame, Split, View, facts, pixels};

use crate::params::*;
use crate::ray::Ray;
use crate::render::{center_hits, ray_world, render, surface_points};
use crate::run::{SceneSynthesis, synthesize};
use crate::scenes;
use crate::shape::Shape;
use crate::shots::{Shot, shots};
use crate::wave::Wave;
use crate::world::World;

const SCENES: [SceneKind; 5] = [
    SceneKind::BouncingSpheres,
    SceneKind::SwingingArm,
    SceneKind::WavingCloth,
    SceneKind::Occluder,
    SceneKind::StaticBlocks,
];
const HARD: [SceneKind; 8] = [
    SceneKind::NearFlyby,
    SceneKind::Needles,
    SceneKind::Teleport,
    SceneKind::LongOcclusion,
    SceneKind::Speck,
    SceneKind::SmallBodies,
    SceneKind::Black,
    SceneKind::UnseenMotion,
];
const TRUTHS: [Truth; 6] = [Truth::Alpha, Truth::Depth, Truth::Flow, Truth::Masks, Truth::Velocity, Truth::Points];

/// A small capture with all maps.
fn small(scene: SceneKind) -> Params {
    Params {
        scene,
        width: 40,
        height: 32,
        frames: 6,
        val_views: 2,
        test_views: 2,
        samples_per_pixel: 4,
        truths: TRUTHS.into(),
        points: 50,
        ..Params::default()
    }
}

/// The world and the shots of a capture.
fn scene_and_shots(params: &Params) -> (World, Vec<Shot>) {
    let world = scenes::build(params);
    let shots = shots(params, world.center_world);
    (world, shots)
}

/// The world point at the centre of a pixel, from its depth alone.
fn unprojected(camera: &Camera, index: usize, depth_view: f32) -> DVec3 {
    let center = pixels::center(index, camera.intrinsics.width);
    camera.camera_from_world.inverse().apply(camera.ray_view(center) * f64::from(depth_view))
}

/// Largest distance in pixels between the flow and the displacement that follows from depth and velocity, over pixels
/// with flow, and the number of pixels that move by more than a hundredth of a pixel.
fn flow_error_px(frame: &Frame, frame_secs: f64) -> (f64, usize) {
    let (depth, flow) = (frame.depth.as_ref().unwrap(), frame.flow.as_ref().unwrap());
    let velocity = &frame.velocity.as_ref().unwrap().velocity_world;
    let (mut worst, mut moving) = (0.0_f64, 0);
    for (index, flow) in flow.flow_px.iter().enumerate().filter(|(_, flow)| !flow[0].is_nan()) {
        let [x, y, z] = velocity[index].map(f64::from);
        let moved = unprojected(&frame.camera, index, depth.depth_view[index]) + DVec3::new(x, y, z) * frame_secs;
        let expected = frame.camera.project(moved).unwrap().0 - pixels::center(index, frame.camera.intrinsics.width);
        let flow = DVec2::new(f64::from(flow[0]), f64::from(flow[1]));
        worst = worst.max(flow.distance(expected));
        moving += usize::from(flow.length() > 0.01);
    }
    (worst, moving)
}

#[test]
fn flow_agrees_with_depth_and_velocity() {
    for scene in SCENES {
        // Every motion is nearly straight during this short time step, 0.3 seconds into the scene.
        let fps = 2000.0;
        let params = Params { fps, frames: 700, width: 80, height: 64, ..small(scene) };
        let (world, shots) = scene_and_shots(&params);
        let mut frame = render(&world, &shots[600], &params);
        let (worst, moving) = flow_error_px(&frame, 1.0 / fps);
        assert!(worst <= 2e-3, "{scene:?}: {worst} px");
        assert!((moving > 20) == (scene != SceneKind::StaticBlocks), "{scene:?}: {moving} pixels move");
        // Planted fault: the comparison must detect one wrong velocity.
        let flow = &frame.flow.as_ref().unwrap().flow_px;
        let seen = flow.iter().position(|flow| !flow[0].is_nan()).unwrap();
        frame.velocity.as_mut().unwrap().velocity_world[seen] = [9.0, -9.0, 9.0];
        assert!(flow_error_px(&frame, 1.0 / fps).0 > 2e-3, "{scene:?}: the comparison is blind");
    }
}

#[test]
fn velocity_is_the_derivative_of_position() {
    for scene in SCENES {
        let params = small(scene);
        let (world, shots) = scene_and_shots(&params);
        let mut compared = 0;
        for shot in &shots {
            let (now, step) = (world.at(shot.time_secs), 1e-5);
            let (before, after) = (world.at(shot.time_secs - step), world.at(shot.time_secs + step));
            for hit in center_hits(&now, &shot.camera).into_iter().flatten() {
                let [a, b] = [&before, &after].map(|instant| instant.position_world(hit.body, hit.material));
                let velocity = now.velocity_world(hit.body, hit.material);
                let error = velocity.distance((b - a) / (2.0 * step));
                assert!(error <= 1e-7 * (1.0 + velocity.length()), "{scene:?}: {velocity} is off by {error}");
                compared += 1;
            }
        }
        assert!(compared > 1000);
    }
}

#[test]
fn hits_lie_on_their_surface_and_face_the_camera() {
    for scene in SCENES {
        let params = small(scene);
        let (world, shots) = scene_and_shots(&params);
        for shot in &shots[..3] {
            let instant = world.at(shot.time_secs);
            for (index, hit) in center_hits(&instant, &shot.camera).into_iter().enumerate() {
                let Some(hit) = hit else { continue };
                let ray = ray_world(&shot.camera, pixels::center(index, shot.camera.intrinsics.width));
                let (pixel, depth_view) = shot.camera.project(ray.at(hit.distance)).unwrap();
                assert!((depth_view - hit.distance).abs() <= 1e-12, "distances along rays are depths");
                assert!(pixel.distance(pixels::center(index, shot.camera.intrinsics.width)) <= 1e-9);
                let surface = instant.position_world(hit.body, hit.material);
                assert!(surface.distance(ray.at(hit.distance)) <= 1e-9, "{scene:?}");
                assert!((hit.normal_world.length() - 1.0).abs() <= 1e-9);
                assert!(hit.normal_world.dot(ray.direction) <= 0.0, "normals face the camera");
            }
        }
    }
}

#[test]
fn sphere_hits_agree_with_geometry() {
    let sphere = Shape::Sphere { radius: 0.5 };
    let through_centre = Ray { origin: DVec3::new(0.0, 0.0, -3.0), direction: DVec3::Z };
    assert_eq!(sphere.hit(&through_centre, 0.0).unwrap(), (2.5, -DVec3::Z));
    // At height h above the axis, the surface is sqrt(r² - h²) in front of the centre.
    let beside = Ray { origin: DVec3::new(0.0, 0.3, -3.0), direction: 2.0 * DVec3::Z };
    assert!((sphere.hit(&beside, 0.0).unwrap().0 - 0.5 * (3.0 - 0.4)).abs() <= 1e-15);
    assert!(sphere.hit(&Ray { origin: DVec3::new(0.0, 0.51, -3.0), direction: DVec3::Z }, 0.0).is_none());
    assert!(sphere.hit(&Ray { origin: DVec3::new(0.0, 0.0, 3.0), direction: DVec3::Z }, 0.0).is_none(), "behind");
    let inside = Ray { origin: DVec3::ZERO, direction: DVec3::X };
    assert_eq!(sphere.hit(&inside, 0.0).unwrap().0, 0.5, "a dome is visible from inside");
}

/// Signed distance (or its sign) of a point from a shape, by definition and not by the intersection formulas.
fn distance_from(shape: &Shape, point: DVec3) -> f64 {
    match shape {
        Shape::Sphere { radius } => point.length() - radius,
        Shape::Block { half } => (point.abs() - half).max_element(),
        Shape::Capsule { length, radius } => point.distance(DVec3::Z * point.z.clamp(0.0, *length)) - radius,
        Shape::Cloth(wave) => point.z - wave.height(point.x, point.y, 0.3).value,
    }
}

#[test]
fn rays_pass_through_no_shape() {
    let shapes = [
        Shape::Sphere { radius: 0.7 },
        Shape::Block { half: DVec3::new(0.3, 0.8, 0.5) },
        Shape::Capsule { length: 0.9, radius: 0.25 },
        Shape::Cloth(Wave::new(DVec2::new(0.85, 0.75), 0.24, 1.0)),
    ];
    for shape in shapes {
        let mut hits = 0;
        for index in 0..400 {
            let angle = f64::from(index) * 2.399;
            let height = f64::from(index % 20) / 10.0 - 0.95;
            let origin = DVec3::new(2.0 * angle.cos(), 2.0 * angle.sin(), height);
            let target = DVec3::new(0.3 * (angle * 1.7).sin(), 0.3 * (angle * 2.3).cos(), 0.4 * (angle * 3.1).sin());
            let ray = Ray { origin, direction: (target - origin) * 0.7 };
            let end = match shape.hit(&ray, 0.3) {
                Some((s, _)) => {
                    hits += 1;
                    assert!(distance_from(&shape, ray.at(s)).abs() <= 1e-11, "{shape:?}");
                    s
                }
                None => 6.0,
            };
            // Within the bounds of the shape, the side of the surface does not change before the hit.
            let (center, radius) = shape.bounding_sphere();
            let within = |point: DVec3| match &shape {
                Shape::Cloth(wave) => point.abs().cmple(wave.half_box()).all(),
                _ => point.distance(center) <= radius,
            };
            let samples =
                (0..3000).map(|step| ray.at((end - 1e-6) * f64::from(step) / 3000.0)).filter(|at| within(*at));
            let sides: Vec<bool> = samples.map(|point| distance_from(&shape, point) > 0.0).collect();
            assert!(sides.windows(2).all(|pair| pair[0] == pair[1]), "{shape:?}: ray {index} passes through");
        }
        assert!(hits > 100, "{shape:?}: {hits} rays meet it");
    }
}

#[test]
fn points_on_still_surfaces_are_on_the_floor() {
    let params = Params { points: 400, ..small(SceneKind::BouncingSpheres) };
    let (world, shots) = scene_and_shots(&params);
    let above_the_floor = |params: &Params| {
        let points = surface_points(&world, &shots, params);
        assert_eq!(points.len(), 400);
        points.positions.iter().filter(|position| position[2] > -0.74).count()
    };
    assert!(above_the_floor(&params) > 20, "points on balls");
    assert_eq!(above_the_floor(&Params { points_on: PointSurfaces::Still, ..params }), 0);
}

#[test]
fn labels_identify_the_visible_ball() {
    let params = small(SceneKind::BouncingSpheres);
    let (world, shots) = scene_and_shots(&params);
    let frame = render(&world, &shots[0], &params);
    let (labels, depth) = (&frame.mask.unwrap().labels, &frame.depth.unwrap().depth_view);
    for (index, label) in labels.iter().enumerate().filter(|(_, label)| **label > 0) {
        let point = unprojected(&frame.camera, index, depth[index]);
        let ball = &world.bodies[usize::from(*label)];
        let Shape::Sphere { radius } = ball.shape else { panic!("label {label} is not a ball") };
        let center = (ball.motion)(frame.time_secs).world_from_object.translation;
        assert!((point.distance(center) - radius).abs() <= 1e-5, "label {label} at {point}");
    }
    assert!(world.class_names.len() == 4 && labels.iter().any(|label| *label > 0));
}

#[test]
fn static_scenes_have_no_flow_and_no_velocity() {
    let params = small(SceneKind::StaticBlocks);
    let (world, shots) = scene_and_shots(&params);
    let frame = render(&world, &shots[1], &params);
    assert!(frame.velocity.unwrap().velocity_world.iter().flatten().all(|value| *value == 0.0));
    let flow = frame.flow.unwrap().flow_px;
    let seen: Vec<_> = flow.iter().flatten().filter(|value| !value.is_nan()).collect();
    assert!(seen.len() > 200 && seen.iter().all(|value| value.abs() <= 1e-5));
    assert!(frame.mask.unwrap().labels.iter().all(|label| *label == 0));
}

#[test]
fn the_tunnel_hides_the_ball_temporarily() {
    // Half a second is a quarter of the period: from the turning point to the middle of the tunnel.
    let params = Params { camera: CameraPath::Rig, rig_cameras: 3, fps: 2.0, frames: 3, ..small(SceneKind::Occluder) };
    let (world, shots) = scene_and_shots(&params);
    let front = |frame: u32| {
        let shot = shots.iter().find(|shot| shot.camera_index == 1 && shot.frame_index == frame).unwrap();
        render(&world, shot, &params)
    };
    let ball_pixels = |frame: &Frame| frame.mask.as_ref().unwrap().labels.iter().filter(|label| **label == 1).count();
    let [start, middle, end] = [0, 1, 2].map(front);
    let counts = [ball_pixels(&start), ball_pixels(&middle), ball_pixels(&end)];
    assert!(counts[0] > 10 && counts[1] == 0 && counts[2] > 10, "{counts:?}");
    let hidden = start.mask.unwrap().labels.into_iter().zip(start.flow.unwrap().flow_px);
    assert!(hidden.filter(|(label, _)| *label == 1).all(|(_, flow)| flow[0].is_nan()), "hidden at the next frame");
    assert!(end.flow.is_none(), "the last frame has no next one");
}

/// The bytes of every file below a folder.
fn files(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let (mut files, mut folders) = (BTreeMap::new(), vec![dir.to_path_buf()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                files.insert(path.strip_prefix(dir).unwrap().to_owned(), std::fs::read(&path).unwrap());
            }
        }
    }
    files
}

/// The bytes of every file of a capture.
fn capture_files(params: &Params, threads: usize) -> BTreeMap<PathBuf, Vec<u8>> {
    let dir = tempfile::tempdir().unwrap();
    synthesize(params, dir.path(), threads, |_, _| Ok(())).unwrap();
    files(dir.path())
}

#[test]
fn bytes_depend_on_the_seed_and_not_on_threads() {
    for scene in SCENES {
        let params = small(scene);
        let one = capture_files(&params, 1);
        assert!(one == capture_files(&params, 3), "{scene:?}");
        assert!(one != capture_files(&Params { seed: 1, ..params }, 1), "{scene:?}: the seed has no effect");
    }
}

#[test]
fn the_stage_writes_a_valid_capture() {
    for camera in [CameraPath::Hemisphere, CameraPath::Orbit, CameraPath::Arc, CameraPath::Rig] {
        let dir = tempfile::tempdir().unwrap();
        let context = JobContext::detached(dir.path()).unwrap();
        let params = Params { camera, rig_cameras: 3, ..small(SceneKind::WavingCloth) };
        SceneSynthesis::run(&context, &params).unwrap();
        let capture = Capture::open(context.output_dir()).unwrap();
        capture.check().unwrap();
        let count = |split| capture.views_of(split).count();
        let train = if camera == CameraPath::Rig { 18 } else { 6 };
        assert_eq!([count(Split::Train), count(Split::Val), count(Split::Test)], [train, 2, 2], "{camera:?}");
        let distinct = |a: &View, b: &View| a.camera.camera_from_world != b.camera.camera_from_world;
        for (_, test) in capture.views_of(Split::Test) {
            let others = capture.views.iter().filter(|view| view.split != Split::Test);
            assert!(others.into_iter().all(|view| distinct(test, view)), "{camera:?}: {} is not held out", test.name);
            let instants = capture.views_of(Split::Train).filter(|(_, view)| view.time_secs == test.time_secs);
            assert_eq!(instants.count() > 0, camera == CameraPath::Rig, "{camera:?}: {}", test.name);
        }
        assert_eq!(capture.load_points().unwrap().unwrap().len(), 50);
        let labels = capture.views.iter().flat_map(|view| capture.load_mask(view).unwrap().unwrap().labels);
        assert_eq!(labels.max(), Some(1));
        let flows = capture.views_of(Split::Train).filter(|(_, view)| view.flow.is_some()).count();
        assert_eq!(flows, train / 6 * 5, "all but the last frame");
        assert!(capture.scale().extent > 0.5);
    }
}

#[test]
fn maps_that_are_off_are_not_written() {
    let params = Params { truths: Default::default(), ..small(SceneKind::SwingingArm) };
    let dir = tempfile::tempdir().unwrap();
    synthesize(&params, dir.path(), 1, |_, _| Ok(())).unwrap();
    let files = files(dir.path());
    assert_eq!(files.len(), 11, "ten images and their description: {:?}", files.keys());
    // Other maps do not change the images.
    let with = tempfile::tempdir().unwrap();
    synthesize(&small(SceneKind::SwingingArm), with.path(), 1, |_, _| Ok(())).unwrap();
    let image = |dir: &Path| std::fs::read(dir.join("images/train_0003.png")).unwrap();
    assert!(image(dir.path()) == image(with.path()));
}

#[test]
fn backgrounds_have_their_colour_and_coverage() {
    let corner = |background| {
        let params = Params { background, ..small(SceneKind::SwingingArm) };
        let (world, shots) = scene_and_shots(&params);
        let frame = render(&world, &shots[0], &params);
        (frame.image.get_pixel(0, 0).0, frame.alpha.unwrap().get_pixel(0, 0).0[0])
    };
    assert_eq!(corner(Background::White), ([255; 3], 0));
    assert_eq!(corner(Background::Black), ([0; 3], 0));
    let (dome, covered) = corner(Background::None);
    assert!(covered == 255 && dome != [0; 3] && dome != [255; 3], "{dome:?}");
}

#[test]
fn shadows_darken_and_highlights_brighten() {
    let params = small(SceneKind::StaticBlocks);
    let (world, shots) = scene_and_shots(&params);
    let image = |params: &Params| render(&world, &shots[0], params).image.into_raw();
    let plain = image(&params);
    let shadowed = image(&Params { shadows: true, ..params.clone() });
    let glossy = image(&Params { specular: 0.8, ..params.clone() });
    let darker = plain.iter().zip(&shadowed).filter(|(plain, shadowed)| shadowed < plain).count();
    assert!(darker > 50 && plain.iter().zip(&shadowed).all(|(plain, shadowed)| shadowed <= plain));
    assert!(plain != glossy && plain.iter().zip(&glossy).all(|(plain, glossy)| glossy >= plain));
}

#[test]
fn all_parameters_out_of_range_are_reported() {
    assert!(Params::default().problems().is_empty());
    let wrong =
        Params { width: 0, fps: f64::NAN, samples_per_pixel: 5, specular: -1.0, frames: 0, ..Params::default() };
    let keys: Vec<_> = SceneSynthesis::check_params(&wrong).into_iter().map(|problem| problem.key).collect();
    assert_eq!(keys, ["width", "frames", "fps", "samples_per_pixel", "specular"]);
    assert!(synthesize(&wrong, Path::new("unused"), 1, |_, _| Ok(())).is_err());
    let json =
        serde_json::from_str::<Params>(r#"{"scene": "swinging-arm", "truths": ["flow", "depth"], "camera": "arc"}"#);
    assert_eq!(json.unwrap().truths, [Truth::Depth, Truth::Flow].into());
    assert!(serde_json::from_str::<Params>(r#"{"framez": 3}"#).is_err());
}

#[test]
fn a_stopped_job_ends_early() {
    let dir = tempfile::tempdir().unwrap();
    let context = JobContext::detached(dir.path()).unwrap();
    context.stop.store(true, std::sync::atomic::Ordering::Relaxed);
    assert!(SceneSynthesis::run(&context, &small(SceneKind::Occluder)).is_err());
    assert!(!context.output_dir().join("capture.json").exists());
}

#[test]
fn facts_hold_for_the_rendered_capture() {
    for scene in SCENES {
        for specular in [0.0, 0.5] {
            let params = Params { specular, truths: [Truth::Masks, Truth::Depth].into(), ..small(scene) };
            let context = PlanContext { data_root: Path::new("unused"), inputs: BTreeMap::new() };
            let known = SceneSynthesis::facts(&params, &context);
            let dir = tempfile::tempdir().unwrap();
            let capture = synthesize(&params, dir.path(), 1, |_, _| Ok(())).unwrap();
            let views = || capture.views_of(Split::Train).map(|(_, view)| view);
            let times: BTreeSet<u64> = views().map(|view| view.time_secs.to_bits()).collect();
            assert_eq!(known.count(facts::TIMES), Some(times.len() as u64));
            assert_eq!(captures::view_count(&known, Split::Train), Some(views().count() as f64));
            assert_eq!(captures::all_views(&known), Some(capture.views.len() as f64));
            let camera = views().next().unwrap().camera;
            let pixels = f64::from(camera.intrinsics.width * camera.intrinsics.height);
            assert_eq!(captures::pixels_per_view(&known), Some(pixels));
            let moves = views().any(|view| capture.load_mask(view).unwrap().unwrap().labels.iter().any(|&at| at > 0));
            assert_eq!(known.flag(facts::MOVING), Some(moves), "{scene:?}");
            assert_eq!(known.flag(facts::VIEW_DEPENDENT), Some(specular > 0.0));
            assert_eq!(known.flag(facts::POINTS), Some(capture.has_points));
            let maps = [facts::DEPTH, facts::FLOW, facts::VELOCITY, facts::MASKS].map(|map| known.flag(map));
            assert_eq!(maps, [Some(true), Some(false), Some(false), Some(true)]);
            assert!(views().all(|view| view.depth.is_some() && view.flow.is_none() && view.velocity.is_none()));
        }
    }
}

#[test]
fn hard_scenes_have_the_property_in_their_name() {
    let frames = |scene: SceneKind, change: &dyn Fn(&mut Params)| {
        let mut params = Params { width: 64, height: 64, frames: 24, camera: CameraPath::Arc, ..small(scene) };
        change(&mut params);
        let (world, shots) = scene_and_shots(&params);
        let train = shots.iter().filter(|shot| shot.split == Split::Train);
        train.map(|shot| render(&world, shot, &params)).collect::<Vec<Frame>>()
    };
    let plain = |scene| frames(scene, &|_| ());
    let moving = |frame: &Frame| frame.mask.as_ref().unwrap().labels.iter().filter(|label| **label > 0).count();
    let depth = |frame: &Frame| frame.depth.as_ref().unwrap().depth_view.clone();
    for scene in HARD {
        let seen = plain(scene);
        assert_eq!(seen.len(), 24);
        assert!(seen.iter().flat_map(&depth).all(|depth| depth >= 0.0 && depth.is_finite()), "{scene:?}");
    }
    // Nearer than 0.2, the near plane of rasterisers.
    let near = plain(SceneKind::NearFlyby);
    assert!(near.iter().any(|frame| depth(frame).iter().any(|&depth| depth > 0.0 && depth < 0.2)));
    assert!(near.iter().any(|frame| moving(frame) > 0) && near.iter().any(|frame| moving(frame) == 0));
    let speck = plain(SceneKind::Speck);
    assert!(speck.iter().all(|frame| moving(frame) <= 2) && speck.iter().any(|frame| moving(frame) > 0));
    assert!(
        frames(SceneKind::Black, &|params| params.background = Background::Black).iter().all(|frame| frame
            .image
            .as_raw()
            .iter()
            .all(|value| *value == 0)
            && moving(frame) > 0)
    );
    assert!(plain(SceneKind::UnseenMotion).iter().all(|frame| moving(frame) == 0));
    let hidden = plain(SceneKind::LongOcclusion).iter().filter(|frame| moving(frame) == 0).count();
    assert!(hidden >= 8, "hidden in {hidden} of 24 frames");
    let jumps = plain(SceneKind::Teleport);
    let flows = jumps.iter().filter_map(|frame| frame.flow.as_ref());
    let longest = flows.flat_map(|flow| &flow.flow_px).map(|flow| flow[0].hypot(flow[1]));
    assert!(longest.filter(|length| !length.is_nan()).fold(0.0, f32::max) > 5.0, "no jump is visible");
    assert!(jumps.iter().flat_map(|frame| &frame.velocity.as_ref().unwrap().velocity_world).all(|v| *v == [0.0; 3]));

    let far = frames(SceneKind::SwingingArm, &|params| params.origin_world = [1e4, -1e4, 1e4]);
    let here = plain(SceneKind::SwingingArm);
    let difference = |a: &Frame, b: &Frame| {
        a.image.as_raw().iter().zip(b.image.as_raw()).filter(|(a, b)| a.abs_diff(**b) > 2).count()
    };
    assert!(far.iter().zip(&here).all(|(far, here)| difference(far, here) < 10), "a translated scene looks the same");
    let holes = frames(SceneKind::SwingingArm, &|params| params.holes = 0.7);
    let known = |frames: &[Frame]| frames.iter().flat_map(&depth).filter(|depth| *depth > 0.0).count() as f64;
    let share = known(&holes) / known(&here);
    assert!((share - 0.3).abs() < 0.03, "{share} of the depth remains");
    assert_ne!(
        depth(&holes[0]).iter().map(|d| *d > 0.0).collect::<Vec<_>>(),
        depth(&holes[1]).iter().map(|d| *d > 0.0).collect::<Vec<_>>()
    );
    assert!(holes.iter().zip(&here).all(|(holes, here)| holes.image == here.image && holes.mask == here.mask));
}

/// Two captures that differ in the scale alone.
fn at_two_scales(scale: f64) -> [Capture; 2] {
    let dirs = [(); 2].map(|()| tempfile::tempdir().unwrap().keep());
    [(1.0, &dirs[0]), (scale, &dirs[1])].map(|(scale, dir)| {
        let params = Params { scale, bounds: Bounds::Cameras, ..small(SceneKind::SmallBodies) };
        synthesize(&params, dir, 1, |_, _| Ok(())).unwrap()
    })
}

#[test]
fn the_scale_multiplies_every_length_and_changes_no_image() {
    let [unit, tiny] = at_two_scales(0.01);
    for (one, other) in unit.views.iter().zip(&tiny.views) {
        assert_eq!(unit.load_image(one).unwrap(), tiny.load_image(other).unwrap());
        assert!((0.01 * one.camera.position_world()).distance(other.camera.position_world()) <= 1e-12);
    }
    let [far, near] = [&unit, &tiny].map(|capture| capture.load_points().unwrap().unwrap().positions[0]);
    assert!((0..3).all(|axis| (0.01 * far[axis] - near[axis]).abs() <= 1e-6), "{far:?} {near:?}");
    let [far, near] = [&unit, &tiny].map(|capture| capture.bounds_world.unwrap()[0][0]);
    assert!((0.01 * far - near).abs() <= 1e-9, "{far} {near}");
    [unit, tiny].into_iter().for_each(|capture| std::fs::remove_dir_all(capture.dir).unwrap());
}

#[test]
fn small_bodies_leave_most_pixels_white() {
    let params = Params { width: 64, height: 64, ..small(SceneKind::SmallBodies) };
    let (world, shots) = scene_and_shots(&params);
    for shot in &shots {
        let image = render(&world, shot, &params).image;
        let white = image.pixels().filter(|pixel| pixel.0 == [255; 3]).count() as f64 / 4096.0;
        assert!((0.93..0.985).contains(&white), "{white} of {} is white", shot.name);
    }
}

#[test]
fn captures_are_named_as_scenes_in_recipes() {
    for (kind, name) in [(SceneKind::NearFlyby, "near-flyby"), (SceneKind::Black, "black")] {
        assert_eq!(kind.to_string(), name);
        assert_eq!(serde_json::from_str::<SceneKind>(&format!("{name:?}")).unwrap(), kind);
    }
}
