use std::cell::Cell;

use super::*;
use crate::check::conformance::Disagreement;
use crate::gpu::fault_tests::with_fault;

thread_local! {
    /// Whether parts are as small as they can be, for the tests of this thread.
    static SMALLEST: Cell<bool> = const { Cell::new(false) };
    /// Launches with an array in parts.
    static SPLIT: Cell<usize> = const { Cell::new(0) };
    /// Comparisons of this test that were repeated in parts.
    static COMPARED: Cell<usize> = const { Cell::new(0) };
}

/// The most comparisons of a test that are repeated in parts: each one compiles its kernels again.
const MOST_COMPARED: usize = 2;

/// The length of a part that a test sets instead of the adapter's limit.
pub(crate) fn changed_len() -> Option<usize> {
    SMALLEST.get().then_some(ALIGNMENT)
}

/// The length of a part for these arrays; if a test requests the smallest, the least with which a kernel can bind all
/// parts.
pub(crate) fn bindable_len(gpu: Gpu, arrays: &[Binding], len: usize) -> usize {
    if arrays.len() > gpu.arrays_per_kernel() {
        return len.max(arrays.iter().map(|array| array.len()).max().unwrap_or(0));
    }
    let parts = |len| arrays.iter().map(|array| count_of(array.len(), len)).sum::<usize>();
    let fits = |&len: &usize| !SMALLEST.get() || parts(len) <= gpu.arrays_per_kernel();
    let len = (len..).step_by(ALIGNMENT).find(fits).expect("whole arrays fit");
    SPLIT.set(SPLIT.get() + usize::from(parts(len) > arrays.len()));
    len
}

/// The result with the smallest parts, and the number of launches with an array in parts.
fn in_parts<R>(result: impl FnOnce() -> R) -> (R, usize) {
    SPLIT.set(0);
    SMALLEST.set(true);
    let result = result();
    SMALLEST.set(false);
    (result, SPLIT.get())
}

/// Repeats a comparison with arrays in parts, up to [`MOST_COMPARED`] times per test.
pub(crate) fn compare_in_parts(compare: impl FnOnce() -> Result<usize, Disagreement>) -> Result<(), Disagreement> {
    if COMPARED.get() == MOST_COMPARED || SMALLEST.get() {
        return Ok(());
    }
    let (compared, split) = in_parts(compare);
    COMPARED.set(COMPARED.get() + usize::from(split > 0));
    compared.map(drop).map_err(|error| Disagreement { what: format!("in parts, {}", error.what), ..error })
}

/// The number of launches with an array in parts, with the smallest parts. Panics unless the result equals the one with whole
/// arrays and differs if parts are swapped.
pub(crate) fn assert_equal_in_parts<R: PartialEq>(result: impl Fn() -> R) -> usize {
    assert_agree_in_parts(result, |found, expected| found == expected)
}

/// Like [`assert_equal_in_parts`], for kernels with arithmetic: compilers fuse the multiplications and additions of
/// different texts differently.
pub(crate) fn assert_agree_in_parts<R>(result: impl Fn() -> R, agree: impl Fn(&R, &R) -> bool) -> usize {
    // In parts first, so that unwritten elements do not hold results of an earlier run.
    let (found, split) = in_parts(&result);
    assert!(agree(&found, &result()), "{split} launches, with arrays in parts, compute something else");
    let (mistaken, _) = with_fault(("parts", "_1_part[at - ", "_1_part[1u + at - "), || in_parts(&result));
    assert!(split == 0 || !agree(&mistaken, &found), "swapped parts go unnoticed");
    split
}

#[test]
fn places_are_looked_for_in_their_parts() {
    let kernel = "
        @group(0) @binding(1) var<storage, read> x: array<vec4<f32>>; // x[0] = 3;
        @group(0) @binding(2) var<storage, read_write> y: array<f32>;
        @group(0) @binding(3) var<storage, read> z: array<u32>;
        y[z[i] + z[1]] += x[z[2]].w; if (y[0] == y.z[3]) { y[1] = arrayLength(&y); }
    ";
    let found = text::in_parts(kernel, &[2, 3, 1], 64);
    assert!(found.starts_with(
        "@group(0) @binding(4) var<storage, read> x_1_part: array<vec4<f32>>;\n\
         fn len_x() -> u32 { return 16u + arrayLength(&x_1_part); }\n\
         fn get_x(at: u32) -> vec4<f32> {\n    switch at / 16u {\n        case 1u: { return x_1_part[at - 16u]; }\n        \
         default: {}\n    }\n    return x[at];\n}\n\
         @group(0) @binding(5) var<storage, read_write> y_1_part: array<f32>;\n\
         @group(0) @binding(6) var<storage, read_write> y_2_part: array<f32>;\n"
    ));
    let uses =
        "set_y(z[i] + z[1], get_y(z[i] + z[1]) + ( get_x(z[2]).w)); if (get_y(0) == y.z[3]) { set_y(1,  len_y()); }";
    assert!(found.contains(uses) && !found.contains("= 3"), "{found}");
    let z = text::in_parts(kernel, &[1, 1, 2], 64);
    assert!(z.contains("y[get_z(i) + get_z(1)] += x[get_z(2)].w; if (y[0] == y.z[3])"), "{z}");
}

#[test]
fn atomic_operations_find_their_part() {
    let kernel = "@group(0) @binding(1) var<storage, read_write> n: array<atomic<u32>>;
        atomicAdd(&n[atomicLoad(&m[0])], n_of(a[3])); atomicMax(&m[1], atomicLoad(&n[7]));";
    let found = text::in_parts(kernel, &[2], 64);
    assert!(found.contains("fn atomicMax_n(at: u32, value: u32) -> u32 {"), "{found}");
    let uses = "atomicAdd_n(atomicLoad(&m[0]), n_of(a[3])); atomicMax(&m[1], atomicLoad_n(7));";
    assert!(found.contains("fn atomicLoad_n(at: u32) -> u32 {") && found.contains(uses), "{found}");
}
