//! A GPU computes what the CPU computes, forward and backward.

use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::{agree, noise};
use crate::gpu::Gpu;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::parts::tests::assert_agree_in_parts;
use crate::gpu::tests::test_gpu;
use crate::tape::{Device, Tape, Tensor, Var};

/// Sums of tens of terms; roots and quotients.
const TIGHT: Tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };

fn tensor(rows: usize, columns: usize, seed: u64) -> Tensor<f32> {
    Tensor::from_vec([rows, columns], noise(rows * columns, seed)).cast()
}

/// A row operation over tensors of noise with these numbers of columns.
type Operation = (&'static str, &'static [usize], fn(&mut Tape<f32>, &[Var]) -> Var);

const MAPS: &[Operation] = &[
    ("row_sum", &[5], |tape, x| row_sum(tape, x[0])),
    ("row_dot", &[7, 7], |tape, x| row_dot(tape, x[0], x[1])),
    ("squared_norm", &[3], |tape, x| squared_norm(tape, x[0])),
    ("norm", &[4], |tape, x| norm(tape, x[0])),
    ("normalize", &[3], |tape, x| normalize(tape, x[0], 0.5)),
    ("normalize, wide", &[700], |tape, x| normalize(tape, x[0], 0.5)),
    ("scale_rows", &[6, 1], |tape, x| scale_rows(tape, x[0], x[1])),
    ("divide_rows", &[2, 1], |tape, x| divide_rows(tape, x[0], x[1], 0.3)),
    ("cosine_distance", &[9, 9], |tape, x| cosine_distance(tape, x[0], x[1], 1e-6)),
];

const ARRANGEMENTS: &[Operation] = &[
    ("concat_columns", &[2, 5, 1], concat_columns),
    ("concat_leading_columns", &[3, 7], |tape, x| concat_leading_columns(tape, &[(x[0], 3), (x[1], 5)])),
    ("concat_rows", &[3, 3], concat_rows),
    ("columns", &[7], |tape, x| columns(tape, x[0], 2..5)),
    ("no columns", &[7], |tape, x| columns(tape, x[0], 3..3)),
    ("reshape", &[6], |tape, x| {
        let rows = tape.value(x[0]).rows();
        reshape(tape, x[0], [2 * rows, 3])
    }),
];

fn compare_operations(operations: &[Operation]) {
    let Some(gpu) = test_gpu() else { return };
    for (name, columns, f) in operations {
        for rows in [0, 1, 100, 257] {
            let inputs: Vec<Tensor<f32>> =
                columns.iter().enumerate().map(|(seed, &columns)| tensor(rows, columns, seed as u64)).collect();
            compare(gpu, &format!("{name}, {rows} rows"), &inputs, TIGHT, |tape, vars| vec![f(tape, vars)]).unwrap();
        }
    }
}

#[test]
fn a_gpu_maps_rows() {
    compare_operations(MAPS);
}

#[test]
fn a_gpu_moves_elements() {
    compare_operations(ARRANGEMENTS);
}

#[test]
fn rows_in_parts_agree_with_whole_rows() {
    let Some(gpu) = test_gpu() else { return };
    let moving = ARRANGEMENTS.iter().filter(|(name, ..)| name.starts_with("concat") || *name == "columns");
    for (name, columns, f) in MAPS.iter().chain(moving) {
        let inputs: Vec<Tensor<f32>> =
            columns.iter().enumerate().map(|(seed, &columns)| tensor(300, columns, 50 + seed as u64)).collect();
        let result = || run(Device::Gpu(gpu), &inputs, |tape, vars| vec![f(tape, vars)]);
        let are_near = |found: &Vec<(String, Tensor<f32>)>, expected: &Vec<(String, Tensor<f32>)>| {
            found.iter().zip(expected).all(|((_, found), (_, expected))| agree(found, expected, TIGHT.value).is_ok())
        };
        assert!(assert_agree_in_parts(result, are_near) >= 2, "{name}: forward and backward");
    }
}

#[test]
fn elements_that_are_moved_elsewhere_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let inputs = [tensor(300, 3, 71), tensor(99, 3, 72)];
    let faults =
        [("columns, joined", "own.first + column", "column"), ("columns, split", "own.first + column", "column")];
    assert_noticed(&faults, || compare(gpu, "concat_rows", &inputs, TIGHT, |tape, vars| vec![concat_rows(tape, vars)]));
}

#[test]
fn a_gpu_repeats_a_row_and_adds_its_gradients() {
    let Some(gpu) = test_gpu() else { return };
    for rows in [0, 1, 257, 5000] {
        let repeated = |tape: &mut Tape<f32>, vars: &[Var]| vec![repeat_row(tape, vars[0], rows)];
        compare(gpu, &format!("{rows} rows"), &[tensor(1, 5, 1)], TIGHT, repeated).unwrap();
    }
}

/// Gathers, sums and means of rows by one list.
fn compare_lists(gpu: Gpu, index: &RowIndex) -> Result<usize, Disagreement> {
    let (rows, items) = (tensor(index.rows(), 3, 1), tensor(index.len(), 3, 2));
    let f = |tape: &mut Tape<f32>, vars: &[Var]| {
        vec![gather(tape, vars[0], index), segment_sum(tape, vars[1], index), segment_mean(tape, vars[1], index)]
    };
    compare(gpu, &format!("{} items of {} rows", index.len(), index.rows()), &[rows, items], TIGHT, f)
}

