use std::cell::Cell;

use super::*;
use crate::gpu::tests::test_gpu;
use crate::gpu::{GpuArray, Part};

thread_local! {
    /// Bytes of a window at most, for the tests of this thread.
    static VISIBLE: Cell<u64> = const { Cell::new(u64::MAX) };
    /// Bytes of an array that a launch may see, for the tests of this thread.
    static SEEN: Cell<u64> = const { Cell::new(u64::MAX) };
    /// Launches that were split so far, and the one of them that reads the wrong rows.
    static SPLIT: Cell<usize> = const { Cell::new(0) };
    static FAULTY: Cell<usize> = const { Cell::new(usize::MAX) };
}

pub fn visible_bytes() -> u64 {
    VISIBLE.get()
}

pub fn seen_bytes() -> u64 {
    SEEN.get()
}

/// The result on an adapter that lets kernels see so many bytes of an array: a launch that sees more fails.
pub fn seeing_at_most<R>(bytes: u64, result: impl FnOnce() -> R) -> R {
    SEEN.set(bytes);
    let result = result();
    SEEN.set(u64::MAX);
    result
}

/// Counts a launch that is split; whether it is the one that is to go wrong.
pub fn is_faulty() -> bool {
    SPLIT.replace(SPLIT.get() + 1) == FAULTY.get()
}

/// A window that reads the rows before those that it writes.
pub fn misplaced<'a>(arrays: &[Binding<'a>], rows: usize, first: usize, count: usize) -> Vec<Binding<'a>> {
    let before = first.saturating_sub(ALIGNMENT);
    let first = |array: &Binding| if array.is_read_only() { before } else { first };
    arrays.iter().map(|array| array.rows(rows, first(array), count)).collect()
}

/// The result with windows of so many bytes, one of which may be faulty, and how many launches were split.
fn with_windows<R>(bytes: u64, faulty: usize, result: impl FnOnce() -> R) -> (R, usize) {
    VISIBLE.set(bytes);
    FAULTY.set(faulty);
    SPLIT.set(0);
    let result = result();
    VISIBLE.set(u64::MAX);
    (result, SPLIT.get())
}

/// The result with windows as small as can be.
pub fn in_smallest_windows<R>(result: impl FnOnce() -> R) -> R {
    with_windows(1, usize::MAX, result).0
}

/// The number of launches that are split where windows are as small as can be. Panics unless the result is the same for
/// windows of any size, and another where one of these launches, whichever it is, reads the wrong rows.
pub fn assert_equal_in_windows<R: PartialEq>(result: impl Fn() -> R) -> usize {
    // The smallest first: what nobody writes does not hold what an earlier run left there.
    let (smallest, split) = with_windows(1, usize::MAX, &result);
    let (larger, _) = with_windows(50_000, usize::MAX, &result);
    let whole = result();
    assert!(smallest == whole && larger == whole, "{split} launches, split, compute something else");
    for faulty in 0..split {
        let (wrong, _) = with_windows(1, faulty, &result);
        assert!(wrong != whole, "nobody notices that the {faulty}-th of {split} launches reads the wrong rows");
    }
    split
}

/// Rows, first elements and elements of the windows for so many bytes.
fn windows(gpu: Gpu, bytes: u64, rows: usize, arrays: &[Binding]) -> Vec<(usize, Vec<[u64; 2]>)> {
    let place = |array: &Binding| match array.resource() {
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { offset, size, .. }) => [offset, size.unwrap().get()],
        other => panic!("{other:?}"),
    };
    let mut found = Vec::new();
    let record = |rows, arrays: &[Binding]| found.push((rows, arrays.iter().map(place).collect()));
    with_windows(bytes, usize::MAX, || in_windows(gpu, rows, arrays, record));
    found
}

#[test]
fn windows_fit_and_follow_on_each_other() {
    let Some(gpu) = test_gpu() else { return };
    let [x, y, all] = [3 * 300, 300, 1000].map(|len| GpuArray::new(gpu, len));
    let arrays = [Binding::Read(&x), Binding::Write(&y), Binding::Read(&all).all()];
    let one = vec![(300, vec![[0, 3600], [0, 1200], [0, 4000]])];
    assert_eq!(windows(gpu, 3600, 300, &arrays), one);
    // 192 rows of three elements are 2304 bytes, and 256 are more than 3000.
    let two = vec![(192, vec![[0, 2304], [0, 768], [0, 4000]]), (108, vec![[2304, 1296], [768, 432], [0, 4000]])];
    assert_eq!(windows(gpu, 3000, 300, &arrays), two);
    let counts: Vec<usize> = windows(gpu, 1, 300, &arrays).iter().map(|(rows, _)| *rows).collect();
    assert_eq!(counts, [64, 64, 64, 64, 44]);
    let empty = GpuArray::new(gpu, 0);
    assert_eq!(windows(gpu, 1, 0, &[Binding::Read(&empty)]), [(0, vec![[0, 16]])]);
}

#[test]
#[should_panic(expected = "begins at element 65")]
fn a_part_begins_where_adapters_let_it() {
    // Without an adapter there is nothing to refuse.
    let gpu = test_gpu().unwrap_or_else(|| panic!("SKIPPED: no adapter; begins at element 65"));
    Part::new(&GpuArray::new(gpu, 100), 65, 3);
}
