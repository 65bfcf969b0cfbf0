//! Rows picked and rows summed on a GPU.

use std::sync::OnceLock;

use super::RowIndex;
use crate::arrays::rows::with_rows;
use crate::arrays::sort;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Real, Tensor};

const GATHER: Kernel = Kernel { name: "gather", text: include_str!("gather.wgsl") };
const SEGMENT_SUM: Kernel = Kernel { name: "segment_sum", text: include_str!("segment_sum.wgsl") };

/// The most terms that one invocation adds: a longer row is split, and the sums of its parts are added.
const LONGEST: u32 = 64;

uniforms! {
    struct ItemsBlock as "Items" {
        columns: u32,
    }
}

uniforms! {
    struct SegmentsBlock as "Segments" {
        columns: u32,
    }
}

/// The lists of a [`RowIndex`] in a GPU's memory.
#[derive(Debug)]
pub(crate) struct GpuIndex {
    /// N.
    rows: usize,
    /// [M].
    pub row_of_item: GpuArray,
    /// Built on first use.
    sorted: OnceLock<Sorted>,
}

/// The items by row.
#[derive(Debug)]
pub(crate) struct Sorted {
    /// [M], sorted by row, then by item.
    pub items: GpuArray,
    /// [N + 1]: the items of row n are `items[starts[n]..starts[n + 1]]`.
    pub starts: GpuArray,
    /// The segment starts of every pass of a sum: first segments of items, then of partial sums. Empty if one pass over
    /// `starts` suffices: no row has many items, or the host does not know their number.
    passes: Vec<GpuArray>,
}

impl GpuIndex {
    pub(crate) fn new(gpu: Gpu, row_of_item: &[u32], items: &[u32], starts: &[u32]) -> Self {
        let [row_of_item, items] = [row_of_item, items].map(|list| GpuArray::upload(gpu, list));
        let mut passes = Vec::new();
        let mut of_rows = starts.to_vec();
        while of_rows.windows(2).any(|row| row[1] - row[0] > LONGEST) {
            let (cuts, rows) = cut(&of_rows);
            passes.push(GpuArray::upload(gpu, &cuts));
            of_rows = rows;
        }
        if !passes.is_empty() {
            passes.push(GpuArray::upload(gpu, &of_rows));
        }
        let sorted = Sorted { items, starts: GpuArray::upload(gpu, starts), passes };
        Self { rows: starts.len() - 1, row_of_item, sorted: sorted.into() }
    }

    /// Items that are not sorted by row yet.
    pub(crate) fn unsorted(row_of_item: GpuArray, rows: usize) -> Self {
        Self { rows, row_of_item, sorted: OnceLock::new() }
    }

    pub(crate) fn sorted(&self) -> &Sorted {
        self.sorted.get_or_init(|| {
            let gpu = self.row_of_item.gpu();
            let bits = self.rows.max(1).ilog2() + 1;
            let (rows, items) = sort::sort(gpu, &self.row_of_item, bits);
            Sorted { items, starts: sort::starts(gpu, &rows, self.rows), passes: Vec::new() }
        })
    }
}

impl Sorted {
    fn passes(&self) -> &[GpuArray] {
        if self.passes.is_empty() { std::slice::from_ref(&self.starts) } else { &self.passes }
    }
}

/// Where segments of at most [`LONGEST`] terms begin, and the first of these segments for every row.
fn cut(starts: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let (mut cuts, mut rows) = (Vec::new(), Vec::with_capacity(starts.len()));
    for row in starts.windows(2) {
        rows.push(cuts.len() as u32);
        cuts.extend((row[0]..row[1]).step_by(LONGEST as usize));
    }
    rows.push(cuts.len() as u32);
    cuts.push(starts[starts.len() - 1]);
    (cuts, rows)
}

impl RowIndex {
    /// y[m] = x[row of m] for x [N, …]; if `mean`, divided by the number of items of that row.
    pub(crate) fn gather_on_gpu<T: Real>(&self, gpu: Gpu, x: &Tensor<T>, mean: bool) -> Tensor<T> {
        let (columns, lists) = (x.row_len(), self.on_gpu(gpu));
        let y = GpuArray::new(gpu, self.len() * columns);
        // Only means use the number of items per row.
        let starts = if mean { &lists.sorted().starts } else { &lists.row_of_item };
        let read = [x.on_gpu(gpu), &lists.row_of_item, starts].map(Binding::Read);
        let arrays = [&read[..], &[Binding::Write(&y)]].concat();
        let constants = ItemsBlock { columns: columns as u32 };
        GATHER.launch(gpu, &[("MEAN", u32::from(mean))], &constants, &arrays, Groups::Over(y.len()));
        Tensor::from_gpu(with_rows(x.shape(), self.len()), y)
    }

    /// y[n] = Σ x[m] over the items m of n for x [M, …]; if `mean`, divided by their number.
    pub(crate) fn sum_on_gpu<T: Real>(&self, gpu: Gpu, x: &Tensor<T>, mean: bool) -> Tensor<T> {
        let (columns, lists) = (x.row_len(), self.on_gpu(gpu).sorted());
        let passes = lists.passes();
        let mut sums: Option<GpuArray> = None;
        for (pass, starts) in passes.iter().enumerate() {
            let y = GpuArray::new(gpu, (starts.len() - 1) * columns);
            let source = sums.as_ref().unwrap_or_else(|| x.on_gpu(gpu));
            let read = [source, &lists.items, starts, &lists.starts].map(Binding::Read);
            let arrays = [&read[..], &[Binding::Write(&y)]].concat();
            let is_last = pass + 1 == passes.len();
            let specialisation = [("INDIRECT", u32::from(pass == 0)), ("MEAN", u32::from(mean && is_last))];
            let constants = SegmentsBlock { columns: columns as u32 };
            SEGMENT_SUM.launch(gpu, &specialisation, &constants, &arrays, Groups::Over(y.len()));
            sums = Some(y);
        }
        Tensor::from_gpu(with_rows(x.shape(), self.rows()), sums.expect("at least one pass"))
    }
}

#[cfg(test)]
#[test]
fn the_kernels_are_valid() {
    use crate::gpu::layout_tests::assert_valid;
    for mean in [0, 1] {
        assert_valid::<ItemsBlock>(&GATHER, &[("MEAN", mean)]);
        assert_valid::<SegmentsBlock>(&SEGMENT_SUM, &[("INDIRECT", mean), ("MEAN", mean)]);
    }
}

#[cfg(test)]
#[test]
fn long_rows_are_cut_and_others_are_not() {
    assert_eq!(cut(&[0, 0, 64, 65, 194]), (vec![0, 64, 65, 129, 193, 194], vec![0, 0, 1, 2, 5]));
}
