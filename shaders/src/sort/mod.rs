//! Stable radix sort and prefix sums of whole numbers on a GPU: reduce, then scan, then scatter, which needs no progress
//! guarantee between workgroups (Merrill and Grimshaw 2011).

#[cfg(test)]
mod tests;

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, Length, uniforms};

const SCAN: Kernel = Kernel { name: "scan", text: &[include_str!("scan.wgsl")] };
const SCAN_ADD: Kernel = Kernel { name: "scan, offsets", text: &[include_str!("scan_add.wgsl")] };
const SORT: &str = include_str!("sort.wgsl");
const COUNT: Kernel = Kernel { name: "sort, counts", text: &[SORT, include_str!("sort_count.wgsl")] };
const ROWS: Kernel = Kernel { name: "sort, rows", text: &[SORT, include_str!("sort_rows.wgsl")] };
const SCATTER: Kernel = Kernel { name: "sort, scatter", text: &[SORT, include_str!("sort_scatter.wgsl")] };
const STARTS: Kernel = Kernel { name: "sort, starts", text: &[include_str!("sort_starts.wgsl")] };

/// Elements per workgroup of every kernel but the offsets and starts.
const BLOCK: usize = Length::BLOCK;
/// Elements per workgroup of the offsets and starts, and invocations of those of the rows.
const ADD_GROUP: usize = 256;
/// Bits per pass, and the digits that they make.
const DIGIT_BITS: u32 = 8;
const DIGITS: usize = 1 << DIGIT_BITS;

/// Sums stop here: they stay monotonic where they would overflow.
pub const SUM_CAP: u32 = 1 << 29;

uniforms! {
    struct ScanBlock as "Scan" {
        len: u32,
    }
}

uniforms! {
    struct SortBlock as "Sort" {
        len: u32,
        blocks: u32,
        shift: u32,
    }
}

uniforms! {
    struct StartsBlock as "Starts" {
        len: u32,
    }
}

/// The sum of all elements before each; at most [`SUM_CAP`].
pub fn exclusive_sums(gpu: Gpu, input: &GpuArray) -> GpuArray {
    let (sums, blocks) = (GpuArray::new(gpu, input.len()), input.len().div_ceil(BLOCK));
    let block_sums = GpuArray::new(gpu, blocks);
    let constants = ScanBlock { len: input.len() as u32 };
    let arrays = [Binding::Read(input), Binding::Write(&sums), Binding::Write(&block_sums)];
    SCAN.launch(gpu, &[], &constants, &arrays, blocks);
    if blocks > 1 {
        let before = exclusive_sums(gpu, &block_sums);
        let arrays = [Binding::Read(&before), Binding::Write(&sums)];
        SCAN_ADD.launch(gpu, &[], &constants, &arrays, input.len().div_ceil(ADD_GROUP));
    }
    sums
}

/// The keys in rising order and, for each, where it was; equal keys keep their order. Only the lowest `bits` count.
pub fn sort(gpu: Gpu, keys: &GpuArray, bits: u32) -> (GpuArray, GpuArray) {
    sort_first(gpu, keys, None, bits)
}

/// As [`sort`] for the first keys of the array, as many as `length` says; what follows in the results is undefined.
pub fn sort_first(gpu: Gpu, keys: &GpuArray, length: Option<&Length>, bits: u32) -> (GpuArray, GpuArray) {
    let mut sorted = pass(gpu, (keys, None), length, 0);
    for shift in (DIGIT_BITS..bits).step_by(DIGIT_BITS as usize) {
        sorted = pass(gpu, (&sorted.0, Some(&sorted.1)), length, shift);
    }
    sorted
}

/// Keys and their values by one digit.
fn pass(
    gpu: Gpu,
    (keys, values): (&GpuArray, Option<&GpuArray>),
    length: Option<&Length>,
    shift: u32,
) -> (GpuArray, GpuArray) {
    let (len, blocks) = (keys.len(), keys.len().div_ceil(BLOCK));
    let constants = SortBlock { len: len as u32, blocks: blocks as u32, shift };
    let counted = ("COUNTED", u32::from(length.is_some()));
    let of_blocks = length.map_or(Groups::Count(blocks), Length::blocks);
    let length = Binding::Read(length.map_or(keys, Length::array));
    let (counts, totals) = (GpuArray::new(gpu, DIGITS * blocks), GpuArray::new(gpu, DIGITS));
    COUNT.launch(gpu, &[counted], &constants, &[length, Binding::Read(keys), Binding::Write(&counts)], of_blocks);
    let lanes = blocks.next_power_of_two().min(ADD_GROUP);
    let arrays = [length, Binding::Write(&counts), Binding::Write(&totals)];
    let groups = if blocks == 0 { 0 } else { DIGITS * lanes / ADD_GROUP };
    ROWS.launch(gpu, &[counted, ("LANES", lanes as u32)], &constants, &arrays, groups);
    let (sorted_keys, sorted_values) = (GpuArray::new(gpu, len), GpuArray::new(gpu, len));
    let read = [keys, values.unwrap_or(keys), &counts, &totals].map(Binding::Read);
    let arrays = [&[length], &read[..], &[&sorted_keys, &sorted_values].map(Binding::Write)].concat();
    let specialisation = [counted, ("FIRST", u32::from(values.is_none()))];
    SCATTER.launch(gpu, &specialisation, &constants, &arrays, of_blocks);
    (sorted_keys, sorted_values)
}

/// Where each of the keys 0..count begins among keys in rising order, and where the last ends: [count + 1].
pub fn starts(gpu: Gpu, sorted_keys: &GpuArray, count: usize) -> GpuArray {
    let starts = GpuArray::new(gpu, count + 1);
    let constants = StartsBlock { len: sorted_keys.len() as u32 };
    let arrays = [Binding::Read(sorted_keys), Binding::Write(&starts)];
    STARTS.launch(gpu, &[], &constants, &arrays, starts.len().div_ceil(ADD_GROUP));
    starts
}
