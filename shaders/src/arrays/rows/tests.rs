use std::slice::from_ref;

use super::*;
use crate::check::{Mismatch, TOLERANCE, gradients, noise};
use crate::tape::{Device, Real, Tape, Tensor, Var};

fn tensor(rows: usize, columns: usize, seed: u64) -> Tensor<f64> {
    Tensor::from_vec([rows, columns], noise(rows * columns, seed))
}

/// 7 items of 4 rows; row 2 has none.
fn index() -> RowIndex {
    RowIndex::new(vec![3, 0, 1, 3, 0, 3, 1], 4)
}

fn check(f: impl Fn(&mut Tape<f64>, &[Var]) -> Var, inputs: &[Tensor<f64>]) -> Result<(), Mismatch> {
    gradients(f, inputs, TOLERANCE)
}

fn value(f: impl Fn(&mut Tape<f64>, &[Var]) -> Var, inputs: &[Tensor<f64>]) -> Tensor<f64> {
    let mut tape = Tape::new(Device::Cpu);
    let vars: Vec<Var> = inputs.iter().map(|input| tape.constant(input.clone())).collect();
    let y = f(&mut tape, &vars);
    tape.value(y).clone()
}

#[test]
fn gradients_of_arrangements_equal_central_differences() {
    let (a, b) = (tensor(5, 2, 1), tensor(5, 3, 2));
    check(concat_columns, &[a.clone(), b.clone()]).unwrap();
    check(|tape, vars| concat_leading_columns(tape, &[(vars[0], 1), (vars[1], 2)]), &[a.clone(), b.clone()]).unwrap();
    check(concat_rows, &[b.clone(), tensor(2, 3, 3)]).unwrap();
    check(|tape, vars| columns(tape, vars[0], 1..3), from_ref(&b)).unwrap();
    check(|tape, vars| repeat_row(tape, vars[0], 5), &[tensor(1, 3, 4)]).unwrap();
    check(|tape, vars| reshape(tape, vars[0], [2, 5]), &[a]).unwrap();
}

#[test]
fn gradients_of_indexed_rows_equal_central_differences() {
    check(|tape, vars| gather(tape, vars[0], &index()), &[tensor(4, 3, 1)]).unwrap();
    check(|tape, vars| segment_sum(tape, vars[0], &index()), &[tensor(7, 3, 1)]).unwrap();
    check(|tape, vars| segment_mean(tape, vars[0], &index()), &[tensor(7, 3, 1)]).unwrap();
}

#[test]
fn gradients_of_reductions_equal_central_differences() {
    let (a, b) = (tensor(6, 3, 1), tensor(6, 3, 2));
    check(|tape, vars| row_sum(tape, vars[0]), from_ref(&a)).unwrap();
    check(|tape, vars| row_dot(tape, vars[0], vars[1]), &[a.clone(), b.clone()]).unwrap();
    check(|tape, vars| squared_norm(tape, vars[0]), from_ref(&a)).unwrap();
    check(|tape, vars| norm(tape, vars[0]), from_ref(&a)).unwrap();
    // All rows above ε, and all below.
    check(|tape, vars| normalize(tape, vars[0], 1e-6), from_ref(&a)).unwrap();
    check(|tape, vars| normalize(tape, vars[0], 10.0), from_ref(&a)).unwrap();
    check(|tape, vars| scale_rows(tape, vars[0], vars[1]), &[a.clone(), tensor(6, 1, 3)]).unwrap();
    check(|tape, vars| cosine_distance(tape, vars[0], vars[1], 1e-6), &[a.clone(), b.clone()]).unwrap();
    // Divisors in [1, 3), above the floor and below it.
    let divisors = Tensor::from_vec([6, 1], noise(6, 5).iter().map(|divisor| divisor + 2.0).collect());
    check(|tape, vars| divide_rows(tape, vars[0], vars[1], 0.5), &[a.clone(), divisors.clone()]).unwrap();
    check(|tape, vars| divide_rows(tape, vars[0], vars[1], 5.0), &[a.clone(), divisors]).unwrap();
    let weights = Tensor::from_vec([6], noise(6, 4).iter().map(|weight| weight + 1.1).collect());
    let loss = |tape: &mut Tape<f64>, vars: &[Var]| weighted_mean_squared_difference(tape, vars[0], vars[1], vars[2]);
    check(loss, &[a, b, weights]).unwrap();
}

