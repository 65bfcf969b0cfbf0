use super::*;
use crate::check::{TOLERANCE, gradients, noise};
use crate::tape::{Device, Tensor};

fn tensor(shape: [usize; 3], seed: u64) -> Tensor<f64> {
    Tensor::from_vec(shape, noise(shape.iter().product(), seed))
}

/// Queries, keys and values of three rows, two queries, a window of five and six channels.
fn inputs() -> [Tensor<f64>; 3] {
    [tensor([3, 2, 6], 1), tensor([3, 5, 6], 2), tensor([3, 5, 6], 3)]
}

fn value(inputs: &[Tensor<f64>; 3], heads: usize) -> Tensor<f64> {
    let mut tape = Tape::new(Device::Cpu);
    let vars = inputs.each_ref().map(|input| tape.constant(input.clone()));
    let y = window_attention(&mut tape, vars[0], vars[1], vars[2], heads);
    tape.value(y).clone()
}

#[test]
fn gradients_equal_central_differences() {
    for heads in [1, 2, 3] {
        let y = |tape: &mut Tape<f64>, vars: &[Var]| window_attention(tape, vars[0], vars[1], vars[2], heads);
        gradients(y, &inputs(), TOLERANCE).unwrap();
    }
}

#[test]
fn a_gradient_without_the_keys_is_rejected() {
    let faulty = |tape: &mut Tape<f64>, vars: &[Var]| {
        let keys = tape.detach(vars[1]);
        window_attention(tape, vars[0], keys, vars[2], 2)
    };
    assert!(gradients(faulty, &inputs(), TOLERANCE).is_err());
}

#[test]
fn equal_keys_give_the_mean_of_the_values() {
    let [queries, _, values] = inputs();
    let y = value(&[queries, Tensor::full([3, 5, 6], 0.3), values.clone()], 2);
    for (row, channel) in (0..3).flat_map(|row| (0..6).map(move |channel| (row, channel))) {
        let mean = (0..5).map(|token| values.row(row)[6 * token + channel]).sum::<f64>() / 5.0;
        assert!((y.row(row)[channel] - mean).abs() <= 1e-15);
    }
}

#[test]
fn a_key_that_fits_much_better_gives_its_value_without_overflow() {
    let [queries, mut keys, values] = inputs();
    keys.make_mut().iter_mut().for_each(|key| *key *= 1e30);
    let y = value(&[queries.clone(), keys.clone(), values.clone()], 1);
    let score = |token: usize| dot(&queries.row(0)[..6], &keys.row(0)[6 * token..6 * token + 6]);
    let best = (0..5).max_by(|&a, &b| score(a).total_cmp(&score(b))).unwrap();
    assert_eq!(y.row(0)[..6], values.row(0)[6 * best..6 * best + 6]);
}

#[test]
fn heads_do_not_look_at_each_other() {
    let [mut queries, keys, values] = inputs();
    let before = value(&[queries.clone(), keys.clone(), values.clone()], 2);
    // Channels 3 to 5 are the second head.
    queries.make_mut().chunks_exact_mut(6).for_each(|token| token[4] += 1.0);
    let after = value(&[queries, keys, values], 2);
    let halves = |y: &Tensor<f64>, first: usize| -> Vec<f64> {
        y.as_slice().chunks_exact(6).flat_map(|token| token[first..first + 3].to_vec()).collect()
    };
    assert!(halves(&before, 0) == halves(&after, 0) && halves(&before, 3) != halves(&after, 3));
}
