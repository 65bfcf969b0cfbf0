use std::panic::AssertUnwindSafe;

use super::*;
use crate::check::conformance::{self, Tolerance, compare, run};
pub(crate) use crate::check::test_gpu;
use crate::pointwise;
use crate::tape::{Backward, Device, Op, Tape, Tensor, Var};

/// The bits of results.
pub(crate) fn bits(results: &[(String, Tensor<f32>)]) -> Vec<Vec<u32>> {
    results.iter().map(|(_, tensor)| tensor.as_slice().iter().map(|value| value.to_bits()).collect()).collect()
}

fn noise(count: usize, seed: u64) -> Vec<f32> {
    crate::check::noise(count, seed).into_iter().map(|value| value as f32).collect()
}

#[test]
fn an_adapter_computes_what_the_cpu_computes() {
    let Some(gpu) = test_gpu() else { return };
    let conformance = conformance::check(gpu).unwrap_or_else(|error| panic!("{error}"));
    assert!(conformance.comparisons > 30, "{conformance:?}");
}

#[test]
fn a_gpu_that_computes_something_else_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let x = Tensor::from_vec([100], noise(100, 1));
    // One part in a thousand more on the GPU than on the CPU.
    let wrong = |tape: &mut Tape<f32>, vars: &[Var]| {
        let factor = if tape.device() == Device::Cpu { 1.0 } else { 1.001 };
        vec![pointwise::scale(tape, vars[0], factor)]
    };
    let tolerance = Tolerance { value: 1e-5, gradient: 1e-5 };
    assert!(compare(gpu, "scale", std::slice::from_ref(&x), tolerance, wrong).is_err());
    let right = |tape: &mut Tape<f32>, vars: &[Var]| vec![pointwise::scale(tape, vars[0], 2.0)];
    assert_eq!(compare(gpu, "scale", &[x], tolerance, right).map_err(|error| error.to_string()), Ok(2));
}

/// y = x + 1, without a kernel for a GPU.
struct PlusOne;

impl Op<f32> for PlusOne {
    fn name(&self) -> &'static str {
        "plus one"
    }

    fn forward(&mut self, inputs: &[&Tensor<f32>]) -> Vec<Tensor<f32>> {
        vec![Tensor::from_vec(inputs[0].shape(), inputs[0].as_slice().iter().map(|x| x + 1.0).collect())]
    }

    fn backward(&mut self, pass: Backward<f32>) -> Vec<Option<Tensor<f32>>> {
        vec![Some(pass.dy().clone())]
    }
}

#[test]
fn an_operation_without_a_kernel_runs_on_the_cpu() {
    let Some(gpu) = test_gpu() else { return };
    let inputs = [Tensor::from_vec([3], vec![1.0, 2.0, 3.0])];
    // x is used three times, in (x + 1)² + x, so its gradient is summed on the GPU.
    let f = |tape: &mut Tape<f32>, vars: &[Var]| {
        let more = tape.apply_one(PlusOne, &[vars[0]]);
        let square = pointwise::square(tape, more);
        let product = pointwise::mul(tape, square, vars[0]);
        vec![pointwise::add(tape, product, vars[0])]
    };
    let (found, expected) = (run(Device::Gpu(gpu), &inputs, f), run(Device::Cpu, &inputs, f));
    assert_eq!(found, expected);
    assert_eq!(found[0].1.as_slice(), [5.0, 20.0, 51.0]);
}

#[test]
fn writing_a_tensor_moves_it_to_the_host() {
    let Some(gpu) = test_gpu() else { return };
    let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
    let x = tape.leaf(Tensor::from_vec([3], vec![1.0, 2.0, 3.0]));
    let y = pointwise::square(&mut tape, x);
    let mut tensor = tape.value(y).clone();
    assert!(tensor.gpu() == Some(gpu) && tensor.len() == 3);
    tensor.make_mut()[0] = 7.0;
    assert_eq!(tensor.gpu(), None, "the copy on the GPU would be out of date");
    assert_eq!((tensor.as_slice(), tape.value(y).as_slice()), (&[7.0, 4.0, 9.0][..], &[1.0, 4.0, 9.0][..]));
}

#[test]
#[should_panic(expected = "f64")]
fn a_gpu_refuses_f64() {
    // The test needs an adapter that refuses f64.
    let gpu = test_gpu().unwrap_or_else(|| panic!("SKIPPED: no adapter for f64"));
    Tape::<f64>::new(Device::Gpu(gpu));
}

