use glam::DVec3;
use scene::Camera;
use shaders::check::{self, TOLERANCE, noise};
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::RasterSettings;
use shaders::tape::{Device, Var};
use tempfile::TempDir;

use super::settings::Pruning;
use super::splats::within_view_plane;
use super::surfels::{DepthImage, Surfel, uncovered, without_duplicates};
use super::*;
use crate::bases::gaussians::logit;
use crate::clock::{ClockReading, PhaseClock};
use crate::data::{Dataset, NOTHING, Streams, Supplements, ViewConstants};
use crate::effects::Effects;
use crate::method::{LossUnits, Recorded, ScreenGradients, ScreenStats, raster_settings, run_step};
use crate::scene_tests::TestScene;

struct World {
    dataset: Dataset,
    supplements: Supplements,
    _dir: TempDir,
}

fn world() -> World {
    let dir = tempfile::tempdir().unwrap();
    let scene = TestScene::default();
    let dataset = Dataset::load(scene.write(dir.path()), 1).unwrap();
    let supplements = scene.supplements(&dataset);
    World { dataset, supplements, _dir: dir }
}

impl World {
    fn start(&self) -> Start<'_> {
        Start { dataset: &self.dataset, supplements: &self.supplements }
    }
}

fn method(effects: &[&str]) -> ViewPlaneGaussians {
    let effects = Effects::Named(effects.iter().map(|name| name.to_string()).collect());
    ViewPlaneGaussians::new(&Shared { effects, ..Vcgs::shared_defaults() }, Settings::default())
}

const ALL: [&str; 4] = ["motion", "view-plane-constraint", "layer-split", "inpainting"];

/// The model state at the start of the last phase, and the phase.
fn last_state(method: &ViewPlaneGaussians, start: &Start<'_>) -> anyhow::Result<(ModelState<f64>, &'static str)> {
    let random = Streams::new(0);
    let none = PointCloud { positions: Vec::new(), colors: Vec::new() };
    let mut state = Method::<f64>::initialize(method, start, &none, random)?;
    let phases = Method::<f64>::phases(method);
    for phase in &phases {
        state = Method::enter_phase(method, phase.name, state, start, random)?;
    }
    Ok((state, phases.last().unwrap().name))
}

fn names(method: &ViewPlaneGaussians, start: &Start<'_>) -> Vec<String> {
    last_state(method, start).unwrap().0.names().map(String::from).collect()
}

/// The splats of a state at a time, and the number of operations that compute them.
fn splats_at(
    method: &ViewPlaneGaussians,
    state: &ModelState<f64>,
    phase: &str,
    world: &World,
    time: f64,
) -> (Tensor<f64>, u64) {
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| true);
    let camera = world.dataset.train[0].camera;
    let moment = Moment { scene: &world.dataset.scene, phase, time, camera: &camera, sh_degree: 0, left_out: None };
    let splats = Method::splats(method, &mut tape, &model, &moment).unwrap();
    let calls = tape.profile().ops.values().map(|cost| cost.forward.calls).sum();
    let rows = Method::rows(method, &mut tape, &model, &moment).unwrap();
    let positions = tape.value(splats.positions).clone();
    assert!(rows.is_none_or(|rows| rows.len() == positions.rows()), "every splat has its row");
    (positions, calls)
}

#[test]
fn displacements_keep_their_view_plane_component() {
    let displacements = Tensor::from_vec([4, 3], noise(12, 1));
    let unit = noise(12, 2).as_chunks::<3>().0.iter().flat_map(|&n| DVec3::from(n).normalize().to_array()).collect();
    let axes = Tensor::from_vec([4, 3], unit);
    let f = |tape: &mut Tape<f64>, vars: &[Var]| within_view_plane(tape, vars[0], vars[1], 0.05);
    check::gradients(f, &[displacements.clone(), axes.clone()], TOLERANCE).unwrap();

    let mut tape = Tape::new(Device::Cpu);
    let [d, n] = [&displacements, &axes].map(|tensor| tape.constant(tensor.clone()));
    let moved = within_view_plane(&mut tape, d, n, 0.05);
    for row in 0..4 {
        let vector = |tensor: &Tensor<f64>| DVec3::from_slice(tensor.row(row));
        let (before, after, axis) = (vector(&displacements), vector(tape.value(moved)), vector(&axes));
        assert!((after.dot(axis) - 0.05 * before.dot(axis)).abs() <= 1e-12);
        assert!((after.reject_from_normalized(axis) - before.reject_from_normalized(axis)).length() <= 1e-12);
    }
}

