use glam::DVec3;
use scene::{DepthMap, Mask};
use shaders::arrays::rows::RowIndex;
use shaders::check::{TOLERANCE, gradients, noise};
use shaders::tape::{Device, Tape, Tensor, Var};

use super::depth::standing_on_ground;
use super::lifetimes::{Lifetime, SEED_VELOCITIES, faded};
use super::matching::{Frame, displacements};
use super::*;
use crate::bases::bounds::Bounds;
use crate::data::{Dataset, Supplements};
use crate::effects::{Effects, SEED_FROM_MASKS};
use crate::method::{Moment, SEED_LIVES, Start, is_seed};
use crate::methods;
use crate::model::{ModelState, Variables};
use crate::params::TrainingParams;
use crate::scene_tests::TestScene;
use crate::shared::Seeds;

#[test]
fn seeds_fade_to_their_neighbours_and_cover_a_frame_that_is_left_out() {
    let times = [0.0, 0.2, 0.3, 0.5, 1.0];
    let lives: Vec<Lifetime> = (0..5).map(|at| Lifetime::among(&times, at)).collect();
    let shares = |time: f64, leaves_out: bool| {
        lives.iter().map(|life| life.share(time, leaves_out.then_some(time))).collect::<Vec<_>>()
    };
    for time in [0.0, 0.1, 0.25, 0.3, 0.41, 0.9, 1.0] {
        assert!((shares(time, false).iter().sum::<f64>() - 1.0).abs() <= 1e-4, "{time}: {:?}", shares(time, false));
    }
    assert_eq!(shares(0.3, false), [0.0, 0.0, 1.0, 0.0, 0.0]);
    let without = shares(0.3, true);
    assert_eq!([without[0], without[2], without[4]], [0.0; 3]);
    assert!((without[1] - 2.0 / 3.0).abs() <= 1e-9 && (without[3] - 1.0 / 3.0).abs() <= 1e-9, "{without:?}");
    assert!(shares(0.0, true)[1] > 0.99, "the first frame is shown by the second one");
    // The frame at 0.3 is left out while its time is drawn with noise.
    let noisy: Vec<f64> = lives.iter().map(|life| life.share(0.32, Some(0.3))).collect();
    assert!(noisy[2] == 0.0 && (noisy[1] - 0.6).abs() <= 1e-9 && (noisy[3] - 0.4).abs() <= 1e-9, "{noisy:?}");
    assert!(Lifetime::among(&[0.5], 0).share(0.9, None) > 0.99, "the only view shows its seeds at all times");
    // The longer gap is 0.2: in its middle, nine tenths of the opacity are left.
    let deviation = lives[1].deviation();
    assert!(((-0.5 * (0.1 / deviation).powi(2)).exp() - 0.9).abs() <= 1e-12);
}

#[test]
fn faded_logits_are_those_of_the_product_and_have_its_gradient() {
    let logits = Tensor::from_vec([40, 1], noise(40, 1).iter().map(|value| 6.0 * value).collect());
    let shares = Tensor::from_vec([40, 1], noise(40, 2).iter().map(|value| 0.5 + 0.4 * value.tanh()).collect());
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let [x, share] = [&logits, &shares].map(|tensor| tape.constant(tensor.clone()));
    let y = faded(&mut tape, x, share);
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    for at in 0..40 {
        let (found, expected) = (tape.value(y).as_slice()[at], shares.as_slice()[at] * sigmoid(logits.as_slice()[at]));
        assert!((sigmoid(found) - expected).abs() <= 1e-12, "{at}");
    }
    gradients(|tape: &mut Tape<f64>, vars: &[Var]| faded(tape, vars[0], vars[1]), &[logits, shares], TOLERANCE)
        .unwrap();
}

#[test]
fn a_subject_stands_where_it_touches_the_ground() {
    let (width, height) = (8, 10);
    // A floor below row 5, nearer in lower rows, and a wall behind.
    let depth_of_row = |row: usize| if row < 5 { 9.0 } else { 10.0 - row as f32 * 0.5 };
    let depth_view = (0..height * width).map(|at| depth_of_row(at / width)).collect();
    let depth = DepthMap { width: width as u32, height: height as u32, depth_view };
    let mut moving = Mask::empty(width as u32, height as u32);
    (2..8).for_each(|row| (3..5).for_each(|column| moving.inside[row * width + column] = true));
    for share in [0.97, 0.8] {
        let found = &standing_on_ground(&[(&depth, &moving)], share)[0];
        for (at, (&before, &after)) in depth.depth_view.iter().zip(&found.depth_view).enumerate() {
            match moving.inside[at] {
                true => assert!((after / depth_of_row(8) - share as f32).abs() <= 1e-6, "row {}: {after}", at / width),
                false => assert_eq!(before, after),
            }
        }
    }
}

