//! Weights of tokens and cells: masks and shares on the step's device, without readback. They are detached from their
//! inputs, so that no gradient flows through a weight.

use shaders::arrays::rows::{RowIndex, divide_rows, norm, repeat_row, reshape, row_sum, scale_rows, segment_mean};
use shaders::arrays::totals::total;
use shaders::pointwise::{mul, sub};
use shaders::tape::{Real, Tape, Var};

/// Lower bound of a divisor that is a sum of weights: less than any nonzero weight, so that an empty sum gives 0.
const NO_WEIGHT: f64 = 1e-30;

shaders::pointwise! {
    /// y = 1 where x ≥ limit, otherwise 0 (also for NaN).
    fn at_least(x) with(limit) -> y {
        return select(0.0, 1.0, x >= limit);
    }
    gradients(dy) {
        x: { return 0.0; }
    }

    /// y = weight where both lengths are at least `limit`, otherwise 0.
    fn where_long(weight, length_a, length_b) with(limit) -> y {
        return select(0.0, select(0.0, weight, length_b >= limit), length_a >= limit);
    }
    gradients(dy) {
        weight: { return select(0.0, select(0.0, dy, length_b >= limit), length_a >= limit); }
        length_a: { return 0.0; }
        length_b: { return 0.0; }
    }

    /// y = weight·min(weight / uniform, 1), given the reciprocal of the uniform weight.
    fn at_most_uniform(weight, reciprocal) -> y {
        return weight * min(weight * reciprocal, 1.0);
    }
    gradients(dy) {
        weight: { return select(dy, 2.0 * weight * reciprocal * dy, weight * reciprocal < 1.0); }
        reciprocal: { return select(0.0, weight * weight * dy, weight * reciprocal < 1.0); }
    }
}

/// Mask of opacities of at least `min_alpha`: 1, otherwise 0.
pub(crate) fn covered<T: Real>(tape: &mut Tape<T>, alpha: Var, min_alpha: f64) -> Var {
    let alpha = tape.detach(alpha);
    at_least(tape, alpha, min_alpha)
}

/// [tokens, 1]: attention received by every token, the mean over the rows of the attention map [tokens, tokens].
pub(crate) fn focus<T: Real>(tape: &mut Tape<T>, probabilities: Var) -> Var {
    let tokens = tape.value(probabilities).rows();
    let probabilities = tape.detach(probabilities);
    let received = segment_mean(tape, probabilities, &RowIndex::new(vec![0; tokens], 1));
    reshape(tape, received, [tokens, 1])
}

/// [tokens, 1]: weights of the masked tokens, normalised to a sum of 1; 0 elsewhere, and all 0 if no masked token has
/// attention.
pub(crate) fn normalized<T: Real>(tape: &mut Tape<T>, focus: Var, mask: Var) -> Var {
    let masked = mul(tape, focus, mask);
    let sums = total_per_row(tape, masked);
    divide_rows(tape, masked, sums, NO_WEIGHT)
}

/// Weights for terms that also penalise true motion: full from the uniform weight on, quadratic below it.
pub(crate) fn still<T: Real>(tape: &mut Tape<T>, weights: Var) -> Var {
    let valid = at_least(tape, weights, NO_WEIGHT);
    let count = total_per_row(tape, valid);
    at_most_uniform(tape, weights, count)
}

/// The weights, set to 0 for rows where a or b is shorter than `min_norm`.
pub(crate) fn directed<T: Real>(tape: &mut Tape<T>, weights: Var, ab: [Var; 2], min_norm: f64) -> Var {
    let [a, b] = ab.map(|x| {
        let x = tape.detach(x);
        norm(tape, x)
    });
    where_long(tape, weights, a, b, min_norm)
}

/// The sum of x [rows, 1], repeated for every row.
fn total_per_row<T: Real>(tape: &mut Tape<T>, x: Var) -> Var {
    let rows = tape.value(x).rows();
    let total = total(tape, x);
    repeat_row(tape, total, rows)
}

/// Mask [tokens, cells] of the cells that count, and their number per token.
#[derive(Clone, Copy)]
pub(crate) struct CellMask {
    ones: Var,
    counts: Var,
}

impl CellMask {
    /// Intersection of two masks.
    pub(crate) fn new<T: Real>(tape: &mut Tape<T>, a: Var, b: Var) -> Self {
        let ones = mul(tape, a, b);
        Self { ones, counts: row_sum(tape, ones) }
    }

