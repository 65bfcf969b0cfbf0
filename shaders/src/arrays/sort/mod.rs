//! Stable radix sort and prefix sums of whole numbers on a GPU: reduce, then scan, then scatter, which needs no progress
//! guarantee between workgroups (Merrill and Grimshaw 2011).

#[cfg(test)]
mod tests;

use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, Length, WORKGROUP_SIZE, uniforms};

const SCAN: Kernel = Kernel { name: "scan", text: include_str!("scan_input.wgsl") };
const SCAN_ADD: Kernel = Kernel { name: "scan, offsets", text: include_str!("scan_add.wgsl") };
const COUNT: Kernel = Kernel { name: "sort, counts", text: include_str!("sort_count.wgsl") };
const ROWS: Kernel = Kernel { name: "sort, rows", text: include_str!("sort_rows.wgsl") };
const SCATTER: Kernel = Kernel { name: "sort, scatter", text: include_str!("sort_scatter.wgsl") };
const STARTS: Kernel = Kernel { name: "sort, starts", text: include_str!("sort_starts.wgsl") };

/// Elements per workgroup of every kernel but the offsets and starts.
const BLOCK: usize = Length::BLOCK;
/// Bits per pass, and the digits that they make.
const DIGIT_BITS: u32 = 8;
const DIGITS: usize = 1 << DIGIT_BITS;

/// Sums stop here: they stay monotonic where they would overflow.
pub(crate) const SUM_CAP: u32 = 1 << 29;

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
        next_shift: u32,
    }
}

uniforms! {
    struct StartsBlock as "Starts" {
        len: u32,
    }
}

/// The sum of all elements before each; at most [`SUM_CAP`].
pub(crate) fn exclusive_sums(gpu: Gpu, input: &GpuArray) -> GpuArray {
    sums_of(gpu, &SCAN, &[Binding::Read(input)], input.len())
}

/// The exclusive prefix sums of `len` numbers, by a kernel that imports `scan.wgsl` and computes the numbers from arrays.
pub(crate) fn sums_of(gpu: Gpu, kernel: &Kernel, arrays: &[Binding], len: usize) -> GpuArray {
    let (sums, blocks) = (GpuArray::new(gpu, len), len.div_ceil(BLOCK));
    let block_sums = GpuArray::new(gpu, blocks);
    let constants = ScanBlock { len: len as u32 };
    let arrays = [&[&sums, &block_sums].map(Binding::Write), arrays].concat();
    kernel.launch(gpu, &[], &constants, &arrays, blocks);
    if blocks > 1 {
        let before = exclusive_sums(gpu, &block_sums);
        let arrays = [Binding::Read(&before), Binding::Write(&sums)];
        SCAN_ADD.launch(gpu, &[], &constants, &arrays, Groups::Over(len));
    }
    sums
}

/// The keys in rising order and, for each, where it was; equal keys keep their order. Only the lowest `bits` count.
pub(crate) fn sort(gpu: Gpu, keys: &GpuArray, bits: u32) -> (GpuArray, GpuArray) {
    sort_first(gpu, keys, None, bits)
}

/// Stable sort of the first `length` keys of the array; the rest of the results is undefined.
pub(crate) fn sort_first(gpu: Gpu, keys: &GpuArray, length: Option<&Length>, bits: u32) -> (GpuArray, GpuArray) {
    let run = Run { gpu, blocks: keys.len().div_ceil(BLOCK), length };
    let mut counts = run.first_counts(keys);
    let mut sorted: Option<(GpuArray, GpuArray)> = None;
    for shift in (0..bits.max(1)).step_by(DIGIT_BITS as usize) {
        let next = if shift + DIGIT_BITS < bits { DIGITS * run.blocks } else { 0 };
        let next_counts = GpuArray::new(gpu, next);
        let (keys, values) = sorted.as_ref().map_or((keys, None), |(keys, values)| (keys, Some(values)));
        sorted = Some(run.pass((keys, values), [&counts, &next_counts], shift));
        counts = next_counts;
    }
    sorted.expect("one pass at least")
}