#[test]
fn a_wrong_depth_of_the_ground_in_a_few_views_moves_no_subject() {
    let (width, height) = (8, 10);
    let mut moving = Mask::empty(width, height);
    (2..6).for_each(|row| (3..5).for_each(|column| moving.inside[row * width as usize + column] = true));
    // The ground below the subject recedes from view to view, except in two views.
    let ground = |view: usize| if view == 4 || view == 5 { 1.0 } else { 10.0 + 0.1 * view as f32 };
    let depth = |view: usize| DepthMap {
        width,
        height,
        depth_view: (0..width * height).map(|at| if at / width < 6 { 40.0 } else { ground(view) }).collect(),
    };
    let maps: Vec<DepthMap> = (0..12).map(depth).collect();
    let views: Vec<_> = maps.iter().map(|map| (map, &moving)).collect();
    let inside = 3 * width as usize + 4;
    for (view, found) in standing_on_ground(&views, 0.97).iter().enumerate() {
        let expected = 0.97 * (10.0 + 0.1 * view as f32);
        assert!((found.depth_view[inside] - expected).abs() <= 0.3, "view {view}: {}", found.depth_view[inside]);
    }
}

/// A textured square of 14 pixels at a place in a grey image of 64×40.
fn square(left: usize, top: usize) -> (Vec<u8>, Mask) {
    let (mut pixels, mut mask) = (vec![128; 64 * 40 * 3], Mask::empty(64, 40));
    for (row, column) in (0..14).flat_map(|row| (0..14).map(move |column| (row, column))) {
        let at = (top + row) * 64 + left + column;
        mask.inside[at] = true;
        let seed = row * 14 + column;
        (0..3).for_each(|channel| pixels[3 * at + channel] = (seed * (37 + 11 * channel) % 251) as u8);
    }
    (pixels, mask)
}

#[test]
fn block_matching_finds_the_shift_of_a_texture() {
    let ((from, from_mask), (to, to_mask)) = (square(10, 8), square(19, 5));
    let from = Frame { pixels: &from, moving: &from_mask };
    let places: Vec<[i32; 2]> = (10..24).step_by(2).flat_map(|x| (8..22).step_by(2).map(move |y| [x, y])).collect();
    let found = displacements(&from, &Frame { pixels: &to, moving: &to_mask }, &places).unwrap();
    assert!(found.iter().all(|shift| *shift == [9, -3]), "{found:?}");
    let nothing = Mask::empty(64, 40);
    assert!(displacements(&from, &Frame { pixels: &to, moving: &nothing }, &places).is_none());
}

struct World {
    dataset: Dataset,
    supplements: Supplements,
    _dir: tempfile::TempDir,
}

fn world() -> World {
    let dir = tempfile::tempdir().unwrap();
    let scene = TestScene { size: 48, ..TestScene::default() };
    let dataset = Dataset::load(scene.write(dir.path()), 1).unwrap();
    let supplements = scene.supplements(&dataset);
    World { dataset, supplements, _dir: dir }
}

#[test]
fn seeds_lie_on_what_moves_and_know_its_velocity() {
    let mut world = world();
    let expected = DVec3::new(TestScene::default().travel.into(), 0.0, 0.0);
    for (has_flow, tolerance) in [(true, 0.15), (false, 0.35)] {
        if !has_flow {
            world.supplements.priors.iter_mut().for_each(|priors| priors.flow = None);
        }
        let start = Start { dataset: &world.dataset, supplements: &world.supplements };
        let seeds = from_masks(&start, &Seeds::default()).unwrap();
        assert!(seeds.len() > 100, "{}", seeds.len());
        let mean = seeds.iter().map(|seed| seed.velocities[1]).sum::<DVec3>() / seeds.len() as f64;
        // Across the image: neither flow nor matching determines how the distance from the camera changes.
        let error = (mean.x / expected.x - 1.0).abs();
        assert!(error <= tolerance, "flow {has_flow}: {mean}");
    }
}

#[test]
fn seeds_keep_their_depth_where_it_is_that_of_static_points() {
    let axis_speeds = |depth_is_static: bool| -> Vec<f64> {
        let mut world = world();
        world.supplements.depth_is_static = depth_is_static;
        let second = world.supplements.priors.len() / 2;
        world.supplements.priors.iter_mut().for_each(|priors| priors.flow = None);
        for priors in &mut world.supplements.priors[second..] {
            let depth = priors.depth.as_mut().expect("the scene has depth");
            depth.depth_view.iter_mut().for_each(|depth| *depth *= 0.5);
        }
        let start = Start { dataset: &world.dataset, supplements: &world.supplements };
        let seeds = from_masks(&start, &Seeds::default()).unwrap();
        seeds.iter().flat_map(|seed| seed.velocities.map(|velocity| velocity.dot(seed.axis).abs())).collect()
    };
    // The cameras are three units away and turn by 0.1 between views, so the axes of two views differ a little.
    assert!(axis_speeds(false).iter().any(|&speed| speed > 5.0), "an estimated depth is followed");
    assert!(axis_speeds(true).iter().all(|&speed| speed < 2.0));
}

