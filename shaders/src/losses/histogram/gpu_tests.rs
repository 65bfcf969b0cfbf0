use super::super::{divergence_from_uniform, soft_histogram};
use super::*;
use crate::check::conformance::{Disagreement, Tolerance, compare, run};
use crate::check::noise;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;
use crate::tape::{Device, Tape, Var};

/// Sums over thousands of values in f32, which the CPU computes in f64.
const TOLERANCE: Tolerance = Tolerance { value: 1e-5, gradient: 1e-4 };

/// Values, some of them outside the bins, none near a bin's centre, where gradients jump.
fn values(len: usize, bins: usize) -> Tensor<f32> {
    let is_clear = |value: &f64| {
        let at = (value + 1.0) * bins as f64 / 2.0 - 0.5;
        (at - at.round()).abs() > 1e-3
    };
    let drawn = noise(2 * len, 1).into_iter().map(|value| 1.2 * value).filter(is_clear).take(len);
    Tensor::from_vec([len], drawn.map(|value| value as f32).collect())
}

fn shares_and_divergence(bins: usize) -> impl Fn(&mut Tape<f32>, &[Var]) -> Vec<Var> {
    move |tape, vars| {
        let shares = soft_histogram(tape, vars[0], bins, [-1.0, 1.0]);
        vec![shares, divergence_from_uniform(tape, shares)]
    }
}

fn compare_histograms(gpu: Gpu, len: usize, bins: usize) -> Result<usize, Disagreement> {
    compare(
        gpu,
        &format!("{len} values in {bins} bins"),
        &[values(len, bins)],
        TOLERANCE,
        shares_and_divergence(bins),
    )?;
    // The shares do not add up to 1: otherwise a constant term in all their gradients would go unnoticed.
    let shares = Tensor::from_vec([bins], noise(bins, 2).into_iter().map(|value| value.abs() as f32).collect());
    let divergence = |tape: &mut Tape<f32>, vars: &[Var]| vec![divergence_from_uniform(tape, vars[0])];
    compare(gpu, &format!("the divergence of {bins} bins"), &[shares], TOLERANCE, divergence)
}

#[test]
fn kernels_are_valid() {
    for columns in [2, 256] {
        assert_valid::<HistogramBlock>(&BLOCKS, &[("COLUMNS", columns)]);
    }
    assert_valid::<TotalBlock>(&TOTAL, &[LANES]);
    assert_valid::<HistogramBlock>(&BACKWARD, &[]);
    for backward in [0, 1] {
        assert_valid::<DivergenceBlock>(&DIVERGENCE, &[LANES, ("BACKWARD", backward)]);
    }
}

#[test]
fn a_gpu_counts_as_the_cpu_does() {
    let Some(gpu) = test_gpu() else { return };
    for (len, bins) in [(1, 2), (255, 8), (257, 33), (4097, 256), (30_000, 20), (500, 257), (5000, 600)] {
        compare_histograms(gpu, len, bins).unwrap();
    }
}

#[test]
fn what_is_no_number_shows() {
    let Some(gpu) = test_gpu() else { return };
    let mut values = values(300, 8);
    values.make_mut()[17] = f32::NAN;
    let shares = &run(Device::Gpu(gpu), &[values], shares_and_divergence(8))[0].1;
    assert!(!shares.is_finite());
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("soft histogram", "first < BLOCK", "first + GROUP < BLOCK"),
        ("soft histogram", "own += parts[value].y", "own += 0.99 * parts[value].y"),
        ("soft histogram", "tiles * COLUMNS + local", "tiles + local"),
        ("soft histogram, total", "block += 256u", "block += 257u"),
        ("soft histogram backward", "at > 0.0 && at < last", "at > 1.0 && at < last"),
        ("divergence from uniform", "logarithm + share /", "logarithm + 0.9 * share /"),
    ];
    // More than 256 blocks; and more bins than a workgroup has.
    assert_noticed(&faults, || {
        compare_histograms(gpu, 1_100_000, 8)?;
        compare_histograms(gpu, 500, 300)
    });
}