/// The passes of one sort over its blocks of keys.
struct Run<'a> {
    gpu: Gpu,
    blocks: usize,
    length: Option<&'a Length>,
}

impl<'a> Run<'a> {
    fn constants(&self, keys: &GpuArray, shift: u32) -> SortBlock {
        SortBlock { len: keys.len() as u32, blocks: self.blocks as u32, shift, next_shift: shift + DIGIT_BITS }
    }

    fn counted(&self) -> (&'static str, u32) {
        ("COUNTED", u32::from(self.length.is_some()))
    }

    fn groups(&self) -> Groups<'a> {
        self.length.map_or(Groups::Count(self.blocks), Length::blocks)
    }

    /// The array with the number of keys, or a placeholder.
    fn length<'b>(&self, otherwise: &'b GpuArray) -> Binding<'b>
    where
        'a: 'b,
    {
        Binding::Read(self.length.map_or(otherwise, Length::array))
    }

    /// Keys of each digit in each block, [digit, block], before the first pass.
    fn first_counts(&self, keys: &GpuArray) -> GpuArray {
        let counts = GpuArray::new(self.gpu, DIGITS * self.blocks);
        let arrays = [self.length(keys), Binding::Read(keys), Binding::Write(&counts)];
        COUNT.launch(self.gpu, &[self.counted()], &self.constants(keys, 0), &arrays, self.groups());
        counts
    }

    /// Sorts keys and their values by one digit, and counts the digits of the next pass.
    fn pass(
        &self,
        (keys, values): (&GpuArray, Option<&GpuArray>),
        [counts, next_counts]: [&GpuArray; 2],
        shift: u32,
    ) -> (GpuArray, GpuArray) {
        let (gpu, constants, totals) = (self.gpu, self.constants(keys, shift), GpuArray::new(self.gpu, DIGITS));
        let (length, last_pass) = (self.length(keys), next_counts.is_empty());
        let last = ("LAST", u32::from(last_pass));
        let lanes = self.blocks.next_power_of_two().min(WORKGROUP_SIZE);
        let groups = if self.blocks == 0 { 0 } else { DIGITS * lanes / WORKGROUP_SIZE };
        let arrays = [length, Binding::Write(counts), Binding::Write(&totals), Binding::Write(next_counts)];
        ROWS.launch(gpu, &[self.counted(), ("LANES", lanes as u32), last], &constants, &arrays, groups);
        let sorted = [(); 2].map(|()| GpuArray::new(gpu, keys.len()));
        let read = [keys, values.unwrap_or(keys), counts, &totals].map(Binding::Read);
        let written = [&sorted[0], &sorted[1], next_counts].map(Binding::Write);
        let arrays = [&[length], &read[..], &written].concat();
        let first = ("FIRST", u32::from(values.is_none()));
        SCATTER.launch(gpu, &[self.counted(), first, last], &constants, &arrays, self.groups());
        sorted.into()
    }
}

/// Where each of the keys 0..count begins among keys in rising order, and where the last ends: [count + 1].
pub(crate) fn starts(gpu: Gpu, sorted_keys: &GpuArray, count: usize) -> GpuArray {
    let starts = GpuArray::new(gpu, count + 1);
    let constants = StartsBlock { len: sorted_keys.len() as u32 };
    let arrays = [Binding::Read(sorted_keys), Binding::Write(&starts)];
    STARTS.launch(gpu, &[], &constants, &arrays, Groups::Over(starts.len()));
    starts
}

/// Panics unless a kernel of [`sums_of`] is valid.
#[cfg(test)]
pub(crate) fn assert_valid_scan(kernel: &Kernel) {
    crate::gpu::layout_tests::assert_valid::<ScanBlock>(kernel, &[]);
}
