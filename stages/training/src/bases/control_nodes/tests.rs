use glam::{DQuat, DVec3};
use shaders::check::{TOLERANCE, gradients, noise};
use shaders::tape::{Device, Tape, Var};

use super::*;
use crate::schedule::WARM_UP;
use crate::shared::Shared;

/// A unit of published constants within whose reach all edges of a test lie.
const EVERYWHERE: f64 = 1e3;

fn tensor(rows: usize, columns: usize, seed: u64) -> Tensor<f64> {
    Tensor::from_vec([rows, columns], noise(rows * columns, seed))
}

fn energy(rigidity: &Rigidity, before: &Tensor<f64>, after: &Tensor<f64>) -> f64 {
    let mut tape = Tape::new(Device::Cpu);
    let [before, after] = [before, after].map(|positions| tape.constant(positions.clone()));
    let energy = rigidity.energy(&mut tape, before, after);
    tape.value(energy).as_slice()[0]
}

/// Every row turned and shifted.
fn rigidly_moved(positions: &Tensor<f64>, rotation: DQuat) -> Tensor<f64> {
    let shift = DVec3::new(0.3, -2.0, 0.7);
    let moved =
        (0..positions.rows()).flat_map(|row| (rotation * DVec3::from_slice(positions.row(row)) + shift).to_array());
    Tensor::from_vec(positions.shape(), moved.collect())
}

#[test]
fn farthest_points_spread_and_are_distinct() {
    let line = Tensor::from_vec([6, 1], vec![0.0, 1.0, 2.0, 3.0, 10.0, 4.0]);
    assert_eq!(farthest_points(&line, 3), [0, 4, 5]);
    let points = tensor(200, 3, 1);
    let mut chosen = farthest_points(&points, 50);
    chosen.sort_unstable();
    chosen.dedup();
    assert_eq!(chosen.len(), 50);
    assert_eq!(farthest_points(&line, 100).len(), 6);
    let coinciding = Tensor::from_vec([4, 1], vec![2.0, 2.0, 5.0, 5.0]);
    assert_eq!(farthest_points(&coinciding, 4), [0, 2]);
}

#[test]
fn a_rigid_motion_has_no_energy_and_a_stretch_has() {
    let positions = tensor(40, 3, 1);
    let rigidity = Rigidity::new(&positions, 6, EVERYWHERE).unwrap();
    for angle in [0.0, 0.4, 3.0] {
        let rotation = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), angle);
        let found = energy(&rigidity, &positions, &rigidly_moved(&positions, rotation));
        assert!(found <= 1e-24, "angle {angle}: {found}");
    }
    let mut stretched = positions.clone();
    stretched.make_mut().iter_mut().for_each(|value| *value *= 1.1);
    // Each edge e is 0.1·e too long.
    let lengths = energy(&rigidity, &Tensor::zeros([40, 3]), &positions);
    assert!((energy(&rigidity, &positions, &stretched) - 0.01 * lengths).abs() <= 1e-12 * lengths);
}

#[test]
fn beyond_three_neighbours_only_short_edges_stay_rigid() {
    // A cluster of two nodes and three single ones, none of which is near another.
    let line = Tensor::from_vec([5, 3], [0.0, 0.05, 1.0, 2.1, 3.3].iter().flat_map(|&x| [x, 0.0, 0.0]).collect());
    let mut pulled = line.clone();
    pulled.make_mut()[12] += 0.5;
    let of_unit = |unit: f64| energy(&Rigidity::new(&line, 4, unit).unwrap(), &line, &pulled);
    // All nodes are neighbours of the last one, with four edges in each direction; three edges from it and one to it
    // count.
    let (all, published) = (of_unit(EVERYWHERE), of_unit(1.0));
    assert!((all - 8.0 * 0.25).abs() <= 1e-12, "{all}");
    assert!((published - 4.0 * 0.25).abs() <= 1e-12, "{published}");
}

#[test]
fn the_energy_gradient_agrees_with_central_differences() {
    let (before, after) = (tensor(9, 3, 1), tensor(9, 3, 2));
    let rigidity = Rigidity::new(&before, 4, EVERYWHERE).unwrap();
    gradients(|tape, vars| rigidity.energy(tape, vars[0], vars[1]), &[before, after], TOLERANCE).unwrap();
}

#[test]
fn a_gradient_for_other_rotations_is_rejected() {
    let (before, after) = (tensor(9, 3, 1), tensor(9, 3, 2));
    let rigidity = Rigidity::new(&before, 4, EVERYWHERE).unwrap();
    let faulty = |tape: &mut Tape<f64>, vars: &[Var]| {
        let held = tape.detach(vars[0]);
        rigidity.energy(tape, held, vars[1])
    };
    assert!(gradients(faulty, &[before, after], TOLERANCE).is_err());
}

#[test]
fn degenerate_neighbourhoods_are_finite() {
    let coincident = Tensor::zeros([4, 3]);
    assert_eq!(energy(&Rigidity::new(&coincident, 3, EVERYWHERE).unwrap(), &coincident, &coincident), 0.0);
    let line = Tensor::from_vec([4, 3], (0..12).map(|at| if at % 3 == 0 { f64::from(at) } else { 0.0 }).collect());
    let turned = rigidly_moved(&line, DQuat::from_rotation_z(1.0));
    assert!(energy(&Rigidity::new(&line, 3, EVERYWHERE).unwrap(), &line, &turned) <= 1e-24);
    assert!(Rigidity::new(&Tensor::<f64>::zeros([1, 3]), 3, 1.0).is_none());
}

#[test]
fn the_published_weight_falls_by_ten_and_ends() {
    let mut shared = Shared::default();
    let expected = [(0, 1.0), (5000, 1.0), (7500, 0.1_f64.sqrt()), (10_000, 0.1), (20_000, 0.1), (20_001, 0.0)];
    let agrees = |&(iteration, share): &(u64, f64)| (rigidity_left(&shared, iteration) - share).abs() <= 1e-15;
    assert!(expected.iter().all(agrees));
    shared.iterations.insert(WARM_UP.into(), 3000);
    shared.schedule_scale = 0.5;
    assert_eq!([3500, 8500, 8501].map(|iteration| rigidity_left(&shared, iteration)), [0.1, 0.1, 0.0]);
}
