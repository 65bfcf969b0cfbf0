//! Multi-head attention in which every query keeps its k best keys.
//!
//! Per head: scores A = Q·Kᵀ/√d; every row keeps the k largest scores of valid keys (ties: the earlier key),
//! P = softmax over the kept scores and 0 elsewhere, output P·V. k is clamped to the number of valid keys; without valid
//! keys the output and the probabilities are 0. The backward pass treats the selection as constant.

mod gpu;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use super::softmax::{softmax, softmax_backward};
use crate::gpu::Gpu;
use crate::networks::linear::matrix::Matrix;
use crate::networks::linear::multiply;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};
use gpu::Kept;

/// Queries whose products with all keys are computed at once: few enough for the second-level cache with a thousand keys.
const QUERIES_PER_BLOCK: usize = 64;

/// Outputs of [`top_k_attention`].
#[derive(Clone, Copy, Debug)]
pub struct TopKAttention {
    /// [queries, heads·d]: P·V of every head, side by side.
    pub mixed: Var,
    /// [queries, keys]: P, averaged over the heads. Rows sum to 1 (to 0 without valid keys).
    pub probabilities: Var,
}

/// Attention of query [queries, heads·d] to key and value [keys, heads·d]; `valid` marks the keys that exist.
pub fn top_k_attention<T: Real>(
    tape: &mut Tape<T>,
    [query, key, value]: [Var; 3],
    valid: &[bool],
    heads: usize,
    k: usize,
) -> TopKAttention {
    let shape = |var| [tape.value(var).rows(), tape.value(var).row_len()];
    let [queries, width] = shape(query);
    assert!(width.is_multiple_of(heads), "top_k_attention: {heads} heads do not divide {width} columns");
    assert_eq!(shape(key), [valid.len(), width], "top_k_attention: keys do not fit the queries or the mask");
    assert_eq!(shape(value), shape(key), "top_k_attention: keys and values differ in shape");
    let valid: Vec<u32> = (0..valid.len() as u32).filter(|&key| valid[key as usize]).collect();
    let layout = Layout { queries, keys: tape.value(key).rows(), heads, depth: width / heads };
    let kept = k.min(valid.len());
    let op = TopK { layout, kept, valid, chosen: Vec::new(), probabilities: Vec::new(), on_gpu: None };
    let outputs = tape.apply(op, &[query, key, value]);
    TopKAttention { mixed: outputs[0], probabilities: outputs[1] }
}

#[derive(Copy, Clone)]
struct Layout {
    queries: usize,
    keys: usize,
    heads: usize,
    /// Columns per head.
    depth: usize,
}

impl Layout {
    fn width(&self) -> usize {
        self.heads * self.depth
    }

    /// The range of the columns of a head in row `row`.
    fn columns(&self, row: usize, head: usize) -> std::ops::Range<usize> {
        let start = row * self.width() + head * self.depth;
        start..start + self.depth
    }

    /// 1/√d.
    fn score_scale<T: Real>(&self) -> T {
        T::from_f64(1.0 / (self.depth as f64).sqrt())
    }
}

struct TopK<T> {
    layout: Layout,
    /// Keys that every query keeps.
    kept: usize,
    valid: Vec<u32>,
    /// [queries, heads, kept], ascending within a row.
    chosen: Vec<u32>,
    /// [queries, heads, kept].
    probabilities: Vec<T>,
    /// The keys and their probabilities on a GPU, if GPU kernels selected them.
    on_gpu: Option<Kept>,
}

/// One query of one head: its kept keys and their probabilities.
struct Row<'a, T> {
    chosen: &'a [u32],
    probabilities: &'a [T],
}

/// Buffers of one selection: the rank of every key, and the same with the best at the front.
#[derive(Default)]
struct Ranks {
    of_keys: Vec<u64>,
    sorted: Vec<u64>,
}

