use std::collections::BTreeSet;

use super::gpu::{CHOOSE, KEYS, KeysBlock, SampleBlock};
use super::*;
use crate::check::agree;
use crate::check::conformance::Disagreement;
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;

const SIZE: SampleSize = SampleSize { share: 0.2, most: 50 };

/// Flags of `rows` rows; every `every`-th row is a candidate.
fn flags(rows: usize, every: usize) -> Tensor<f32> {
    Tensor::from_vec([rows], (0..rows).map(|row| f32::from(row % every == every / 2)).collect())
}

fn drawn(sampled: &SampledRows<f32>) -> Vec<u32> {
    let rows = sampled.rows.row_of_item().iter().zip(sampled.weights.as_slice());
    rows.filter(|(_, weight)| **weight > 0.0).map(|(row, _)| *row).collect()
}

#[test]
fn rows_are_distinct_and_every_candidate_can_be_drawn() {
    let (candidates, mut all) = (flags(90, 3), BTreeSet::new());
    let counts = (0..60).map(|seed| {
        let rows = drawn(&sample_rows(Device::Cpu, &candidates, SampleSize { share: 0.15, most: 50 }, seed));
        let distinct: BTreeSet<u32> = rows.iter().copied().collect();
        all.extend(distinct.iter().copied());
        (rows.len(), distinct.len())
    });
    assert!(counts.into_iter().all(|count| count == (5, 5)));
    assert!(all.into_iter().eq((0..90).filter(|row| row % 3 == 1)));
}

#[test]
fn every_row_is_drawn_about_as_often() {
    // A mean of 200 draws of each of a hundred rows, with a standard deviation of 12.6.
    let mut counts = [0; 100];
    for seed in 0..1000 {
        let size = SampleSize { share: 0.2, most: 100 };
        let sampled = sample_rows(Device::Cpu, &flags(100, 1), size, seed);
        drawn(&sampled).iter().for_each(|&row| counts[row as usize] += 1);
    }
    assert!(counts.iter().all(|count| (140..260).contains(count)), "{counts:?}");
}

#[test]
fn a_share_is_rounded_up_and_has_a_limit() {
    let count = |candidates: usize, share: f64, most: usize| SampleSize { share, most }.of(candidates);
    assert_eq!([count(5, 0.2, 9), count(6, 0.2, 9), count(1, 0.01, 9), count(0, 1.0, 9)], [1, 2, 1, 0]);
    assert_eq!([count(100, 1.0, 9), count(100, 1.0, 1000)], [9, 100]);
}

/// The rows that a GPU draws are those that the CPU draws; the places left over hold other rows.
fn compare(rows: usize, every: usize, size: SampleSize) -> Result<usize, Disagreement> {
    let Some(gpu) = test_gpu() else { return Ok(0) };
    let candidates = flags(rows, every);
    let on_gpu = sample_rows(Device::Gpu(gpu), &candidates, size, 7);
    let expected = sample_rows(Device::Cpu, &candidates, size, 7);
    assert_eq!(on_gpu.rows.len(), size.of(rows), "as many places as if all could be drawn");
    let numbers = |rows: &[u32]| Tensor::from_vec([rows.len()], rows.iter().map(|&row| f64::from(row)).collect());
    let what = format!("the draw from {rows} rows");
    let mismatch = |mismatch| Disagreement { what, mismatch };
    let (found, expected) = (drawn(&on_gpu), drawn(&expected));
    let counts = [found.len(), expected.len()].map(|count| numbers(&[count as u32]));
    agree(&counts[0], &counts[1], 0.0)
        .and_then(|()| agree(&numbers(&found), &numbers(&expected), 0.0))
        .map(|()| on_gpu.rows.row_of_item().iter().collect::<BTreeSet<_>>().len())
        .map_err(mismatch)
}

#[test]
fn a_gpu_draws_the_same_rows() {
    for (rows, every) in [(0, 1), (1, 1), (1, 2), (200, 1), (257, 3), (5000, 2), (5000, 6000)] {
        for size in [SIZE, SampleSize { share: 1.0, most: 20_000 }, SampleSize { share: 0.2, most: 20_000 }] {
            let distinct = compare(rows, every, size).unwrap_or_else(|error| panic!("{error}"));
            assert!(test_gpu().is_none() || distinct == size.of(rows), "a row in two places");
        }
    }
}

#[test]
fn the_kernels_are_valid_and_faults_are_noticed() {
    assert_valid::<KeysBlock>(&KEYS, &[]);
    assert_valid::<SampleBlock>(&CHOOSE, &[]);
    if test_gpu().is_none() {
        return;
    }
    let faults = [
        ("sample, keys", "first >> 13u", "first >> 12u"),
        ("sample, keys", "^ draw.seed", ""),
        ("sample, keys", "> 0.0", ">= 0.0"),
        ("sample", "ceil(", "floor("),
        ("sample", "order[place]", "place"),
    ];
    assert_noticed(&faults, || compare(1001, 3, SampleSize { share: 0.2, most: 20_000 }));
}