#[test]
fn a_gpu_picks_and_adds_rows_by_lists() {
    let Some(gpu) = test_gpu() else { return };
    compare_lists(gpu, &RowIndex::new(Vec::new(), 5)).unwrap();
    compare_lists(gpu, &RowIndex::new(vec![0], 1)).unwrap();
    compare_lists(gpu, &RowIndex::new((0..1000).map(|item| item * item % 97).collect(), 100)).unwrap();
    // Rows of one, of a hundred and of ten thousand items, which are added in two and in three passes.
    let long = |item: u32| if item < 10_000 { 3 } else { 1 - item / 10_100 };
    compare_lists(gpu, &RowIndex::new((0..10_101).map(long).collect(), 5)).unwrap();
}

#[test]
fn a_gpu_that_picks_and_adds_otherwise_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let index = RowIndex::new((0..1000).map(|item| item * item % 7).collect(), 7);
    let faults = [
        ("gather", "index % sizes.columns", "0u"),
        ("gather", "1.0 / f32(", "1.01 / f32("),
        ("segment_sum", "at < starts[segment + 1u]", "at + 1u < starts[segment + 1u]"),
        ("segment_sum", "row = items[at]", "row = items[at ^ 1u]"),
    ];
    assert_noticed(&faults, || compare_lists(gpu, &index));
    let joined = |tape: &mut Tape<f32>, vars: &[Var]| {
        vec![concat_leading_columns(tape, &[(vars[0], 3), (vars[1], 1)]), columns(tape, vars[0], 1..3)]
    };
    let inputs = [tensor(50, 3, 1), tensor(50, 2, 2)];
    let faults = [
        ("columns, joined", "row * own.columns + column", "row * own.width + column"),
        ("columns, split", "column < own.width", "true"),
        ("columns", "column + sizes.from_first", "column"),
    ];
    assert_noticed(&faults, || compare(gpu, "concat_columns", &inputs, TIGHT, joined));
}

#[test]
fn a_gpu_takes_weighted_means() {
    let Some(gpu) = test_gpu() else { return };
    let mean = |tape: &mut Tape<f32>, x: &[Var]| vec![weighted_mean_squared_difference(tape, x[0], x[1], x[2])];
    let inputs = |rows: usize, weight: f32| {
        let weights = noise(rows, 3).iter().map(|value| weight * (1.1 + *value as f32)).collect();
        [tensor(rows, 3, 1), tensor(rows, 3, 2), Tensor::from_vec([rows], weights)]
    };
    for (rows, weight) in [(0, 1.0), (2, 1.0), (700, 1.0), (700, 0.0)] {
        compare(gpu, &format!("{rows} rows that weigh {weight}"), &inputs(rows, weight), TIGHT, mean).unwrap();
    }
    let faults = [
        ("weighted mean, terms", "weight * squares", "squares"),
        ("weighted mean backward", "* mean[0]", "* 0.0"),
        ("weighted mean backward", "g_b[index] = -gradient", "g_b[index] = gradient"),
    ];
    assert_noticed(&faults, || compare(gpu, "a faulty mean", &inputs(300, 1.0), TIGHT, mean));
}

#[test]
fn a_gpu_computes_only_requested_gradients() {
    let Some(gpu) = test_gpu() else { return };
    let constant = tensor(20, 1, 9);
    compare(gpu, "scale_rows of a constant", &[tensor(20, 3, 1)], TIGHT, |tape, vars| {
        let factors = tape.constant(constant.clone());
        vec![scale_rows(tape, vars[0], factors)]
    })
    .unwrap();
}

#[test]
fn a_gpu_that_maps_rows_otherwise_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let inputs = [tensor(50, 3, 1)];
    let normalized = |tape: &mut Tape<f32>, vars: &[Var]| vec![normalize(tape, vars[0], 0.5)];
    let faults = [
        ("normalize", "value * value", "value"),
        ("normalize backward", "product, 0.0, is_short", "product, 0.0, false"),
    ];
    assert_noticed(&faults, || compare(gpu, "normalize", &inputs, TIGHT, normalized));
    let other_epsilon = |tape: &mut Tape<f32>, vars: &[Var]| {
        vec![normalize(tape, vars[0], if tape.device() == Device::Cpu { 0.5 } else { 0.51 })]
    };
    assert!(compare(gpu, "another epsilon", &inputs, TIGHT, other_epsilon).is_err());
}

/// Sums rows; where a GPU does, its gradient is wrong.
struct FaultySum;

impl RowMap<1> for FaultySum {
    const NAME: &'static str = "faulty sum";

    fn output_columns(&self, _columns: [usize; 1]) -> usize {
        1
    }

    fn value<T: crate::tape::Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        y[0] = x.iter().copied().sum();
    }

    fn gradient<T: crate::tape::Real>(&self, _x: [&[T]; 1], _y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        dx.fill(dy[0]);
    }

    fn wgsl(&self, _columns: [usize; 1]) -> Option<RowWgsl> {
        let gradients = "fn gradient_0(row: u32, column: u32) -> f32 { return 1.001 * dy[row]; }";
        Some(RowWgsl {
            value: include_str!("reduce/row_sum.wgsl"),
            gradients,
            specialisation: Vec::new(),
            numbers: Vec::new(),
        })
    }
}

#[test]
fn a_gradient_in_wgsl_that_is_wrong_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let sum = |tape: &mut Tape<f32>, vars: &[Var]| vec![map_rows(tape, FaultySum, [vars[0]])];
    assert!(compare(gpu, "a faulty sum", &[tensor(50, 3, 1)], TIGHT, sum).is_err());
}

#[test]
fn the_kernels_of_maps_are_valid() {
    validate_map(&FaultySum, [5]);
    reduce::validate_maps();
}