#[test]
fn nothing_moves_before_training() {
    let world = world();
    let full = method(&ALL);
    let (state, phase) = last_state(&full, &world.start()).unwrap();
    let stored = state.get("foreground.positions").unwrap();
    let (positions, _) = splats_at(&full, &state, phase, &world, 0.5);
    for position in positions.as_slice().as_chunks::<3>().0 {
        let all = stored.as_slice().as_chunks::<3>().0.iter();
        let mut all = all.chain(state.get("background.positions").unwrap().as_slice().as_chunks::<3>().0);
        assert!(all.any(|stored| (DVec3::from(*stored) - DVec3::from(*position)).length() <= 1e-9));
    }
}

#[test]
fn disabled_effects_have_no_tensors_phases_or_operations() {
    let world = world();
    let full = method(&ALL);
    let (state, phase) = last_state(&full, &world.start()).unwrap();
    assert_eq!(state.names().filter(|name| name.starts_with("background.")).count(), 6);
    assert_eq!(state.names().filter(|name| name.starts_with("foreground.")).count(), 10);

    let still = method(&["layer-split", "inpainting"]);
    assert!(names(&still, &world.start()).iter().all(|name| name.starts_with("background.")));
    assert_eq!(Method::<f64>::phases(&still).iter().map(|phase| phase.name).collect::<Vec<_>>(), [STATIC]);

    let together = method(&["motion", "view-plane-constraint"]);
    assert!(names(&together, &world.start()).iter().all(|name| name.starts_with("foreground.")));
    assert_eq!(Method::<f64>::phases(&together).iter().map(|phase| phase.name).collect::<Vec<_>>(), [DYNAMIC]);

    let free = method(&["motion", "layer-split", "inpainting"]);
    let calls = |method| splats_at(method, &state, phase, &world, 0.5).1;
    // The constraint takes four operations: the product with the axes, then product, scaling and difference.
    assert_eq!(calls(&full) - calls(&free), 4);
    let mut zero = method(&ALL);
    zero.settings.zero_offset = true;
    assert_eq!(calls(&free) - calls(&zero), 1, "the sum of positions and displacements");
}

#[test]
fn inputs_are_required_only_by_active_effects() {
    let mut world = world();
    world.supplements.background.iter_mut().flatten().for_each(|filled| filled.depth = None);
    let error = last_state(&method(&ALL), &world.start()).unwrap_err().to_string();
    assert!(error.contains("depth of the inpainted image"), "{error}");
    world.supplements.background.clear();
    assert!(last_state(&method(&ALL), &world.start()).unwrap_err().to_string().contains("inpainted image"));
    last_state(&method(&["motion", "layer-split"]), &world.start()).unwrap();
    world.supplements.moving.clear();
    assert!(last_state(&method(&["motion", "layer-split"]), &world.start()).is_err());
    last_state(&method(&["motion"]), &world.start()).unwrap();
    let nothing = Start { dataset: &world.dataset, supplements: &NOTHING };
    let error = last_state(&method(&["motion"]), &nothing).unwrap_err();
    let failure = error.downcast_ref::<engine::Failure>().unwrap();
    assert_eq!(failure.kind, engine::FailureKind::BadInput);
    assert!(format!("{failure:?}").contains("port priors"), "{failure:?}");
}

#[test]
fn inpainted_pixels_have_the_normals_of_their_depth() {
    let mut world = world();
    let surfels = |world: &World| {
        let all = method(&ALL);
        layers::background_surfels(&world.start(), &all.settings, &all.switches).unwrap()
    };
    let facing = |world: &World, surfels: &[Surfel], normal_view: DVec3| {
        let cosine = |surfel: &Surfel| {
            let view = world.dataset.train.iter().find(|view| view.time == surfel.birth_time).unwrap();
            let camera = &world.dataset.capture.views[view.index].camera;
            (camera.camera_from_world.rotation * (surfel.rotation * DVec3::Z)).dot(normal_view)
        };
        surfels.iter().map(cosine).fold(f64::INFINITY, f64::min)
    };
    let given = facing(&world, &surfels(&world), DVec3::NEG_Z);
    assert!(given >= 0.9999, "the given normals are those of static pixels: {given}");
    let slanted = DVec3::new(0.3, 0.0, -1.0).normalize();
    let first = world.dataset.train[0].index;
    for (index, view) in world.dataset.capture.views.iter().enumerate() {
        let filled = world.supplements.background[index].as_mut().unwrap();
        match index == first {
            // Its normals hold, but it has no surfels.
            true => filled.unfilled.labels.fill(255),
            false => filled.depth = Some(plane(&view.camera).0),
        }
    }
    let found = facing(&world, &surfels(&world), slanted);
    assert!(found >= 0.999, "the given normals are those of the removed surface: {found}");
    let camera = &world.dataset.capture.views[first].camera;
    world.supplements.background[first].as_mut().unwrap().depth = Some(plane(camera).0);
    let all = method(&ALL);
    let error = layers::background_surfels(&world.start(), &all.settings, &all.switches).unwrap_err().to_string();
    assert!(error.contains("normals on the port priors hold in no pixel"), "{error}");
}

