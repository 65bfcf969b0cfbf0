//! Rows picked by an index list, and rows summed by the same list: each is the other's backward pass.

mod gpu;

use std::sync::{Arc, OnceLock};

use rayon::prelude::*;

use super::with_rows;
use crate::gpu::{Gpu, GpuArray};
use crate::tape::chunks::chunked;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};
use gpu::GpuIndex;

/// Elements per parallel chunk of a gather.
const GATHER_CHUNK: usize = 16_384;

/// For each of M items the one of N rows that it belongs to, and for each row its items in ascending order.
///
/// Building one sorts the list: reuse it while the list does not change. Clones share the list. A list made on a GPU stays
/// there until the host reads it.
#[derive(Clone, Debug)]
pub struct RowIndex {
    lists: Arc<Lists>,
}

/// The lists on the host, on a GPU, or on both; at least one is present.
#[derive(Debug)]
struct Lists {
    rows: usize,
    on_host: OnceLock<HostLists>,
    on_gpu: OnceLock<GpuIndex>,
}

#[derive(Debug)]
struct HostLists {
    /// [M].
    row_of_item: Vec<u32>,
    /// [M], sorted by row, then by item.
    items: Vec<u32>,
    /// [N + 1]: the items of row n are `items[starts[n]..starts[n + 1]]`.
    starts: Vec<u32>,
}

impl HostLists {
    fn new(row_of_item: Vec<u32>, rows: usize) -> Self {
        assert!(row_of_item.iter().all(|&row| (row as usize) < rows), "an index beyond the {rows} rows");
        // A counting sort: stable, linear in M + N.
        let mut starts = vec![0; rows + 1];
        row_of_item.iter().for_each(|&row| starts[row as usize + 1] += 1);
        (0..rows).for_each(|row| starts[row + 1] += starts[row]);
        let mut next = starts.clone();
        let mut items = vec![0; row_of_item.len()];
        for (item, &row) in row_of_item.iter().enumerate() {
            items[next[row as usize] as usize] = item as u32;
            next[row as usize] += 1;
        }
        Self { row_of_item, items, starts }
    }
}

impl RowIndex {
    /// Items that belong to `row_of_item[m]` of `rows` rows.
    pub fn new(row_of_item: Vec<u32>, rows: usize) -> Self {
        let on_host = HostLists::new(row_of_item, rows).into();
        Self { lists: Arc::new(Lists { rows, on_host, on_gpu: OnceLock::new() }) }
    }

    /// An index from a list of rows on a GPU.
    pub(crate) fn of_gpu(row_of_item: GpuArray, rows: usize) -> Self {
        let on_gpu = GpuIndex::unsorted(row_of_item, rows).into();
        Self { lists: Arc::new(Lists { rows, on_host: OnceLock::new(), on_gpu }) }
    }

    /// N.
    pub fn rows(&self) -> usize {
        self.lists.rows
    }

    /// M.
    pub fn len(&self) -> usize {
        let on_gpu = || self.lists.on_gpu.get().expect("the lists are somewhere").row_of_item.len();
        self.lists.on_host.get().map_or_else(on_gpu, |lists| lists.items.len())
    }

    /// Whether there are no items.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The row of every item.
    pub fn row_of_item(&self) -> &[u32] {
        &self.on_host().row_of_item
    }

    /// The items of a row, ascending.
    pub fn items_of(&self, row: usize) -> &[u32] {
        let HostLists { items, starts, .. } = self.on_host();
        &items[starts[row] as usize..starts[row + 1] as usize]
    }

    /// The lists in the host's memory, read back first if a GPU made them.
    fn on_host(&self) -> &HostLists {
        self.lists.on_host.get_or_init(|| {
            let row_of_item = &self.lists.on_gpu.get().expect("the lists are somewhere").row_of_item;
            let mut rows = vec![0; row_of_item.len()];
            row_of_item.read_into(&mut rows);
            HostLists::new(rows, self.rows())
        })
    }

    /// The lists in the GPU's memory, uploaded once.
    pub(crate) fn on_gpu(&self, gpu: Gpu) -> &GpuIndex {
        self.lists.on_gpu.get_or_init(|| {
            let HostLists { row_of_item, items, starts } = self.on_host();
            GpuIndex::new(gpu, row_of_item, items, starts)
        })
    }

