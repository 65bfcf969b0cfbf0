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
/// The most blocks whose counts every workgroup of a pass adds up itself, which saves a launch.
const FEW_BLOCKS: usize = 64;
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
        pass_index: u32,
        passes: u32,
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

/// The keys in ascending order and, for each, its index in `keys`; equal keys keep their order. Only the lowest `bits`
/// bits, rounded up to whole bytes, are compared.
pub(crate) fn sort(gpu: Gpu, keys: &GpuArray, bits: u32) -> (GpuArray, GpuArray) {
    sort_first(gpu, keys, None, bits)
}

/// Stable sort of the first `length` keys of the array; the rest of the results is undefined.
pub(crate) fn sort_first(gpu: Gpu, keys: &GpuArray, length: Option<&Length>, bits: u32) -> (GpuArray, GpuArray) {
    let passes = bits.max(1).div_ceil(DIGIT_BITS);
    let run = Run { gpu, blocks: keys.len().div_ceil(BLOCK), passes, length };
    let counts = run.count(keys);
    let mut sorted: Option<(GpuArray, GpuArray)> = None;
    for pass_index in 0..passes {
        let (keys, values) = sorted.as_ref().map_or((keys, None), |(keys, values)| (keys, Some(values)));
        sorted = Some(run.pass((keys, values), &counts, pass_index));
    }
    sorted.expect("one pass at least")
}

/// The passes of one sort over its blocks of keys.
struct Run<'a> {
    gpu: Gpu,
    blocks: usize,
    passes: u32,
    length: Option<&'a Length>,
}

impl<'a> Run<'a> {
    fn constants(&self, keys: &GpuArray, pass_index: u32) -> SortBlock {
        SortBlock { len: keys.len() as u32, blocks: self.blocks as u32, pass_index, passes: self.passes }
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

    /// Keys of each digit in each block, [pass, digit, block]: those of the first pass; zero for the other passes.
    fn count(&self, keys: &GpuArray) -> GpuArray {
        let counts = GpuArray::new(self.gpu, self.passes as usize * DIGITS * self.blocks);
        let arrays = [self.length(keys), Binding::Read(keys), Binding::Write(&counts)];
        COUNT.launch(self.gpu, &[self.counted()], &self.constants(keys, 0), &arrays, self.groups());
        counts
    }

    /// Sorts keys and their values by one digit, and counts the digits of the next pass.
    fn pass(
        &self,
        (keys, values): (&GpuArray, Option<&GpuArray>),
        counts: &GpuArray,
        pass_index: u32,
    ) -> (GpuArray, GpuArray) {
        let (gpu, constants, length) = (self.gpu, self.constants(keys, pass_index), self.length(keys));
        let totals = (self.blocks > FEW_BLOCKS).then(|| self.sum_counts(keys, counts, &constants));
        let sorted = [(); 2].map(|()| GpuArray::new(gpu, keys.len()));
        let read = [keys, values.unwrap_or(keys), totals.as_ref().unwrap_or(keys)].map(Binding::Read);
        let written = [&sorted[0], &sorted[1], counts].map(Binding::Write);
        let arrays = [&[length], &read[..], &written].concat();
        let specialisation = [
            self.counted(),
            ("FIRST", u32::from(pass_index == 0)),
            ("LAST", u32::from(pass_index + 1 == self.passes)),
            ("SUMMED", u32::from(totals.is_some())),
        ];
        SCATTER.launch(gpu, &specialisation, &constants, &arrays, self.groups());
        sorted.into()
    }

    /// Replaces the counts of a pass by sums over earlier blocks; returns the total of each digit.
    fn sum_counts(&self, keys: &GpuArray, counts: &GpuArray, constants: &SortBlock) -> GpuArray {
        let totals = GpuArray::new(self.gpu, DIGITS);
        let lanes = self.blocks.next_power_of_two().min(WORKGROUP_SIZE);
        let arrays = [self.length(keys), Binding::Write(counts), Binding::Write(&totals)];
        let specialisation = [self.counted(), ("LANES", lanes as u32)];
        ROWS.launch(self.gpu, &specialisation, constants, &arrays, DIGITS * lanes / WORKGROUP_SIZE);
        totals
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
