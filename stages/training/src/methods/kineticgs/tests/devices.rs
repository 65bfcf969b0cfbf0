//! GPU motion of particles with windows agrees with CPU motion, without synchronization.

use shaders::check::test_gpu;
use shaders::geometry::point_lookup::FlowMaps;
use shaders::gpu::readbacks_of_this_thread;

use super::super::coherence::{displacement_incoherence, window_incoherence};
use super::super::energy_flow::{FlowView, energy_flow};
use super::super::neighbors::Search;
use super::super::population::Population;
use super::*;

/// Largest f32 differences, relative to the largest value and gradient of a tensor. Windows open within τ = 0.02, which
/// amplifies the rounding errors of a network with high frequencies.
const TOLERANCES: [f64; 2] = [1e-3, 5e-3];
/// Number of anchors in the test.
const CROWD: usize = 200;

/// Many particles, perturbed copies of the test scene's, with windows spread over the clip.
fn crowd() -> World {
    let mut world = with_split_windows(&[MOTION, ACTIVATION, ENERGY_FLOW, COHERENCE]);
    for (seed, attribute) in ["positions", "features", "offsets", "log_scales"].into_iter().enumerate() {
        let name = format!("anchors.{attribute}");
        let few = world.state.get(&name).unwrap().clone();
        let rows = (0..CROWD).flat_map(|row| few.row(row % few.rows()));
        let values =
            rows.zip(check::noise(CROWD * few.row_len(), seed as u64)).map(|(value, noise)| value + 0.3 * noise);
        world.state.insert(name, Tensor::from_vec([CROWD, few.row_len()], values.collect()));
    }
    let weight = "activation.center.weight";
    let gentler = world.state.get(weight).unwrap().as_slice().iter().map(|w| 0.15 * w).collect();
    world.state.insert(weight, Tensor::from_vec([1, 64], gentler));
    world
}

/// The first view's maps with a constant depth, the median of the anchors', and a constant flow.
fn partially_visible_maps(world: &World, device: Device) -> FlowMaps<f32> {
    let maps = FlowView::of(&world.dataset, &world.supplements, 0).unwrap().maps(device, &ViewConstants::default());
    let row = maps.camera.rotation[2];
    let positions = world.state.get("anchors.positions").unwrap().as_slice().as_chunks::<3>().0;
    let depth = |position: &[f64; 3]| (0..3).map(|axis| row[axis] * position[axis]).sum::<f64>();
    let mut depths: Vec<f64> = positions.iter().map(|position| depth(position) + maps.camera.translation[2]).collect();
    depths.sort_by(f64::total_cmp);
    let median = depths[depths.len() / 2] as f32;
    let [depth, flow] =
        [(maps.depth.shape(), median), (maps.flow.shape(), 0.7)].map(|(shape, value)| Tensor::full(shape, value));
    FlowMaps { depth, flow, ..maps }
}

/// Outputs of particles with split windows on a device, the gradients of all trained tensors, and the number of
/// readbacks.
fn outcome(world: &World, device: Device) -> (Vec<Tensor<f32>>, Vec<Tensor<f32>>, u64) {
    let method = KineticGaussians::<f32>::new(&world.method.shared, world.method.settings.clone());
    let mut state = ModelState::<f32>::new();
    world.state.iter().for_each(|(name, tensor)| state.insert(name, tensor.cast()));
    let before = readbacks_of_this_thread();
    let mut tape = Tape::new(device);
    let learns = |name: &str| Method::<f32>::learning_rate(&method, FINE, name, &world.dataset.scene).is_some();
    let model = state.bind(&mut tape, learns);
    let particles = method.particles(&mut tape, &model, &world.dataset.scene);
    let moved = method.motion.at(&mut tape, &model, &particles, SPLIT_TIME);
    let maps = partially_visible_maps(world, device);
    let followed = energy_flow(&mut tape, &model, &method.motion, &particles, &moved, &maps, 0.6).unwrap();
    let pairs = particles.population.pairs(Search::Hilbert, 0.05).unwrap();
    let displacements = displacement_incoherence(&mut tape, moved.displacements.unwrap(), pairs, 1.0);
    let windows = window_incoherence(&mut tape, &particles, pairs).unwrap();
    let Anchors { positions, features, offsets, log_scales } = moved.anchors;
    let outputs = [followed.distance, displacements, windows, positions, features, offsets, log_scales];
    let seed = |&var: &Var| {
        let value = tape.value(var);
        (var, Tensor::from_vec(value.shape(), check::noise(value.len(), 7)).cast())
    };
    let seeds: Vec<_> = outputs.iter().map(seed).collect();
    let mut gradients = tape.backward(&seeds);
    let readbacks = readbacks_of_this_thread() - before;
    let values = [followed.count].iter().chain(&outputs).map(|&var| tape.value(var).clone()).collect();
    let gradients = model.iter().filter_map(|(_, var)| gradients.take(var)).collect();
    (values, gradients, readbacks)
}

#[test]
fn a_gpu_moves_particles_like_the_cpu() {
    let Some(gpu) = test_gpu() else { return };
    let world = crowd();
    let (expected, expected_gradients, _) = outcome(&world, Device::Cpu);
    let (found, gradients, readbacks) = outcome(&world, Device::Gpu(gpu));
    let followed = expected[0].as_slice()[0];
    assert!(followed >= 2.0 && followed < CROWD as f32, "{followed} of {CROWD}");
    assert!(expected[1..3].iter().all(|loss| loss.as_slice()[0] > 0.0));
    assert_eq!(readbacks, 0);
    assert!(!gradients.is_empty() && gradients.len() == expected_gradients.len());
    for (found, expected) in found.iter().zip(&expected) {
        check::agree(found, expected, TOLERANCES[0]).unwrap();
    }
    for (found, expected) in gradients.iter().zip(&expected_gradients) {
        check::agree(found, expected, TOLERANCES[1]).unwrap();
    }
}

#[test]
fn the_population_is_cached_until_anchors_change() {
    let mut world = World::fine(&ALL);
    let population = |world: &World| {
        let mut tape = Tape::new(Device::Cpu);
        let model = world.state.bind(&mut tape, |_| false);
        world.method.particles(&mut tape, &model, &world.dataset.scene).population
    };
    let same = std::sync::Arc::<Population<f64>>::ptr_eq;
    let first = population(&world);
    assert!(same(&first, &population(&world)));
    let flags = world.state.get(DYNAMIC).unwrap().clone();
    let mut fewer = flags.clone();
    *fewer.make_mut().last_mut().unwrap() = 0.0;
    world.state.insert(DYNAMIC, fewer);
    let second = population(&world);
    assert!(!same(&first, &second) && second.rows.len() + 1 == first.rows.len());
    world.state.insert(DYNAMIC, flags);
    let mut positions = world.state.get("anchors.positions").unwrap().clone();
    positions.make_mut()[0] += 1.0;
    world.state.insert("anchors.positions", positions);
    assert!(!same(&population(&world), &second) && population(&world).rows.len() == first.rows.len());
}