#[test]
fn fewer_seeds_are_larger_and_cover_the_same_area() {
    let world = world();
    let start = Start { dataset: &world.dataset, supplements: &world.supplements };
    let of = |max_count: usize| from_masks(&start, &Seeds { pixel_stride: 1, max_count, ..Seeds::default() }).unwrap();
    let (all, some) = (of(usize::MAX), of(400));
    assert!(all.len() > 500 && (100..=400).contains(&some.len()), "{} and {}", all.len(), some.len());
    let area = |seeds: &[Seed]| seeds.iter().map(|seed| seed.scale * seed.scale).sum::<f64>();
    assert!((area(&some) / area(&all) - 1.0).abs() <= 0.25, "{} and {}", area(&some), area(&all));
}

#[test]
fn seeds_fade_towards_the_next_view_of_any_camera() {
    let mut world = world();
    let lives = |world: &World| {
        let start = Start { dataset: &world.dataset, supplements: &world.supplements };
        let mut lives: Vec<[u64; 5]> = from_masks(&start, &Seeds::default())
            .unwrap()
            .iter()
            .map(|seed| seed.life.times.map(f64::to_bits))
            .collect();
        lives.sort_unstable();
        lives
    };
    let of_one_camera = lives(&world);
    for (at, loaded) in world.dataset.train.iter().enumerate() {
        world.dataset.capture.views[loaded.index].camera_index = at as u32 % 3;
    }
    assert_eq!(lives(&world), of_one_camera);
}

#[test]
fn masks_of_held_out_views_seed_nothing() {
    let world = world();
    let start = Start { dataset: &world.dataset, supplements: &world.supplements };
    let births: std::collections::BTreeSet<u64> =
        from_masks(&start, &Seeds::default()).unwrap().iter().map(|seed| seed.life.birth().to_bits()).collect();
    let training: std::collections::BTreeSet<u64> =
        world.dataset.train.iter().map(|view| view.time.to_bits()).collect();
    assert_eq!(births, training);
}

/// The parameters of a method with the effect on and few seeds.
fn seeded(method: &str) -> TrainingParams {
    let mut params = TrainingParams::of(method).unwrap();
    let names =
        params.registration().effects().into_iter().filter(|effect| effect.by_default).map(|effect| effect.name);
    let names = names.chain([SEED_FROM_MASKS.name]).map(String::from).collect();
    params.shared.effects = Effects::Named(names);
    params.shared.initial_points.max_count = 8;
    params.shared.seeds.pixel_stride = 6;
    params.settings = params.registration().tiny();
    params
}

/// The parameters of a method with the effect, its last phase and its first state.
type Seeded = (TrainingParams, &'static str, ModelState<f64>);

fn state_of(world: &World, entry: &methods::Registration) -> anyhow::Result<Seeded> {
    let start = Start { dataset: &world.dataset, supplements: &world.supplements };
    let params = seeded(entry.name);
    let method = entry.build_f64(&params.shared, &params.settings)?;
    let points = start.initial_points(&params.shared)?;
    let random = crate::data::Streams::new(1);
    let mut state = method.initialize(&start, &points, random)?;
    let phases = method.phases();
    for phase in &phases {
        state = method.enter_phase(phase.name, state, &start, random)?;
    }
    Ok((params, phases.last().unwrap().name, state))
}

/// Every method with the effect.
fn seeded_methods() -> impl Iterator<Item = &'static methods::Registration> {
    methods::registry().iter().filter(|entry| entry.effects().iter().any(|effect| effect.name == SEED_FROM_MASKS.name))
}

fn states(world: &World) -> Vec<Seeded> {
    seeded_methods().map(|entry| state_of(world, entry).unwrap()).collect()
}

#[test]
fn seeds_are_carried_by_the_velocity_of_their_side_of_birth() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    // The third Gaussian is not a seed.
    let lives = [[-1e3, 0.0, 0.2, 0.3, 0.5], [0.0, 0.2, 0.3, 0.5, 1.0], [0.0; 5]].concat();
    let velocities = [[1.0, 0.0, 0.0, 0.0, 2.0, 0.0], [3.0, 0.0, 0.0, 0.0, 0.0, 4.0], [5.0; 6]].concat();
    let tensors = [(SEED_LIVES, lives, 5), (SEED_VELOCITIES, velocities, 6)];
    let tensors = tensors.map(|(name, values, columns)| (name.to_string(), Tensor::from_vec([3, columns], values)));
    let model = Variables::new(tensors.map(|(name, tensor)| (name, tape.constant(tensor))).into_iter().collect());
    let rows = RowIndex::new(vec![2, 0, 1], 3);
    let positions = tape.constant(Tensor::zeros([3, 3]));
    let mut at = |time: f64| {
        let moved = carried(&mut tape, &model, &rows, positions, time);
        tape.value(moved).as_slice().to_vec()
    };
    let expected = [0.0, 0.0, 0.0, 0.0, 0.1, 0.0, -0.15, 0.0, 0.0];
    let found = at(0.25);
    assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= 1e-12), "{found:?}");
}

