use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::networks::attention::window_attention;
use crate::tape::{Tape, Var};

const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 2e-5 };

/// Compares the devices on this many rows, window tokens and heads.
fn compare_windows(
    gpu: Gpu,
    rows: usize,
    [queries, window, channels, heads]: [usize; 4],
) -> Result<usize, Disagreement> {
    let tensor = |tokens: usize, seed| {
        let values = noise(rows * tokens * channels, seed).into_iter().map(|value| 2.0 * value as f32);
        Tensor::from_vec([rows, tokens, channels], values.collect())
    };
    let inputs = [tensor(queries, 1), tensor(window, 2), tensor(window, 3)];
    let f = |tape: &mut Tape<f32>, vars: &[Var]| vec![window_attention(tape, vars[0], vars[1], vars[2], heads)];
    compare(gpu, &format!("{rows} windows of {window}"), &inputs, TOLERANCE, f)
}

#[test]
fn kernels_are_valid() {
    for window in [("WINDOW", 1), ("WINDOW", 32)] {
        assert_valid::<WindowBlock>(&FORWARD, &[window]);
        assert_valid::<WindowBlock>(&BACKWARD, &[window]);
    }
    for kernel in [LONG_FORWARD, LONG_BACKWARD] {
        assert_valid::<WindowBlock>(&kernel, &[("WINDOW", 33)]);
    }
}

#[test]
fn a_gpu_looks_at_windows_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for rows in [0, 1, 31, 33, 150] {
        for sizes in [[1, 1, 1, 1], [1, 5, 8, 2], [3, 4, 6, 3]] {
            compare_windows(gpu, rows, sizes).unwrap();
        }
    }
    // The longest window that invocations hold themselves, and longer ones.
    for window in [32, 33, 200] {
        compare_windows(gpu, 4, [2, window, 4, 1]).unwrap();
        compare_windows(gpu, 70, [3, window, 6, 2]).unwrap();
    }
    compare_windows(gpu, 0, [1, 33, 1, 1]).unwrap();
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("window attention", "at < WINDOW; at++) {\n        let key", "at + 1u < WINDOW; at++) {\n        let key"),
        ("window attention backward", "(gradient_at(at) - mean)", "(gradient_at(at) - 0.99 * mean)"),
        ("window attention backward", "g_keys[seen] += g_key", "g_keys[seen] = g_key"),
        ("window attention backward", "weight_at(at) * dy[query + channel]", "weight_at(0u) * dy[query + channel]"),
    ];
    assert_noticed(&faults, || compare_windows(gpu, 30, [2, 4, 6, 2]));
    let faults = [
        ("attention to long windows", "return held[at * stride + own]", "return held[at * stride]"),
        ("attention to long windows backward", "return held[(WINDOW + at)", "return held[(at)"),
        ("attention to long windows backward", "held[(WINDOW + at) * stride + own] = value", "held[own] = value"),
    ];
    assert_noticed(&faults, || compare_windows(gpu, 30, [2, 40, 6, 2]));
}
