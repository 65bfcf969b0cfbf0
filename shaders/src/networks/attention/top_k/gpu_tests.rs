use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::networks::attention::top_k_attention;
use crate::tape::{Device, Tape, Var};

const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 5e-5 };

/// Queries, keys and values of noise; the last keys repeat the first ones.
fn inputs(queries: usize, keys: usize, width: usize) -> [Tensor<f32>; 3] {
    let tensor = |rows: usize, seed| {
        let values = noise(rows * width, seed).into_iter().map(|value| 2.0 * value as f32);
        Tensor::from_vec([rows, width], values.collect())
    };
    let mut key = tensor(keys, 2);
    key.make_mut().copy_within(..keys / 4 * width, (keys - keys / 4) * width);
    [tensor(queries, 1), key, tensor(keys, 3)]
}

/// The outputs with the indices `picked`; every seventh key is invalid.
fn attention(keys: usize, heads: usize, k: usize, picked: &[usize]) -> impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var> {
    let valid: Vec<bool> = (0..keys).map(|key| keys < 7 || key % 7 != 3).collect();
    move |tape, vars| {
        let found = top_k_attention(tape, [vars[0], vars[1], vars[2]], &valid, heads, k);
        picked.iter().map(|&output| [found.mixed, found.probabilities][output]).collect()
    }
}

fn compare_attention(
    gpu: Gpu,
    [queries, keys, heads, depth]: [usize; 4],
    k: usize,
    picked: &[usize],
) -> Result<usize, Disagreement> {
    let what = format!("{k} of {keys} keys, {queries} queries, {heads} heads of {depth}");
    compare(gpu, &what, &inputs(queries, keys, heads * depth), TOLERANCE, attention(keys, heads, k, picked))
}

#[test]
fn kernels_are_valid() {
    for columns in [("COLUMNS", 1), ("COLUMNS", 32)] {
        assert_valid::<TopKBlock>(&CHOOSE, &[LANES, columns]);
        assert_valid::<TopKBlock>(&BACKWARD, &[LANES, columns, ("ARRIVING", 0b11)]);
    }
    assert_valid::<TopKBlock>(&MEAN, &[]);
    assert_valid::<TopKBlock>(&KEYS_BACKWARD, &[("ARRIVING", 0b10)]);
}

#[test]
fn a_gpu_looks_at_the_keys_that_the_cpu_looks_at() {
    let Some(gpu) = test_gpu() else { return };
    let sizes = [[0, 5, 1, 2], [1, 1, 1, 1], [3, 20, 2, 4], [65, 300, 2, 3], [7, 600, 1, 40]];
    for (sizes, k) in sizes.into_iter().flat_map(|sizes| [1, 3, 260, 1000].map(|k| (sizes, k))) {
        compare_attention(gpu, sizes, k, &[0, 1]).unwrap();
    }
    for output in [0, 1] {
        compare_attention(gpu, [9, 40, 2, 4], 5, &[output]).unwrap();
    }
}

#[test]
fn without_keys_nothing_is_seen() {
    let Some(gpu) = test_gpu() else { return };
    let [query, key, value] = inputs(4, 6, 4);
    let f = |tape: &mut Tape<f32>, vars: &[Var]| {
        let found = top_k_attention(tape, [vars[0], vars[1], vars[2]], &[false; 6], 2, 3);
        vec![found.mixed, found.probabilities]
    };
    compare(gpu, "no keys", &[query, key, value], TOLERANCE, f).unwrap();
}

#[test]
fn of_equal_keys_the_first_are_kept() {
    let Some(gpu) = test_gpu() else { return };
    let equal = [inputs(5, 9, 4)[0].clone(), Tensor::full([300, 4], 0.5), inputs(5, 300, 4)[2].clone()];
    let probabilities = |device| run(device, &equal, attention(300, 1, 20, &[1])).swap_remove(0).1;
    let found = probabilities(Device::Gpu(gpu));
    assert_eq!(found.as_slice().iter().filter(|&&p| p > 0.0).count(), 5 * 20);
    crate::check::agree(&found, &probabilities(Device::Cpu), 1e-6).unwrap();
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("top-k attention", "bits > limit.x", "bits >= limit.x"),
        ("top-k attention", "~bits", "bits"),
        ("top-k attention", "sizes.scale * scores", "scores"),
        ("top-k attention, mean", "head < sizes.heads", "head + 1u < sizes.heads"),
        ("top-k attention backward", "(g_scores[at] - mean)", "(g_scores[at] - 0.99 * mean)"),
        ("top-k attention backward, keys", "at < end", "at + 1u < end"),
    ];
    assert_noticed(&faults, || compare_attention(gpu, [10, 50, 2, 4], 9, &[0, 1]));
}

#[test]
fn two_runs_give_equal_bytes() {
    let Some(gpu) = test_gpu() else { return };
    let inputs = inputs(30, 400, 8);
    let results = || run(Device::Gpu(gpu), &inputs, attention(400, 2, 50, &[0, 1]));
    assert!(results() == results());
}