impl<T: Real> TopK<T> {
    fn row(&self, query: usize, head: usize) -> Row<'_, T> {
        let range = (query * self.layout.heads + head) * self.kept..(query * self.layout.heads + head + 1) * self.kept;
        Row { chosen: &self.chosen[range.clone()], probabilities: &self.probabilities[range] }
    }

    /// Writes the kept keys of a query and a head, in ascending order, and their probabilities, given the products with
    /// all valid keys.
    fn choose(&self, products: &[T], ranks: &mut Ranks, chosen: &mut [u32], probabilities: &mut [T]) {
        // Selecting among integers has no branches, and is several times as fast as with a comparison of pairs.
        let Ranks { of_keys, sorted } = ranks;
        of_keys.clear();
        of_keys.extend(products.iter().map(|&product| rank(product)));
        sorted.clone_from(of_keys);
        let last = *sorted.select_nth_unstable(self.kept - 1).1;
        let mut ties = self.kept - sorted[..self.kept].iter().filter(|&&rank| rank < last).count();
        let is_kept = |&at: &usize| {
            if of_keys[at] != last {
                return of_keys[at] < last;
            }
            let is_kept = ties > 0;
            ties -= usize::from(is_kept);
            is_kept
        };
        let scale = self.layout.score_scale::<T>();
        let kept = chosen.iter_mut().zip(&mut *probabilities).zip((0..products.len()).filter(is_kept));
        for ((chosen, probability), at) in kept {
            (*chosen, *probability) = (self.valid[at], scale * products[at]);
        }
        softmax(probabilities);
    }

    /// [d, valid keys] of one head.
    fn keys_by_column(&self, key: &[T], head: usize) -> Vec<T> {
        let column =
            |at: usize| self.valid.iter().map(move |&row| key[self.layout.columns(row as usize, head).start + at]);
        (0..self.layout.depth).flat_map(column).collect()
    }

    fn choose_all(&mut self, query: &[T], key: &[T]) {
        let layout = self.layout;
        let keys_by_column: Vec<Vec<T>> = (0..layout.heads).map(|head| self.keys_by_column(key, head)).collect();
        let per_query = layout.heads * self.kept;
        let (mut chosen, mut probabilities) =
            (vec![0; layout.queries * per_query], vec![T::ZERO; layout.queries * per_query]);
        let per_block = QUERIES_PER_BLOCK * per_query;
        let blocks = chosen.par_chunks_mut(per_block).zip(probabilities.par_chunks_mut(per_block)).enumerate();
        let buffers = || (Vec::new(), Ranks::default());
        blocks.for_each_init(buffers, |(products, ranks), (block, (chosen, probabilities))| {
            let first = block * QUERIES_PER_BLOCK;
            let rows = first..first + chosen.len() / per_query;
            for (head, keys) in keys_by_column.iter().enumerate() {
                let queries: Vec<T> = rows.clone().flat_map(|row| &query[layout.columns(row, head)]).copied().collect();
                products.resize(rows.len() * self.valid.len(), T::ZERO);
                let (queries, keys) = (Matrix::new(&queries, layout.depth), Matrix::new(keys, self.valid.len()));
                multiply(queries, keys, products);
                for (row, products) in products.chunks_exact(self.valid.len()).enumerate() {
                    let kept = row * per_query + head * self.kept..row * per_query + (head + 1) * self.kept;
                    self.choose(products, ranks, &mut chosen[kept.clone()], &mut probabilities[kept]);
                }
            }
        });
        (self.chosen, self.probabilities) = (chosen, probabilities);
    }

    /// Gradients of the columns of one head: of its queries [queries, d], keys and values [keys, d].
    fn backward_head(&self, head: usize, inputs: &[&[T]; 3], dmixed: Option<&[T]>, dmean: Option<&[T]>) -> [Vec<T>; 3] {
        let layout = self.layout;
        let (depth, scale) = (layout.depth, layout.score_scale::<T>());
        let head_share = T::from_f64(1.0 / layout.heads as f64);
        let [query, key, value] = inputs;
        let mut gradients = [layout.queries, layout.keys, layout.keys].map(|rows| vec![T::ZERO; rows * depth]);
        let [dquery, dkey, dvalue] = &mut gradients;
        let mut dscores = vec![T::ZERO; self.kept];
        for row in 0..layout.queries {
            let Row { chosen, probabilities } = self.row(row, head);
            dscores.fill(T::ZERO);
            for (&at, (dscore, &p)) in chosen.iter().zip(dscores.iter_mut().zip(probabilities)) {
                let at = at as usize;
                if let Some(dmixed) = dmixed {
                    let dmixed = &dmixed[layout.columns(row, head)];
                    *dscore += dot(dmixed, &value[layout.columns(at, head)]);
                    add_scaled(&mut dvalue[at * depth..][..depth], dmixed, p);
                }
                if let Some(dmean) = dmean {
                    *dscore += head_share * dmean[row * layout.keys + at];
                }
            }
            softmax_backward(probabilities, &mut dscores);
            for (&at, &dscore) in chosen.iter().zip(&dscores) {
                let at = at as usize;
                add_scaled(&mut dquery[row * depth..][..depth], &key[layout.columns(at, head)], scale * dscore);
                add_scaled(&mut dkey[at * depth..][..depth], &query[layout.columns(row, head)], scale * dscore);
            }
        }
        gradients
    }
}

