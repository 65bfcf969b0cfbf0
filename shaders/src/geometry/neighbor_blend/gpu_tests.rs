use super::super::{Frames, blend, blend_frames, weights};
use super::*;
use crate::check::conformance::{Tolerance, compare, run};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::pointwise;
use crate::tape::{Device, Tape, Var};

/// Sums over hundreds of followers.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 5e-5 };

fn tensor(rows: usize, columns: usize, seed: u64) -> Tensor<f32> {
    Tensor::from_vec([rows, columns], noise(rows * columns, seed).into_iter().map(|value| value as f32).collect())
}

/// Points and nodes in a space of `axes` dimensions, and the three nearest nodes of each point.
fn placed(points: usize, nodes: usize, axes: usize) -> ([Tensor<f32>; 2], Neighbors) {
    let placed = [tensor(points, axes, 1), tensor(nodes, axes, 2)];
    let neighbors = Neighbors::nearest(&placed[0], &placed[1], 3);
    (placed, neighbors)
}

/// Around the sizes of workgroups; few nodes with many followers, and many with few.
const SIZES: [[usize; 2]; 6] = [[0, 5], [1, 1], [63, 7], [257, 2], [600, 9], [40, 300]];

/// Points that follow gated nodes: weights and frames together.
fn carried(neighbors: &Neighbors) -> impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var> {
    move |tape, vars| {
        let &[points, nodes, log_radii, gates, translations, rotations] = vars else { unreachable!("six inputs") };
        let weights = weights(tape, points, nodes, log_radii, Some(gates), neighbors);
        let frames = Frames { positions: nodes, translations, rotations };
        vec![weights, blend_frames(tape, weights, points, frames, neighbors)]
    }
}

fn carried_inputs([points, nodes]: [Tensor<f32>; 2]) -> Vec<Tensor<f32>> {
    let count = nodes.rows();
    let mut rotations = tensor(count, 4, 6);
    // One node has no rotation.
    rotations.make_mut()[..4].fill(0.0);
    vec![points, nodes, tensor(count, 1, 3), tensor(count, 1, 4), tensor(count, 3, 5), rotations]
}

#[test]
fn a_gpu_finds_the_nodes_that_the_cpu_finds() {
    let Some(gpu) = test_gpu() else { return };
    for ([points, nodes], axes, count) in [
        ([1, 1], 1, 4),
        ([63, 7], 3, 3),
        ([65, 64], 11, 16),
        ([300, 65], 32, 2),
        ([500, 200], 3, 4),
        ([90, 70], 2, 29),
        ([9, 50], 2, 33),
        ([70, 65], 33, 5),
    ] {
        let [x, p] = [tensor(points, axes, 1), tensor(nodes, axes, 2)];
        let found = |device: Device, others: bool| {
            // On the GPU if the device is a GPU.
            let mut tape = Tape::new(device);
            let vars = [&x, &p].map(|input| tape.leaf(input.clone()));
            let doubled = vars.map(|var| pointwise::scale(&mut tape, var, 2.0));
            let [x, p] = doubled.map(|var| tape.value(var).clone());
            assert_eq!(x.gpu().is_some(), device != Device::Cpu);
            let found = if others { Neighbors::nearest_others(&p, count) } else { Neighbors::nearest(&x, &p, count) };
            assert_eq!((found.nodes(), found.per_point()), (nodes, count.min(nodes - usize::from(others))));
            (found.points(), found.node_of_item().row_of_item().to_vec())
        };
        for others in [false, true] {
            assert_eq!(found(Device::Gpu(gpu), others), found(Device::Cpu, others), "{points} points, {nodes} nodes");
        }
    }
}

#[test]
fn equally_near_nodes_are_taken_in_order_on_a_gpu() {
    let Some(gpu) = test_gpu() else { return };
    let [points, nodes] = [(1, vec![0.0]), (4, vec![1.0, -1.0, 1.0, 0.5])].map(|(rows, values)| {
        let tensor = Tensor::<f32>::from_vec([rows, 1], values);
        tensor.on_gpu(gpu);
        tensor
    });
    assert_eq!(Neighbors::nearest(&points, &nodes, 3).of_point(0), [3, 0, 1]);
}

#[test]
fn followers_are_sorted_on_a_gpu_as_on_the_host() {
    let Some(gpu) = test_gpu() else { return };
    for [points, nodes] in SIZES {
        let (_, neighbors) = placed(points, nodes, 3);
        let read = |array: &GpuArray| {
            let mut out = vec![0_u32; array.len()];
            array.read_into(&mut out);
            out
        };
        let followers = neighbors.node_of_item().on_gpu(gpu).sorted();
        let [items, starts] = [&followers.items, &followers.starts].map(read);
        for node in 0..nodes {
            let found = &items[starts[node] as usize..starts[node + 1] as usize];
            assert_eq!(found, neighbors.node_of_item().items_of(node), "node {node} of {nodes}");
        }
    }
}

