use super::*;
use crate::check::conformance::Disagreement;
use crate::check::{agree, noise};
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::parts::tests::assert_equal_in_parts;
use crate::gpu::tests::test_gpu;
use crate::gpu::{Gpu, GpuArray};

fn random(count: usize) -> Vec<f32> {
    noise(count, count as u64).into_iter().map(|value| value as f32).collect()
}

/// Values that only the GPU has.
fn on_gpu(gpu: Gpu, values: &[f32]) -> Tensor<f32> {
    Tensor::from_gpu([values.len()], GpuArray::upload(gpu, values))
}

/// Lists whose largest magnitude is at an end, negative, NaN, or undefined (empty list).
fn lists() -> Vec<Vec<f32>> {
    let with = |count: usize, at: usize, value: f32| {
        let mut values = random(count);
        values[at] = value;
        values
    };
    let edges = [(1, 0, -3.0), (4096, 4095, 7.0), (4097, 4096, -9.0), (10_000, 0, f32::MAX)];
    let bad = [(300, 299, f32::NEG_INFINITY), (70_000, 65_536, f32::NAN), (70_000, 3, -f32::NAN)];
    edges.into_iter().chain(bad).map(|(count, at, value)| with(count, at, value)).chain([Vec::new()]).collect()
}

#[test]
fn the_largest_is_found_wherever_it_is() {
    let tensors: Vec<Tensor<f32>> = lists().into_iter().map(|list| Tensor::from_vec([list.len()], list)).collect();
    let found = largest_magnitudes(&tensors.iter().collect::<Vec<_>>());
    assert_eq!(found[..5], [3.0, 7.0, 9.0, f32::MAX, f32::INFINITY]);
    assert!(found[5].is_nan() && found[6].is_nan() && found[7] == 0.0, "{found:?}");
}

#[test]
fn a_gpu_finds_the_same_with_one_readback() {
    let Some(gpu) = test_gpu() else { return };
    let host: Vec<Tensor<f32>> = lists().into_iter().map(|list| Tensor::from_vec([list.len()], list)).collect();
    let device: Vec<Tensor<f32>> = lists().iter().map(|list| on_gpu(gpu, list)).collect();
    let mixed: Vec<&Tensor<f32>> = device.iter().zip(&host).flat_map(|(device, host)| [device, host]).collect();
    let bits = |found: Vec<f32>| found.into_iter().map(f32::to_bits).collect::<Vec<_>>();
    let found = bits(largest_magnitudes(&mixed));
    assert!(found.chunks(2).all(|pair| pair[0] == pair[1]), "{found:x?}");
    assert!(device.iter().all(|tensor| !tensor.is_on_host()), "nothing but the figures came back");
}

#[test]
fn the_largest_is_found_in_any_part() {
    let Some(gpu) = test_gpu() else { return };
    let with_last = |count: usize| on_gpu(gpu, &[random(count - 1), vec![-2.0]].concat());
    let tensors = [1, 64, 65, 300, 20_000].map(with_last);
    let result = || largest_magnitudes(&tensors.each_ref());
    assert_eq!((assert_equal_in_parts(result), result()), (0, vec![2.0; 5]), "each part is an item of its own");
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let values = [random(5000), vec![-2.0]].concat();
    let compare = || {
        let found = Tensor::from_vec([1], largest_magnitudes(&[&on_gpu(gpu, &values)]));
        let mismatch = |mismatch| Disagreement { what: "the largest".into(), mismatch };
        agree(&found, &Tensor::from_vec([1], vec![2.0]), 0.0).map(|()| 1).map_err(mismatch)
    };
    let kernel = gpu::LARGEST.kernel.name;
    let wrong = [("& 0x7fffffffu", ""), ("half = 128u", "half = 64u"), ("256u * VALUES", "256u")];
    assert_noticed(&wrong.map(|(right, wrong)| (kernel, right, wrong)), compare);
}
