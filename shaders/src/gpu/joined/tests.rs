use std::cell::Cell;

use super::*;
use crate::check::conformance::{self, Disagreement};
use crate::gpu::fault_tests::assert_noticed;
use crate::gpu::grouped::tests::with_arrays;
use crate::gpu::layout_tests::assert_valid;
use crate::gpu::tests::test_gpu;

thread_local! {
    /// Launches of more than [`FEWEST_ARRAYS`] arrays, some of them for several items, and those whose inputs were joined.
    static LARGE: Cell<usize> = const { Cell::new(0) };
    static JOINED: Cell<usize> = const { Cell::new(0) };
    /// Whether a comparison of this test was repeated with joined inputs.
    static COMPARED: Cell<bool> = const { Cell::new(false) };
}

pub(super) fn count_large(arrays: usize) {
    LARGE.set(LARGE.get() + usize::from(arrays > FEWEST_ARRAYS as usize));
}

pub(super) fn count_joined() {
    JOINED.set(JOINED.get() + 1);
}

/// The result on an adapter that allows [`FEWEST_ARRAYS`], and the number of launches with joined inputs.
fn joined<R>(result: impl FnOnce() -> R) -> (R, usize) {
    let before = JOINED.get();
    let result = with_arrays(FEWEST_ARRAYS as usize, result);
    (result, JOINED.get() - before)
}

/// Repeats the first comparison of a test that runs a kernel with many arrays, with joined inputs.
pub(crate) fn compare_joined(compare: impl FnOnce() -> Result<usize, Disagreement>) -> Result<(), Disagreement> {
    if COMPARED.get() || LARGE.get() == 0 {
        return Ok(());
    }
    let (compared, launches) = joined(compare);
    COMPARED.set(launches > 0);
    compared.map(drop).map_err(|error| Disagreement { what: format!("joined, {}", error.what), ..error })
}

#[test]
fn an_adapter_that_allows_few_arrays_computes_what_the_cpu_computes() {
    assert_valid::<PlaceBlock>(&JOIN, &[]);
    let Some(gpu) = test_gpu() else { return };
    let check = || {
        let (conformance, launches) = joined(|| conformance::check(gpu));
        // Projection and blending, forward and backward.
        assert!(launches > 3, "{launches}");
        conformance.map(|conformance| conformance.comparisons)
    };
    // With other faults, kernels would run through lists of arbitrary length.
    let faults = [(JOIN.name, "= x[at]", "= 0u"), (JOIN.name, "= place.first;", "= 0u;")];
    assert_noticed(&faults, check);
}

#[test]
fn inputs_are_read_from_the_joined_array() {
    let kernel = "
        @group(0) @binding(0) var<uniform> size: Size;
        @group(0) @binding(1) var<storage, read_write> y: array<f32>; // y[0] = 3;
        @group(0) @binding(2) var<storage, read> x: array<vec4<f32>>;
        @group(0) @binding(3) var<storage, read_write> z: array<atomic<u32>>;
        @group(0) @binding(4) var<storage, read> w: array<u32>;
        y[w[i]] = x[i].z + f32(arrayLength(&x)); atomicAdd(&z[w[0]], 1u);";
    let found = text(kernel, 4);
    let squeezed: String = found.split_whitespace().collect::<Vec<_>>().join(" ");
    let expected = "@group(0) @binding(1) var<storage, read> joined_numbers: array<u32>; \
        fn get_x(at: u32) -> vec4<f32> { let first = joined_numbers[0u] + at * 4u; return bitcast<vec4<f32>>(vec4<u32>(\
        joined_numbers[first + 0u], joined_numbers[first + 1u], joined_numbers[first + 2u], joined_numbers[first + 3u])); } \
        fn len_x() -> u32 { return joined_numbers[1u] / 4u; } \
        fn get_w(at: u32) -> u32 { let first = joined_numbers[2u] + at * 1u; return bitcast<u32>(joined_numbers[first + 0u]); } \
        fn len_w() -> u32 { return joined_numbers[3u] / 1u; } \
        @group(0) @binding(0) var<uniform> size: Size; \
        @group(0) @binding(2) var<storage, read_write> y: array<f32>; \
        @group(0) @binding(3) var<storage, read_write> z: array<atomic<u32>>; \
        y[get_w(i)] = get_x(i).z + f32(len_x()); atomicAdd(&z[get_w(0)], 1u);";
    assert_eq!(squeezed, expected);
}

#[test]
fn inputs_that_exceed_a_binding_are_an_error() {
    // The test needs an adapter; the sizes follow from its limits.
    let Some(gpu) = test_gpu() else { return };
    let len = (gpu.visible_bytes() / 4).min(1 << 26) as usize;
    let big = GpuArray::new(gpu, len);
    let arrays = vec![Binding::Read(&big); 2 + (gpu.visible_bytes() / 4) as usize / len];
    let most = arrays.len() - 1;
    let raised = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        with_arrays(most, || Joined::of(gpu, "kernel", &arrays).is_some())
    }));
    let failure = raised.expect_err("too large").downcast::<GpuFailure>().expect("a failure of the device");
    assert!(failure.to_string().contains("joined in one array"), "{failure}");
}