    /// [tokens, 1]: 1 for tokens with any counted cell, otherwise 0.
    pub(crate) fn any<T: Real>(self, tape: &mut Tape<T>) -> Var {
        at_least(tape, self.counts, 1.0)
    }

    /// Weights [tokens, 1] divided by the number of counted cells, for sums over cells that become means.
    pub(crate) fn per_cell<T: Real>(self, tape: &mut Tape<T>, weights: Var) -> Var {
        divide_rows(tape, weights, self.counts, 1.0)
    }

    /// x [tokens, cells] where the mask is 1, otherwise 0.
    pub(crate) fn masked<T: Real>(self, tape: &mut Tape<T>, x: Var) -> Var {
        mul(tape, x, self.ones)
    }

    /// Masked rows minus the mean over each row's counted cells.
    pub(crate) fn centered<T: Real>(self, tape: &mut Tape<T>, masked: Var) -> Var {
        let sums = row_sum(tape, masked);
        let means = divide_rows(tape, sums, self.counts, 1.0);
        let mean_of_cells = scale_rows(tape, self.ones, means);
        sub(tape, masked, mean_of_cells)
    }
}

#[cfg(test)]
mod tests {
    use shaders::check::{TOLERANCE, gradients, noise};
    use shaders::tape::{Device, Tensor};

    use super::*;

    #[test]
    fn weights_have_the_gradients_of_central_differences() {
        let positive = |seed| Tensor::from_vec([40, 1], noise(40, seed).iter().map(|x| 1.0 + x).collect());
        let inputs = [1, 2, 3].map(positive);
        gradients(|tape, vars| at_most_uniform(tape, vars[0], vars[1]), &inputs[..2], TOLERANCE).unwrap();
        gradients(|tape, vars| where_long(tape, vars[0], vars[1], vars[2], 0.7), &inputs, TOLERANCE).unwrap();
        gradients(|tape, vars| at_least(tape, vars[0], 0.7), &inputs[..1], TOLERANCE).unwrap();
    }

    /// Evaluates `f` on column vectors.
    fn of_columns<const I: usize>(columns: [&[f64]; I], f: impl Fn(&mut Tape<f64>, [Var; I]) -> Var) -> Vec<f64> {
        let mut tape = Tape::new(Device::Cpu);
        let vars = columns.map(|column| tape.constant(Tensor::from_vec([column.len(), 1], column.to_vec())));
        let result = f(&mut tape, vars);
        tape.value(result).as_slice().to_vec()
    }

    #[test]
    fn weights_sum_to_one_or_to_zero_under_an_empty_mask() {
        let of =
            |mask: &[f64]| of_columns([&[1.0, 2.0, 5.0], mask], |tape, [focus, mask]| normalized(tape, focus, mask));
        let near = |found: Vec<f64>, expected: [f64; 3]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(near(of(&[1.0, 0.0, 1.0]), [1.0 / 6.0, 0.0, 5.0 / 6.0]));
        assert_eq!(of(&[0.0, 0.0, 0.0]), [0.0, 0.0, 0.0]);
    }

    #[test]
    fn weights_below_uniform_are_squared() {
        // The uniform weight of three masked tokens is a third.
        let found = of_columns([&[0.1, 0.0, 0.3, 0.6]], |tape, [weights]| still(tape, weights));
        let expected = [0.1 * 0.3, 0.0, 0.3 * 0.9, 0.6];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
    }

    #[test]
    fn rows_below_the_minimum_norm_have_no_weight() {
        let columns: [&[f64]; 3] = [&[0.5, 0.5, 0.5], &[1.0, 1e-3, -1.0], &[-2.0, 1.0, f64::NAN]];
        assert_eq!(of_columns(columns, |tape, [weights, a, b]| directed(tape, weights, [a, b], 0.1)), [0.5, 0.0, 0.0]);
    }

    #[test]
    fn cell_means_cover_only_masked_cells() {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let mut constant = |values: &[f64]| tape.constant(Tensor::from_vec([2, 3], values.to_vec()));
        let (a, b) = (constant(&[1.0, 1.0, 0.0, 1.0, 0.0, 0.0]), constant(&[1.0, 1.0, 1.0, 0.0, 1.0, 1.0]));
        let x = constant(&[1.0, 3.0, 9.0, 4.0, 5.0, 6.0]);
        let mask = CellMask::new(&mut tape, a, b);
        let masked = mask.masked(&mut tape, x);
        let centered = mask.centered(&mut tape, masked);
        let any = mask.any(&mut tape);
        assert_eq!(tape.value(any).as_slice(), [1.0, 0.0]);
        assert_eq!(tape.value(centered).as_slice(), [-1.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
