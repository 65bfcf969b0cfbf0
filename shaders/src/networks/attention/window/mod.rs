//! Multi-head attention in which every row attends to its own short window (Vaswani et al. 2017, section 3.2).

mod gpu;
#[cfg(test)]
mod tests;

use super::softmax::{softmax, softmax_backward};
use crate::arrays::rows::{RowMap, map_rows, reshape};
use crate::gpu::Gpu;
use crate::tape::{Real, Tape, Tensor, Var};

/// softmax(q·kᵀ / √d)·v per row and head, the heads side by side: q [N, Q, H·d], k and v [N, W, H·d] → [N, Q, H·d].
///
/// Projections of queries, keys, values and of the result are the caller's linear layers.
pub fn window_attention<T: Real>(tape: &mut Tape<T>, queries: Var, keys: Var, values: Var, heads: usize) -> Var {
    let [of_queries, of_keys, of_values] = [queries, keys, values].map(|var| tape.value(var).shape().to_vec());
    assert_eq!(of_keys, of_values, "window_attention: keys and values differ in shape");
    assert_eq!(
        (of_queries[0], of_queries[2]),
        (of_keys[0], of_keys[2]),
        "window_attention: queries and keys do not fit"
    );
    assert!(of_queries[2].is_multiple_of(heads), "window_attention: {} channels over {heads} heads", of_queries[2]);
    assert!(of_keys[1] > 0, "window_attention: an empty window");
    let kernel = WindowAttention { channels: of_queries[2], heads };
    let rows = map_rows(tape, kernel, [queries, keys, values]);
    reshape(tape, rows, of_queries)
}

struct WindowAttention {
    /// Number of channels of all heads together.
    channels: usize,
    heads: usize,
}

impl WindowAttention {
    /// The channels of one head of one token of a row.
    fn part(&self, token: usize, head: usize) -> std::ops::Range<usize> {
        let width = self.channels / self.heads;
        let first = token * self.channels + head * width;
        first..first + width
    }

    /// 1 / √d.
    fn factor<T: Real>(&self) -> T {
        T::from_f64(1.0 / ((self.channels / self.heads) as f64).sqrt())
    }

    /// The attention probabilities of a query over the tokens of the window.
    fn probabilities<T: Real>(&self, query: &[T], keys: &[T], head: usize) -> Vec<T> {
        let tokens = keys.len() / self.channels;
        let score = |token: usize| self.factor::<T>() * dot(query, &keys[self.part(token, head)]);
        let mut scores: Vec<T> = (0..tokens).map(score).collect();
        softmax(&mut scores);
        scores
    }

    /// Every (query token, head).
    fn pairs(&self, queries: usize) -> impl Iterator<Item = (usize, usize)> {
        let (tokens, heads) = (queries / self.channels, self.heads);
        (0..tokens).flat_map(move |token| (0..heads).map(move |head| (token, head)))
    }
}

fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    a.iter().zip(b).map(|(&a, &b)| a * b).sum()
}

/// out += factor·x
fn add<T: Real>(out: &mut [T], factor: T, x: &[T]) {
    out.iter_mut().zip(x).for_each(|(out, &x)| *out += factor * x);
}

impl RowMap<3> for WindowAttention {
    const NAME: &'static str = "window_attention";

    fn output_columns(&self, [queries, ..]: [usize; 3]) -> usize {
        queries
    }

    fn value<T: Real>(&self, [queries, keys, values]: [&[T]; 3], y: &mut [T]) {
        for (token, head) in self.pairs(queries.len()) {
            let part = self.part(token, head);
            let probabilities = self.probabilities(&queries[part.clone()], keys, head);
            for (at, &probability) in probabilities.iter().enumerate() {
                add(&mut y[part.clone()], probability, &values[self.part(at, head)]);
            }
        }
    }

    fn gradient<T: Real>(
        &self,
        [queries, keys, values]: [&[T]; 3],
        _y: &[T],
        dy: &[T],
        [dqueries, dkeys, dvalues]: [&mut [T]; 3],
    ) {
        for (token, head) in self.pairs(queries.len()) {
            let part = self.part(token, head);
            let (query, dy) = (&queries[part.clone()], &dy[part.clone()]);
            let probabilities = self.probabilities(query, keys, head);
            let mut dscores: Vec<T> =
                (0..probabilities.len()).map(|at| dot(dy, &values[self.part(at, head)])).collect();
            softmax_backward(&probabilities, &mut dscores);
            for (at, (&probability, &dscore)) in probabilities.iter().zip(&dscores).enumerate() {
                let key = self.part(at, head);
                let dscore = self.factor::<T>() * dscore;
                add(&mut dqueries[part.clone()], dscore, &keys[key.clone()]);
                add(&mut dkeys[key.clone()], dscore, query);
                add(&mut dvalues[key], probability, dy);
            }
        }
    }

    fn value_gpu<T: Real>(&self, gpu: Gpu, inputs: [&Tensor<T>; 3]) -> Option<Tensor<T>> {
        Some(self.value_on_gpu(gpu, inputs))
    }

    fn gradient_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: [&Tensor<T>; 3],
        _y: &Tensor<T>,
        dy: &Tensor<T>,
    ) -> [Tensor<T>; 3] {
        self.gradient_on_gpu(gpu, inputs, dy)
    }
}
