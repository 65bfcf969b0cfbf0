use super::*;
use crate::check::conformance::Disagreement;
use crate::check::{agree, noise};
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;

fn tensor(colors: Vec<f32>) -> Tensor<f32> {
    Tensor::from_vec([colors.len()], colors)
}

#[test]
fn colors_are_clamped_and_rounded_half_up() {
    let colors = vec![-0.5, 0.0, 0.5 / 255.0, 1.0 / 255.0, 1.0, 2.0];
    assert_eq!(on_host(&tensor(colors)), Bytes { values: vec![0, 0, 1, 1, 255, 255], are_finite: true });
    let odd = vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    assert_eq!(on_host(&tensor(odd)), Bytes { values: vec![0, 255, 0], are_finite: false });
}

/// Colours below, in and above [0, 1], not near a half between two bytes.
fn colors(len: usize) -> Vec<f32> {
    let is_clear = |color: &f32| ((color * 255.0).fract().abs() - 0.5).abs() > 1e-3;
    let drawn = noise(2 * len, 1).into_iter().map(|value| (0.5 + 0.8 * value) as f32);
    drawn.filter(is_clear).take(len).collect()
}

/// Compares the bytes on a GPU with those on the host.
fn compare(gpu: Gpu, colors: Vec<f32>) -> Result<usize, Disagreement> {
    let (found, len) = (to_bytes(&Tensor::from_gpu([colors.len()], GpuArray::upload(gpu, &colors))), colors.len());
    let expected = on_host(&tensor(colors));
    let [found, expected] = [found, expected].map(|Bytes { values, are_finite }| {
        let numbers = values.into_iter().map(f32::from).chain([f32::from(are_finite)]);
        Tensor::from_vec([len + 1], numbers.collect())
    });
    let disagreement = |mismatch| Disagreement { what: format!("bytes of {len} colours"), mismatch };
    agree(&found, &expected, 0.0).map(|()| 1).map_err(disagreement)
}

#[test]
fn a_gpu_converts_as_the_host_does() {
    assert_valid::<ColorBlock>(&BYTES, &[]);
    let Some(gpu) = test_gpu() else { return };
    for len in [1, 2, 3, 4, 5, 1023, 3000] {
        compare(gpu, colors(len)).unwrap_or_else(|error| panic!("{error}"));
    }
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        compare(gpu, vec![0.2, 0.4, odd, 0.8, 0.1]).unwrap_or_else(|error| panic!("{error}"));
    }
    assert!(to_bytes(&Tensor::from_vec([0], vec![])).values.is_empty());
}

#[test]
fn faults_are_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let faults = [
        ("bytes", "255.0 + 0.5", "255.0"),
        ("bytes", "8u * place", "8u * (3u - place)"),
        ("bytes", "index < colors.len", "index + 1u < colors.len"),
        ("bytes", "atomicMax(&others[0], 1u)", "atomicMax(&others[0], 0u)"),
    ];
    assert_noticed(&faults, || {
        compare(gpu, colors(1000))?;
        compare(gpu, vec![0.2, f32::NAN, 0.8])
    });
}