#[test]
fn thinned_surfels_cover_the_same_area() {
    let (world, all) = (world(), method(&ALL));
    for layer in [layers::background_surfels, layers::foreground_surfels] {
        let surfels = |max_count: usize| {
            let settings = Settings { max_count, ..Settings::default() };
            layer(&world.start(), &settings, &all.switches).unwrap()
        };
        let area = |surfels: &[Surfel]| surfels.iter().map(|surfel| surfel.scales[0] * surfel.scales[1]).sum::<f64>();
        let complete = surfels(usize::MAX);
        let thinned = surfels(complete.len() / 3);
        assert_eq!(thinned.len(), complete.len() / 3);
        let share = area(&thinned) / area(&complete);
        assert!((share - 1.0).abs() <= 0.25, "{share}");
    }
}

#[test]
fn seeds_have_their_own_opacity() {
    let world = world();
    let mut seeded = method(&[&ALL[..], &["seed-from-masks"]].concat());
    seeded.shared.seeds.opacity = 0.3;
    let (state, _) = last_state(&seeded, &world.start()).unwrap();
    for (layer, opacity) in [(BACKGROUND, 0.15), (FOREGROUND, 0.3)] {
        let logits = state.get(&format!("{layer}.opacity_logits")).unwrap().as_slice();
        assert!(logits.iter().all(|&found| (found - logit(opacity)).abs() <= 1e-12), "{layer}: {}", logits[0]);
    }
}

/// The photometric loss of a step in the phase `static`.
fn static_loss(method: &ViewPlaneGaussians, state: &ModelState<f64>, world: &World) -> f64 {
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| true);
    let step = Step {
        tape: &mut tape,
        model: &model,
        views: &[world.dataset.train[3].to_training()],
        scene: &world.dataset.scene,
        dataset: &world.dataset,
        supplements: &world.supplements,
        shared: &method.shared,
        phase: STATIC,
        iteration: 1,
        sh_degree: 0,
        harmonics_intervals: 0,
        raster: raster_settings(&world.dataset.scene, 0),
        random: Streams::new(2).step(STATIC, 1),
        clock: &mut PhaseClock::start("test", ClockReading::default()),
        constants: &ViewConstants::default(),
        units: &LossUnits::default(),
        recorded: Recorded::default(),
    };
    run_step(method, step).unwrap().losses()["photometric"]
}

#[test]
fn the_static_layer_learns_inpainted_pixels() {
    let mut world = world();
    let methods = [method(&ALL), method(&[&ALL[..], &["seed-from-masks"]].concat())];
    let none = PointCloud { positions: Vec::new(), colors: Vec::new() };
    let state = Method::<f64>::initialize(&methods[0], &world.start(), &none, Streams::new(0)).unwrap();
    let losses = |world: &World| methods.each_ref().map(|method| static_loss(method, &state, world));
    let before = losses(&world);
    let index = world.dataset.train[3].index;
    let moving = world.supplements.moving[index].as_ref().unwrap();
    let filled = world.supplements.background[index].as_mut().unwrap();
    let pixels = filled.image.pixels_mut().zip(&moving.labels);
    pixels.filter(|(_, label)| **label != 0).for_each(|(pixel, _)| pixel.0 = [255; 3]);
    let after = losses(&world);
    // With seeds, too, the subject is gone from the target, so that nothing has to be ignored.
    assert_eq!((before[0], after[0]), (before[1], after[1]));
    assert!((after[0] / before[0] - 1.0).abs() >= 0.01, "{before:?} {after:?}");
}

/// Depth map and image of a slanted plane in front of a camera.
fn plane(camera: &Camera) -> (scene::DepthMap, Vec<u8>) {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
    let depth = |(column, row): (u32, u32)| {
        let ray = camera.ray_view(glam::DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5));
        // Points with (0.3, 0, −1)·p = −4.
        (4.0 / (ray.z - 0.3 * ray.x)) as f32
    };
    let color = |(column, row): (u32, u32)| [(4 * column) as u8, (4 * row) as u8, 100];
    let depth_view = pixels.clone().map(depth).collect();
    (scene::DepthMap { width, height, depth_view }, pixels.flat_map(color).collect())
}

fn camera() -> Camera {
    let intrinsics =
        scene::Intrinsics { width: 40, height: 32, focal_x: 50.0, focal_y: 45.0, center_x: 19.0, center_y: 17.0 };
    Camera::look_at(intrinsics, DVec3::new(0.5, -0.3, -2.0), DVec3::new(0.1, 0.0, 1.0), DVec3::new(0.0, -1.0, 0.0))
}

