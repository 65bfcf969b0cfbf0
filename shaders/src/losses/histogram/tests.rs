use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

const BINS: usize = 8;
const RANGE: [f64; 2] = [-1.0, 1.0];

fn shares<T: Real>(values: &[f64]) -> Vec<f64> {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let x = tape.constant(Tensor::from_vec([values.len()], values.iter().map(|&value| T::from_f64(value)).collect()));
    let shares = soft_histogram(&mut tape, x, BINS, RANGE);
    tape.value(shares).as_slice().iter().map(|share| share.to_f64()).collect()
}

fn divergence(values: &[f64]) -> f64 {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let shares = tape.constant(Tensor::from_vec([values.len()], values.to_vec()));
    let divergence = divergence_from_uniform(&mut tape, shares);
    tape.value(divergence).as_slice()[0]
}

#[test]
fn gradients_equal_central_differences() {
    let values = Tensor::from_vec([17, 3], noise(51, 1).iter().map(|value| 1.2 * value).collect());
    let histogram = |tape: &mut Tape<f64>, vars: &[Var]| soft_histogram(tape, vars[0], BINS, RANGE);
    gradients(histogram, std::slice::from_ref(&values), TOLERANCE).unwrap();
    let regulariser = |tape: &mut Tape<f64>, vars: &[Var]| {
        let shares = soft_histogram(tape, vars[0], BINS, RANGE);
        divergence_from_uniform(tape, shares)
    };
    gradients(regulariser, &[values], TOLERANCE).unwrap();
}

#[test]
fn a_planted_fault_is_rejected() {
    let values = Tensor::from_vec([20], noise(20, 2));
    let gradient_over = |range: [f64; 2]| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let x = tape.leaf(values.clone());
        let shares = soft_histogram(&mut tape, x, BINS, range);
        let divergence = divergence_from_uniform(&mut tape, shares);
        tape.backward(&[(divergence, Tensor::scalar(1.0))]).take(x).unwrap()
    };
    let (exact, faulty) = (gradient_over(RANGE), gradient_over([-1.0, 1.01]));
    agree(&exact, &gradient_over(RANGE), 1e-12).unwrap();
    assert!(agree(&faulty, &exact, 1e-4).is_err());
}

#[test]
fn a_value_at_a_centre_is_in_one_bin_and_between_two_it_is_shared() {
    // The centres of eight bins over [−1, 1] are −7/8, −5/8, …
    assert_eq!(shares::<f64>(&[-0.625]), [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(shares::<f64>(&[0.0]), [0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0, 0.0]);
    assert_eq!(shares::<f64>(&[-3.0, 5.0]), [0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]);
}

#[test]
fn shares_add_up_to_one_in_both_precisions() {
    let values: Vec<f64> = noise(30_000, 3).iter().map(|value| 1.3 * value).collect();
    for shares in [shares::<f32>(&values), shares::<f64>(&values)] {
        assert!((shares.iter().sum::<f64>() - 1.0).abs() <= 1e-6);
    }
    let (single, double) = (shares::<f32>(&values), shares::<f64>(&values));
    assert!(single.iter().zip(&double).all(|(single, double)| (single - double).abs() <= 1e-6));
}

#[test]
fn the_divergence_is_zero_where_uniform_and_finite_with_empty_bins() {
    assert!(divergence(&[0.25; 4]).abs() <= 1e-7);
    // All in one of four bins: ln 4.
    assert!((divergence(&[0.0, 1.0, 0.0, 0.0]) - 4.0_f64.ln()).abs() <= 1e-7);
    assert!(divergence(&[0.5, 0.5, 0.0, 0.0]) < divergence(&[0.9, 0.1, 0.0, 0.0]));
}

#[test]
fn descending_the_divergence_spreads_values() {
    let mut values: Vec<f64> = noise(64, 4).iter().map(|value| 0.3 + 0.2 * value).collect();
    let divergence_and_gradient = |values: &[f64]| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let x = tape.leaf(Tensor::from_vec([values.len()], values.to_vec()));
        let shares = soft_histogram(&mut tape, x, BINS, RANGE);
        let divergence = divergence_from_uniform(&mut tape, shares);
        let gradient = tape.backward(&[(divergence, Tensor::scalar(1.0))]).take(x).unwrap();
        (tape.value(divergence).as_slice()[0], gradient.into_vec())
    };
    let (before, _) = divergence_and_gradient(&values);
    for _ in 0..300 {
        let (_, gradient) = divergence_and_gradient(&values);
        values.iter_mut().zip(gradient).for_each(|(value, slope)| *value -= 0.05 * slope);
    }
    let (after, _) = divergence_and_gradient(&values);
    assert!(after < 0.5 * before, "{before} to {after}");
}

#[test]
fn values_that_are_no_numbers_show() {
    assert!(shares::<f32>(&[0.1, f64::NAN]).iter().any(|share| share.is_nan()));
}