#[test]
fn empty_and_large_arrays_are_exact() {
    let Some(gpu) = test_gpu() else { return };
    // 17 million elements are more than 65,535 workgroups of 256, so the dispatch is folded; 34 million are more than
    // the 128 MiB that Mesa's software driver lets a kernel see.
    for len in [0, 1, 255, 256, 257, 17_000_000, 34_000_000] {
        let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
        let data: Vec<f32> = (0..len).map(|index| (index % 1024) as f32).collect();
        let x = tape.constant(Tensor::from_vec([len], data));
        let y = pointwise::square(&mut tape, x);
        let is_square = |(index, &y): (usize, &f32)| y == ((index % 1024) * (index % 1024)) as f32;
        assert!(tape.value(y).as_slice().iter().enumerate().all(is_square), "{len} elements");
    }
}

#[test]
fn many_launches_between_two_readbacks_all_run() {
    let Some(gpu) = test_gpu() else { return };
    let before = gpu.counts();
    let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
    let mut x = tape.constant(Tensor::from_vec([2], vec![0.0, 1.0]));
    // More launches than the constants of one submission hold, each with a constant of its own.
    for step in 0..5000 {
        x = pointwise::shift(&mut tape, x, f64::from(step % 5));
    }
    assert_eq!(tape.value(x).as_slice(), [10_000.0, 10_001.0]);
    let after = gpu.counts();
    assert!(after.launches >= before.launches + 5000 && after.submissions >= before.submissions + 2, "{after:?}");
    assert!(after.readbacks > before.readbacks && after.bytes_uploaded > before.bytes_uploaded);
}

#[test]
fn an_unknown_adapter_is_refused_with_the_list_of_adapters() {
    match choose("no such adapter") {
        Err(AdapterError::NotFound { found, .. }) => assert_eq!(found.len(), adapters().len()),
        Err(error) => assert_eq!(error, AdapterError::None),
        Ok(report) => panic!("{report:?}"),
    }
    assert_eq!(choose("gpu").is_ok(), !adapters().is_empty());
}

#[test]
fn what_a_reused_array_held_before_changes_nothing() {
    let Some(gpu) = test_gpu() else { return };
    for _ in 0..4 {
        // Dropped at once: the next array of this size reuses its buffer.
        drop(GpuArray::upload(gpu, &[f32::NAN; 777]));
        let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
        let x = tape.leaf(Tensor::from_vec([777], noise(777, 3)));
        let y = pointwise::square(&mut tape, x);
        let gradients = tape.backward(&[(y, Tensor::full([777], 1.0))]);
        assert!(tape.value(y).is_finite() && gradients.get(x).unwrap().is_finite());
    }
}

/// The message of a failure for lack of memory.
fn refusal(result: impl FnOnce()) -> String {
    let payload = std::panic::catch_unwind(AssertUnwindSafe(result)).unwrap_err();
    match payload.downcast_ref::<GpuFailure>().expect("a typed failure") {
        GpuFailure::OutOfMemory(message) => message.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_array_that_the_adapter_cannot_have_is_refused() {
    let Some(gpu) = test_gpu() else { return };
    let message = refusal(|| drop(GpuArray::new(gpu, usize::MAX >> 4)));
    assert!(
        message.contains("allows arrays of") && message.ends_with("bytes, and 4611686018427387900 are needed"),
        "{message}"
    );
}

#[test]
fn an_array_in_more_parts_than_a_kernel_can_see_is_refused() {
    let Some(gpu) = test_gpu() else { return };
    let len = gpu.visible_bytes() as usize / 4 + 1;
    // If a binding can show the largest buffer, no array needs parts.
    if gpu.0.limits.max_buffer_size < 4 * len as u64 {
        return;
    }
    let square = || {
        let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
        let x = tape.constant(Tensor::from_gpu([len], GpuArray::new(gpu, len)));
        pointwise::square(&mut tape, x);
    };
    let message = grouped::tests::with_arrays(3, || refusal(square));
    assert!(message.contains("allows 3 arrays of") && message.ends_with("and 4 are needed"), "{message}");
}

#[test]
fn kernels_are_counted_and_timed_by_name() {
    let Some(gpu) = test_gpu() else { return };
    let can_time = gpu.time_kernels();
    let before = gpu.usage();
    let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
    let x = tape.constant(Tensor::from_vec([100_000], noise(100_000, 7)));
    let y = pointwise::square(&mut tape, x);
    tape.value(y).as_slice();
    let spent = gpu.usage().since(&before);
    // Other tests use the same adapter meanwhile, with kernels that are not submitted yet.
    let square = spent.kernels.get("square").expect("it ran");
    assert!(square.launches >= 1 && (square.secs > 0.0) == can_time, "{square:?}");
    assert!(spent.counts.launches >= 1 && spent.counts.bytes_uploaded >= 400_000, "{spent:?}");
}