impl<T: Real> Op<T> for TopK<T> {
    fn name(&self) -> &'static str {
        "top_k_attention"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let layout = self.layout;
        let mut mixed = vec![T::ZERO; layout.queries * layout.width()];
        let mut mean = vec![T::ZERO; layout.queries * layout.keys];
        let head_share = T::from_f64(1.0 / layout.heads as f64);
        if self.kept > 0 {
            self.choose_all(inputs[0].as_slice(), inputs[1].as_slice());
            let value = inputs[2].as_slice();
            let rows = mixed.par_chunks_mut(layout.width()).zip(mean.par_chunks_mut(layout.keys)).enumerate();
            rows.for_each(|(query, (mixed, mean))| {
                for (head, mixed) in mixed.chunks_exact_mut(layout.depth).enumerate() {
                    let Row { chosen, probabilities } = self.row(query, head);
                    for (&key, &p) in chosen.iter().zip(probabilities) {
                        add_scaled(mixed, &value[layout.columns(key as usize, head)], p);
                        mean[key as usize] += head_share * p;
                    }
                }
            });
        }
        vec![
            Tensor::from_vec([layout.queries, layout.width()], mixed),
            Tensor::from_vec([layout.queries, layout.keys], mean),
        ]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, needs, .. } = pass;
        if self.kept == 0 {
            return vec![None; 3];
        }
        let layout = self.layout;
        let slices = [0, 1, 2].map(|input| inputs[input].as_slice());
        let [dmixed, dmean] = [0, 1].map(|output| output_grads[output].map(Tensor::as_slice));
        let heads: Vec<[Vec<T>; 3]> =
            (0..layout.heads).into_par_iter().map(|head| self.backward_head(head, &slices, dmixed, dmean)).collect();
        let side_by_side = |input: usize| {
            let mut gradient = vec![T::ZERO; inputs[input].len()];
            for (head, parts) in heads.iter().enumerate() {
                for (row, part) in parts[input].chunks_exact(layout.depth).enumerate() {
                    gradient[layout.columns(row, head)].copy_from_slice(part);
                }
            }
            Tensor::from_vec(inputs[input].shape(), gradient)
        };
        (0..3).map(|input| needs[input].then(|| side_by_side(input))).collect()
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for TopK<T> {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        self.forward_on_gpu(gpu, inputs)
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let Backward { inputs, output_grads, .. } = pass;
        self.backward_on_gpu(gpu, inputs, output_grads)
    }
}

/// The order of descending values as integers, the reverse of [`f64::total_cmp`].
fn rank<T: Real>(value: T) -> u64 {
    let bits = value.to_f64().to_bits();
    // The bits of negative numbers are in descending order already.
    if bits >> 63 == 1 { bits } else { !bits & !(1 << 63) }
}

fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    a.iter().zip(b).map(|(&a, &b)| a * b).sum()
}

/// total += factor·term
fn add_scaled<T: Real>(total: &mut [T], term: &[T], factor: T) {
    total.iter_mut().zip(term).for_each(|(total, &term)| *total += factor * term);
}