    /// y[m] = x[row of m] for x [N, …].
    fn gather<T: Real>(&self, x: &Tensor<T>) -> Tensor<T> {
        let (columns, row_of_item) = (x.row_len(), self.row_of_item());
        let chunk_len = GATHER_CHUNK.div_ceil(columns.max(1)) * columns.max(1);
        let y = chunked(self.len() * columns, chunk_len, |first, y| {
            for (item, y) in y.chunks_exact_mut(columns).enumerate() {
                y.copy_from_slice(x.row(row_of_item[first / columns + item] as usize));
            }
        });
        Tensor::from_vec(with_rows(x.shape(), self.len()), y)
    }

    /// y[n] = factor(number of items of n) · Σ x[m] over the items m of n, in ascending order, for x [M, …].
    fn sum<T: Real>(&self, x: &Tensor<T>, factor: impl Fn(usize) -> T + Sync) -> Tensor<T> {
        let columns = x.row_len();
        let mut y = vec![T::ZERO; self.rows() * columns];
        y.par_chunks_mut(columns.max(1)).enumerate().with_min_len(256).for_each(|(row, y)| {
            let items = self.items_of(row);
            for &item in items {
                y.iter_mut().zip(x.row(item as usize)).for_each(|(y, &x)| *y += x);
            }
            let factor = factor(items.len());
            y.iter_mut().for_each(|y| *y *= factor);
        });
        Tensor::from_vec(with_rows(x.shape(), self.rows()), y)
    }
}

/// Row `row_of_item[m]` of x [N, …] for every item: [M, …].
pub fn gather<T: Real>(tape: &mut Tape<T>, x: Var, index: &RowIndex) -> Var {
    assert_eq!(tape.value(x).rows(), index.rows(), "gather: number of rows");
    tape.apply_one(Gather { index: index.clone() }, &[x])
}

/// The sum of the items of every row: x [M, …] → [N, …]; zero where a row has no items.
pub fn segment_sum<T: Real>(tape: &mut Tape<T>, x: Var, index: &RowIndex) -> Var {
    assert_eq!(tape.value(x).rows(), index.len(), "segment_sum: number of items");
    tape.apply_one(SegmentSum { index: index.clone(), mean: false }, &[x])
}

/// The mean of the items of every row: x [M, …] → [N, …]; zero where a row has no items.
pub fn segment_mean<T: Real>(tape: &mut Tape<T>, x: Var, index: &RowIndex) -> Var {
    assert_eq!(tape.value(x).rows(), index.len(), "segment_mean: number of items");
    tape.apply_one(SegmentSum { index: index.clone(), mean: true }, &[x])
}

struct Gather {
    index: RowIndex,
}

impl<T: Real> Op<T> for Gather {
    fn name(&self) -> &'static str {
        "gather"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        vec![self.index.gather(inputs[0])]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(self.index.sum(pass.dy(), |_| T::ONE))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for Gather {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.index.gather_on_gpu(gpu, inputs[0], false)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(self.index.sum_on_gpu(gpu, pass.dy(), false))]
    }
}

struct SegmentSum {
    index: RowIndex,
    mean: bool,
}

impl SegmentSum {
    fn factor<T: Real>(&self, items: usize) -> T {
        if self.mean { T::ONE / T::from_f64(items.max(1) as f64) } else { T::ONE }
    }
}

impl<T: Real> Op<T> for SegmentSum {
    fn name(&self) -> &'static str {
        if self.mean { "segment_mean" } else { "segment_sum" }
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        vec![self.index.sum(inputs[0], |items| self.factor(items))]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let dy = pass.dy();
        let mut scaled = dy.clone();
        if self.mean {
            let columns = dy.row_len().max(1);
            for (row, dy) in scaled.make_mut().chunks_exact_mut(columns).enumerate() {
                let factor = self.factor::<T>(self.index.items_of(row).len());
                dy.iter_mut().for_each(|dy| *dy *= factor);
            }
        }
        vec![Some(self.index.gather(&scaled))]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for SegmentSum {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.index.sum_on_gpu(gpu, inputs[0], self.mean)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(self.index.gather_on_gpu(gpu, pass.dy(), self.mean))]
    }
}