#[test]
fn kernels_are_valid() {
    for others in [0, 1] {
        assert_valid::<NearestBlock>(&NEAREST, &[("AXES", 32), ("KEPT", 32), ("OTHERS", others)]);
        assert_valid::<NearestBlock>(&NEAREST_ANY, &[("OTHERS", others)]);
    }
    for kernel in [BLEND, BLEND_WEIGHTS] {
        assert_valid::<BlendBlock>(&kernel, &[]);
    }
    assert_valid::<BlendBlock>(&BLEND_VALUES, &[("COLUMNS", 4)]);
    for gated in [("GATED", 0), ("GATED", 1)] {
        assert_valid::<WeightsBlock>(&WEIGHTS, &[gated]);
        assert_valid::<WeightsBlock>(&WEIGHTS_POINTS, &[gated]);
        assert_valid::<WeightsBlock>(&WEIGHTS_NODES, &[gated, ("LANES", 16), ("AXES", 3)]);
    }
    for kernel in [FRAMES, FRAMES_POINTS] {
        assert_valid::<FramesBlock>(&kernel, &[]);
    }
    assert_valid::<FramesBlock>(&FRAMES_NODES, &[("LANES", 256)]);
}

#[test]
fn a_gpu_blends_what_the_cpu_blends() {
    let Some(gpu) = test_gpu() else { return };
    for [points, nodes] in SIZES {
        let (_, neighbors) = placed(points, nodes, 3);
        for columns in [1, 3, 4, 70] {
            let inputs = [tensor(points, neighbors.per_point(), 7), tensor(nodes, columns, 8)];
            let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![blend(tape, vars[0], vars[1], &neighbors)];
            compare(gpu, &format!("{columns} columns of {points} points"), &inputs, TOLERANCE, f).unwrap();
        }
    }
}

#[test]
fn a_gpu_carries_points_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for [points, nodes] in SIZES {
        let (placed, neighbors) = placed(points, nodes, 3);
        let what = format!("{points} points carried by {nodes} nodes");
        compare(gpu, &what, &carried_inputs(placed), TOLERANCE, carried(&neighbors)).unwrap();
    }
}

#[test]
fn weights_without_gates_agree_in_spaces_of_any_number_of_axes() {
    let Some(gpu) = test_gpu() else { return };
    for axes in [1, 11, 32, 33, 70] {
        let ([points, nodes], neighbors) = placed(100, 9, axes);
        let inputs = [points, nodes, tensor(9, 1, 3)];
        let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![weights(tape, vars[0], vars[1], vars[2], None, &neighbors)];
        compare(gpu, &format!("{axes} axes"), &inputs, TOLERANCE, f).unwrap();
    }
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("neighbor weights", "pair.falloff * pair.gate + FLOOR", "pair.falloff * pair.gate + 1e-3"),
        ("neighbor weights backward", "(dweights[item] - along)", "(dweights[item] - 0.99 * along)"),
        ("neighbor weights backward, nodes", "(1.0 - pair.gate)", "(1.01 - pair.gate)"),
        ("neighbor weights backward, nodes", "at += LANES", "at += LANES + 1u"),
        ("blend frames", "x - position_of(node)", "x - 1.01 * position_of(node)"),
        ("blend frames backward", "g_point += weights[item]", "g_point += 1.01 * weights[item]"),
        ("blend frames backward, nodes", "Rows(row_x, row_y, row_z)", "Rows(row_x, row_z, row_y)"),
        ("blend frames backward, nodes", "let g_position = total -", "let g_position = 0.99 * total -"),
    ];
    let (placed, neighbors) = placed(200, 6, 3);
    let inputs = carried_inputs(placed);
    assert_noticed(&faults, || compare(gpu, "frames", &inputs, TOLERANCE, carried(&neighbors)));

    let faults = [
        ("neighbor blend", "< first + sizes.per_point", "< first + sizes.per_point - 1u"),
        ("neighbor blend backward, weights", "column < sizes.columns", "column + 1u < sizes.columns"),
        ("neighbor blend backward", "at += LANES", "at += LANES + 1u"),
    ];
    let inputs = [tensor(200, 3, 7), tensor(6, 5, 8)];
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![blend(tape, vars[0], vars[1], &neighbors)];
    assert_noticed(&faults, || compare(gpu, "blend", &inputs, TOLERANCE, f));
}

#[test]
fn faults_of_the_search_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let nearer = ["own_distance < next_distance", "own_distance > next_distance"];
    let full = ["found_count == kept()", "found_count > 0u"];
    let of_tiles = ["nodes[first * AXES + at]", "nodes[at]"];
    let of_lists = ["first_found = point * sizes.kept", "first_found = point"];
    for (kernel, own, axes) in [("nearest nodes", of_tiles, 3), ("nearest nodes, any", of_lists, 40)] {
        let ([points, nodes], _) = placed(200, 80, axes);
        // The nodes are computed on the GPU, so they are searched there.
        let f = |tape: &mut Tape<f32>, vars: &[Var]| {
            let [points, nodes] = [vars[0], vars[1]].map(|var| pointwise::scale(tape, var, 2.0));
            let neighbors = Neighbors::nearest(tape.value(points), tape.value(nodes), 3);
            vec![weights(tape, points, nodes, vars[2], None, &neighbors)]
        };
        let inputs = [points, nodes, Tensor::full([80, 1], 1.0)];
        let faults = [nearer, full, own].map(|[right, wrong]| (kernel, right, wrong));
        assert_noticed(&faults, || compare(gpu, "weights of the nearest", &inputs, TOLERANCE, f));
    }
}

#[test]
fn two_runs_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let (placed, neighbors) = placed(900, 20, 3);
    let inputs = carried_inputs(placed);
    let first = run(Device::Gpu(gpu), &inputs, carried(&neighbors));
    assert!(first == run(Device::Gpu(gpu), &inputs, carried(&neighbors)));
}