fn surfels_of_plane(stride: usize) -> Vec<Surfel> {
    let camera = camera();
    let (depth, pixels) = plane(&camera);
    DepthImage { camera: &camera, pixels: &pixels, depth: &depth, normals: None }.surfels(0.5, stride, |_| true)
}

#[test]
fn surfels_match_the_surface_and_its_colours() {
    let camera = camera();
    let (_, pixels) = plane(&camera);
    let surfels = surfels_of_plane(1);
    assert_eq!(surfels.len(), 40 * 32);
    let normal = camera.camera_from_world.rotation.transpose() * DVec3::new(0.3, 0.0, -1.0).normalize();
    for (at, surfel) in surfels.iter().enumerate() {
        let (pixel, depth) = camera.project(surfel.position).unwrap();
        assert!((pixel - glam::DVec2::new((at % 40) as f64 + 0.5, (at / 40) as f64 + 0.5)).length() <= 1e-4);
        assert!(depth > 0.0 && (surfel.rotation * DVec3::Z).dot(normal) >= 0.999, "normals from depth");
        // At least as large as the pixel spacing of a fronto-parallel surface.
        assert!(surfel.scales[0] >= 0.69 * depth / 50.0 && surfel.scales[1] >= 0.69 * depth / 45.0);
        assert!(surfel.thickness() <= 0.011 * surfel.scales[0]);
    }

    let mut state = ModelState::<f32>::new();
    layers::insert_background(&mut state, &surfels);
    state.insert("background.opacity_logits", Tensor::full([surfels.len(), 1], 4.0));
    let mut tape = Tape::new(Device::Cpu);
    let model = state.bind(&mut tape, |_| false);
    let splats = static_layer(&mut tape, &model);
    let settings = RasterSettings { sh_degree: 0, ..RasterSettings::default() };
    let rendered =
        shaders::rasteriser::render(&mut tape, &splats, None, &PinholeCamera::from(&camera), &settings).unwrap();
    let image = tape.value(rendered.color).as_slice();
    let errors = image.iter().zip(&pixels).map(|(found, &level)| (found - f32::from(level) / 255.0).powi(2));
    let mse = errors.sum::<f32>() / image.len() as f32;
    assert!(mse <= 1e-3, "{mse}");
}

#[test]
fn only_uncovered_pixels_are_new() {
    let camera = camera();
    let (depth, pixels) = plane(&camera);
    let depth_image = DepthImage { camera: &camera, pixels: &pixels, depth: &depth, normals: None };
    let world = world();
    let scene = &world.dataset.scene;
    let count = |surfels: &[Surfel]| {
        let is_new = uncovered(surfels, &depth_image, scene).unwrap();
        is_new.iter().filter(|&&new| new).count()
    };
    let all = surfels_of_plane(1);
    assert!(count(&all) <= 80, "all but the border is covered: {}", count(&all));
    assert!(count(&all[..600]) >= 600, "uncovered pixels are new");
    let nearer: Vec<Surfel> =
        all.iter().map(|s| Surfel { position: s.position.lerp(camera.position_world(), 0.2), ..*s }).collect();
    assert!(count(&nearer) >= 1000, "another depth is another surface");
    let twice = [all.clone(), all.clone()].concat();
    assert!(without_duplicates(twice).len() <= all.len());
    assert!(without_duplicates(all.clone()).len() * 10 >= all.len() * 9);
}

#[test]
fn pruning_keeps_a_minimum_of_opaque_small_surfels() {
    let params = Pruning { min_count: 2, ..Pruning::default() };
    let mut pruning = SurfelPruning::new(BACKGROUND, &params, 1.0);
    let logits: Vec<f32> = [0.5, 0.04, 0.5, 0.06, 0.5].map(logit_of).to_vec();
    let screen = |radius_px: Vec<f32>| {
        let (visible, gradient_ndc) = (vec![true; 5], vec![[0.0; 2]; 5]);
        let figures = ScreenGradients { radius_px, visible, gradient_ndc };
        ScreenStats::of(BACKGROUND, figures)
    };
    assert_eq!(pruning.survivors(&logits), [true, false, true, true, true]);
    pruning.observe(&screen(vec![1.0, 1.0, 31.0, 1.0, 1.0]));
    pruning.observe(&screen(vec![1.0; 5]));
    assert_eq!(pruning.survivors(&logits), [true, false, false, true, true]);
    let mut copy = SurfelPruning::new(BACKGROUND, &params, 1.0);
    copy.restore(pruning.save()).unwrap();
    assert_eq!(copy.survivors(&logits), pruning.survivors(&logits));
    let faint: Vec<f32> = [0.01, 0.02, 0.03, 0.01, 0.01].map(logit_of).to_vec();
    assert_eq!(pruning.survivors(&faint), [false, true, true, false, false]);
}

fn logit_of(opacity: f64) -> f32 {
    logit(opacity) as f32
}
