use super::*;
use crate::check::{Mismatch, TOLERANCE, gradients, noise};
use crate::tape::{Device, Tape, Tensor, Var};

const POINTS: usize = 8;
const NODES: usize = 5;

fn tensor(rows: usize, columns: usize, seed: u64) -> Tensor<f64> {
    Tensor::from_vec([rows, columns], noise(rows * columns, seed))
}

/// Points, nodes, logarithms of radii around 0.5, gates.
fn placed() -> [Tensor<f64>; 4] {
    let radii = noise(NODES, 3).iter().map(|shift| 0.3 * shift - 0.7).collect();
    [tensor(POINTS, 3, 1), tensor(NODES, 3, 2), Tensor::from_vec([NODES, 1], radii), tensor(NODES, 1, 4)]
}

fn neighbors() -> Neighbors {
    let [points, nodes, ..] = placed();
    Neighbors::nearest(&points, &nodes, 3)
}

/// Points carried by their nodes: every operation at once.
fn carried(tape: &mut Tape<f64>, vars: &[Var]) -> Var {
    let &[points, nodes, log_radii, gates, translations, rotations] = vars else { unreachable!("six inputs") };
    let weights = weights(tape, points, nodes, log_radii, Some(gates), &neighbors());
    blend_frames(tape, weights, points, Frames { positions: nodes, translations, rotations }, &neighbors())
}

fn everything() -> Vec<Tensor<f64>> {
    placed().into_iter().chain([tensor(NODES, 3, 5), tensor(NODES, 4, 6)]).collect()
}

#[test]
fn gradients_of_weights_equal_central_differences() {
    let gated =
        |tape: &mut Tape<f64>, vars: &[Var]| weights(tape, vars[0], vars[1], vars[2], Some(vars[3]), &neighbors());
    gradients(gated, &placed(), TOLERANCE).unwrap();
    let plain = |tape: &mut Tape<f64>, vars: &[Var]| weights(tape, vars[0], vars[1], vars[2], None, &neighbors());
    gradients(plain, &placed()[..3], TOLERANCE).unwrap();
}

#[test]
fn gradients_of_blends_equal_central_differences() {
    let inputs = [tensor(POINTS, 3, 7), tensor(NODES, 4, 8)];
    gradients(|tape, vars| blend(tape, vars[0], vars[1], &neighbors()), &inputs, TOLERANCE).unwrap();
    gradients(carried, &everything(), TOLERANCE).unwrap();
}

#[test]
fn planted_faults_are_rejected() {
    // Each input in turn is detached in the gradient, but not in the differences.
    let cut = |input: usize| -> Result<(), Mismatch> {
        let faulty = |tape: &mut Tape<f64>, vars: &[Var]| {
            let mut vars = vars.to_vec();
            vars[input] = tape.detach(vars[input]);
            carried(tape, &vars)
        };
        gradients(faulty, &everything(), TOLERANCE)
    };
    assert!((0..6).all(|input| cut(input).is_err()));
}

#[test]
fn the_nearest_are_those_of_a_full_sort() {
    let (points, nodes) = (tensor(200, 5, 1), tensor(40, 5, 2));
    let found = Neighbors::nearest(&points, &nodes, 4);
    for point in 0..200 {
        let distance = |node: &u32| -> f64 {
            points.row(point).iter().zip(nodes.row(*node as usize)).map(|(x, p)| (x - p).powi(2)).sum()
        };
        let mut sorted: Vec<u32> = (0..40).collect();
        sorted.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        assert_eq!(found.of_point(point), &sorted[..4]);
    }
    let others = Neighbors::nearest_others(&nodes, 100);
    assert!(others.per_point() == 39 && (0..40).all(|node| !others.of_point(node as usize).contains(&node)));
}

#[test]
fn equally_near_nodes_are_taken_in_order() {
    let points = Tensor::from_vec([1, 1], vec![0.0]);
    let nodes = Tensor::from_vec([4, 1], vec![1.0, -1.0, 1.0, 0.5]);
    assert_eq!(Neighbors::nearest(&points, &nodes, 3).of_point(0), [3, 0, 1]);
}

#[test]
fn a_rigid_motion_of_all_nodes_carries_every_point() {
    let [points, nodes, log_radii, gates] = placed();
    let mut tape = Tape::new(Device::Cpu);
    let half = 0.5_f64.sqrt();
    // A quarter turn about z through the origin, then one step along x.
    let turned = |row: &[f64]| [1.0 - row[1], row[0], row[2]];
    let shifts = (0..NODES).flat_map(|node| {
        let (from, to) = (nodes.row(node), turned(nodes.row(node)));
        [0, 1, 2].map(|axis| to[axis] - from[axis])
    });
    let translations = Tensor::from_vec([NODES, 3], shifts.collect());
    let rotations = Tensor::from_vec([NODES, 4], [half, 0.0, 0.0, half].repeat(NODES));
    let vars = [points.clone(), nodes, log_radii, gates, translations, rotations].map(|input| tape.constant(input));
    let moved = carried(&mut tape, &vars);
    for point in 0..POINTS {
        let (found, expected) = (tape.value(moved).row(point), turned(points.row(point)));
        assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() <= 1e-14));
    }
}

#[test]
fn weights_sum_to_one_even_far_from_every_node() {
    let [_, nodes, log_radii, gates] = placed();
    let far = Tensor::full([1, 3], 1e4);
    let neighbors = Neighbors::nearest(&far, &nodes, 3);
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let vars = [far, nodes, log_radii, gates].map(|input| tape.leaf(input.cast()));
    let weights = weights(&mut tape, vars[0], vars[1], vars[2], Some(vars[3]), &neighbors);
    let values = tape.value(weights).as_slice().to_vec();
    assert!(values.iter().all(|weight| (weight - 1.0 / 3.0).abs() <= 1e-6), "{values:?}");
    let gradients = tape.backward(&[(weights, Tensor::from_vec([1, 3], vec![1.0, -2.0, 0.5]))]);
    assert!(vars.iter().all(|&var| gradients.get(var).unwrap().is_finite()));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let run = || {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let inputs = [tensor(3000, 3, 1), tensor(50, 3, 2), tensor(50, 1, 3), tensor(50, 3, 4), tensor(50, 4, 5)];
        let vars = inputs.map(|input| tape.leaf(input.cast()));
        let neighbors = Neighbors::nearest(tape.value(vars[0]), tape.value(vars[1]), 3);
        let weights = weights(&mut tape, vars[0], vars[1], vars[2], None, &neighbors);
        let frames = Frames { positions: vars[1], translations: vars[3], rotations: vars[4] };
        let moved = blend_frames(&mut tape, weights, vars[0], frames, &neighbors);
        let gradients = tape.backward(&[(moved, tensor(3000, 3, 6).cast())]);
        (tape.value(moved).clone(), vars.map(|var| gradients.get(var).unwrap().clone()))
    };
    let run_with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run);
    assert!([2, 3, 8].iter().all(|&threads| run_with(threads) == run_with(1)));
}