#[test]
fn every_seeded_model_shows_more_of_its_own_frame_than_of_others() {
    let world = world();
    let found = states(&world);
    assert!(found.len() >= 10, "{}", found.len());
    for (params, phase, state) in found {
        let method = params.registration().build_f64(&params.shared, &params.settings).unwrap();
        let mut tape = Tape::new(Device::Cpu);
        let model = state.bind(&mut tape, |_| false);
        let view = &world.dataset.train[3];
        let shown = |tape: &mut Tape<f64>, leaves_out_own: bool| {
            let moment = Moment {
                scene: &world.dataset.scene,
                phase,
                time: view.time,
                camera: &view.camera,
                sh_degree: 0,
                left_out: leaves_out_own.then_some(view.time),
            };
            let splats = method.splats(tape, &model, &moment).unwrap();
            let logits = tape.value(splats.opacity_logits).as_slice();
            [logits.len(), logits.iter().filter(|&&logit| logit > -90.0).count()]
        };
        let [all, visible] = shown(&mut tape, false);
        assert!(visible < all || params.method == "vcgs", "{}: {visible} of {all} are visible", params.method);
        let lives = model.find(SEED_LIVES);
        assert_eq!(lives.is_none(), ["realtime4dgs", "vcgs"].contains(&params.method.as_str()), "{}", params.method);
        if let Some(lives) = lives {
            let seeds = tape.value(lives).as_slice().as_chunks::<5>().0.iter().filter(|life| is_seed(life)).count();
            assert!(seeds > 0 && shown(&mut tape, true)[1] != visible, "{}", params.method);
        }
    }
}

#[test]
fn the_box_of_a_field_holds_the_seeds() {
    let world = world();
    let mut checked = 0;
    for (params, _, state) in states(&world) {
        let fields: Vec<&str> =
            ["field", "gaussian_field"].into_iter().filter(|name| Bounds::stored(&state, name).is_ok()).collect();
        let positions = state.get("gaussians.positions").ok().filter(|_| state.get(SEED_LIVES).is_ok());
        let (Some(positions), [field]) = (positions, &fields[..]) else { continue };
        checked += 1;
        let Bounds { low, high } = Bounds::stored(&state, field).unwrap();
        let lives = state.get(SEED_LIVES).unwrap().as_slice().as_chunks::<5>().0;
        for row in (0..lives.len()).filter(|&row| is_seed(&lives[row])) {
            let inside = |axis: usize| (low[axis] - 1e-6..=high[axis] + 1e-6).contains(&positions.row(row)[axis]);
            assert!((0..3).all(inside), "{}: {:?} outside {low:?} to {high:?}", params.method, positions.row(row));
        }
    }
    assert_eq!(checked, 5, "methods with a field and seeds");
}

#[test]
fn masks_without_a_moving_pixel_leave_every_method_without_seeds() {
    let mut world = world();
    for mask in world.supplements.moving.iter_mut().flatten() {
        mask.labels.fill(0);
    }
    for entry in seeded_methods() {
        let state = match state_of(&world, entry) {
            Ok((.., state)) => state,
            // All that it trains are moving pixels.
            Err(error) if entry.name == "vcgs" => {
                assert!(error.to_string().contains("no pixel moves"), "{error}");
                continue;
            }
            Err(error) => panic!("{}: {error}", entry.name),
        };
        let lives = state.get(SEED_LIVES).map_or(&[][..], |lives| lives.as_slice().as_chunks::<5>().0);
        assert!(!lives.iter().any(is_seed), "{}", entry.name);
    }
}

#[test]
fn some_nodes_of_mcgs_lie_on_seeds() {
    let world = world();
    let entry = seeded_methods().find(|entry| entry.name == "mcgs").unwrap();
    let (.., state) = state_of(&world, entry).unwrap();
    let (nodes, positions) = (state.get("nodes.positions").unwrap(), state.get("gaussians.positions").unwrap());
    let lives = state.get(SEED_LIVES).unwrap().as_slice().as_chunks::<5>().0;
    let lies_on_a_seed =
        |node: usize| (0..lives.len()).any(|row| is_seed(&lives[row]) && positions.row(row) == nodes.row(node));
    assert!((0..nodes.rows()).any(lies_on_a_seed));
}