#[test]
fn cosine_distances_of_parallel_opposite_and_zero_rows() {
    let a = Tensor::from_vec([4, 2], vec![1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
    let b = Tensor::from_vec([4, 2], vec![2.0, 4.0, -0.5, 0.0, 0.0, 7.0, 1.0, 1.0]);
    let found = value(|tape, vars| cosine_distance(tape, vars[0], vars[1], 1e-6), &[a, b]);
    for (found, expected) in found.as_slice().iter().zip([0.0, 2.0, 1.0, 1.0]) {
        assert!((found - expected).abs() <= 1e-15, "{found} instead of {expected}");
    }
}

/// Sums rows, with a gradient that is wrong in one place.
struct FaultySum;

impl RowMap<1> for FaultySum {
    const NAME: &'static str = "faulty_sum";

    fn output_columns(&self, _input_columns: [usize; 1]) -> usize {
        1
    }

    fn value<T: Real>(&self, [x]: [&[T]; 1], y: &mut [T]) {
        y[0] = x.iter().copied().sum();
    }

    fn gradient<T: Real>(&self, [x]: [&[T]; 1], _y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
        dx.fill(dy[0]);
        dx[x.len() - 1] *= T::from_f64(1.001);
    }
}

#[test]
fn planted_faults_are_rejected() {
    assert!(check(|tape, vars| map_rows(tape, FaultySum, [vars[0]]), &[tensor(3, 4, 1)]).is_err());
    let gathers_others = |tape: &mut Tape<f64>, vars: &[Var]| {
        // The forward and the backward pass use different lists, so the gradient goes to other rows.
        let differentiated = tape.needs_gradient(vars[0]);
        let index = if differentiated { RowIndex::new(vec![0, 0, 1, 3, 0, 3, 1], 4) } else { index() };
        gather(tape, vars[0], &index)
    };
    assert!(check(gathers_others, &[tensor(4, 3, 1)]).is_err());
}

#[test]
fn arrangements_put_elements_where_they_belong() {
    let (a, b) = (Tensor::from_vec([2, 1], vec![1.0, 2.0]), Tensor::from_vec([2, 2], vec![3.0, 4.0, 5.0, 6.0]));
    let joined = value(concat_columns, &[a.clone(), b.clone()]);
    assert_eq!((joined.shape(), joined.as_slice()), (&[2, 3][..], &[1.0, 3.0, 4.0, 2.0, 5.0, 6.0][..]));
    let leading = |tape: &mut Tape<f64>, vars: &[Var]| concat_leading_columns(tape, &[(vars[1], 1), (vars[0], 1)]);
    assert_eq!(value(leading, &[a.clone(), b.clone()]).as_slice(), [3.0, 1.0, 5.0, 2.0]);
    assert_eq!(value(|tape, vars| columns(tape, vars[0], 1..2), from_ref(&b)).as_slice(), [4.0, 6.0]);
    let below = value(concat_rows, &[b.clone(), b]);
    assert_eq!((below.shape(), below.row(2)), (&[4, 2][..], &[3.0, 4.0][..]));
    assert_eq!(value(|tape, vars| repeat_row(tape, vars[0], 3), &[Tensor::scalar(7.0)]).shape(), [3, 1]);
}

#[test]
fn items_are_summed_by_their_rows() {
    assert_eq!((index().items_of(0), index().items_of(2), index().items_of(3)), (&[1, 4][..], &[][..], &[0, 3, 5][..]));
    let items = Tensor::from_vec([7, 1], (1..=7).map(f64::from).collect());
    let sums = value(|tape, vars| segment_sum(tape, vars[0], &index()), from_ref(&items));
    let means = value(|tape, vars| segment_mean(tape, vars[0], &index()), &[items]);
    assert_eq!((sums.as_slice(), means.as_slice()), (&[7.0, 10.0, 0.0, 11.0][..], &[3.5, 5.0, 0.0, 11.0 / 3.0][..]));
    let picked = value(|tape, vars| gather(tape, vars[0], &index()), &[sums]);
    assert_eq!(picked.as_slice(), [11.0, 7.0, 10.0, 11.0, 7.0, 11.0, 10.0]);
}

#[test]
fn zero_rows_and_zero_weights_have_finite_gradients() {
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let zeros = tape.leaf(Tensor::zeros([2, 3]));
    let ones = tape.constant(Tensor::full([2, 3], 1.0));
    let weights = tape.leaf(Tensor::zeros([2]));
    let outputs = [
        norm(&mut tape, zeros),
        normalize(&mut tape, zeros, 1e-6),
        weighted_mean_squared_difference(&mut tape, zeros, ones, weights),
    ];
    for y in outputs {
        let seed = Tensor::full(tape.value(y).shape(), 1.0);
        assert!(tape.value(y).as_slice().iter().all(|&y| y == 0.0));
        assert!(tape.backward(&[(y, seed)]).get(zeros).unwrap().is_finite());
    }
}

#[test]
fn a_nan_stays_a_nan() {
    let bad = Tensor::from_vec([1, 2], vec![f64::NAN, 1.0]);
    for f in [row_sum, norm, |tape: &mut Tape<f64>, x| normalize(tape, x, 1e-6)] {
        assert!(value(|tape, vars| f(tape, vars[0]), from_ref(&bad)).as_slice()[0].is_nan());
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let rows = 5000;
    let index = RowIndex::new((0..rows as u32).map(|item| item * item % 97).collect(), 97);
    let run = || {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let x = tape.leaf(tensor(rows, 3, 1).cast());
        let row = tape.leaf(tensor(1, 3, 2).cast());
        let repeated = repeat_row(&mut tape, row, rows);
        let dots = row_dot(&mut tape, x, repeated);
        let scaled = scale_rows(&mut tape, x, dots);
        let sums = segment_sum(&mut tape, scaled, &index);
        let back = gather(&mut tape, sums, &index);
        let mut gradients = tape.backward(&[(back, tensor(rows, 3, 3).cast())]);
        (tape.value(back).clone(), gradients.take(x), gradients.take(row))
    };
    let run_with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run);
    assert!([2, 3, 8].iter().all(|&threads| run_with(threads) == run_with(1)));
}

#[test]
#[should_panic(expected = "beyond the 4 rows")]
fn an_index_beyond_the_rows_is_refused() {
    RowIndex::new(vec![4], 4);
}
