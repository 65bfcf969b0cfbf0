use super::*;
use crate::check::{self, TOLERANCE, noise};
use crate::tape::{Device, Tensor};

const ROWS: usize = 4;
const STORED: usize = 4;

fn inputs() -> [Tensor<f64>; 2] {
    [
        Tensor::from_vec([ROWS, 2 * STORED, 3], noise(ROWS * 2 * STORED * 3, 1)),
        Tensor::from_vec([ROWS, 1], noise(ROWS, 2)),
    ]
}

#[test]
fn gradients_are_central_differences() {
    for count in [1, STORED] {
        let f = |tape: &mut Tape<f64>, vars: &[Var]| temporal_harmonics(tape, vars[0], vars[1], 0.3, STORED, count);
        check::gradients(f, &inputs(), TOLERANCE).unwrap();
    }
}

#[test]
fn a_gradient_of_another_time_is_found() {
    // The value at one time with the gradients at another.
    let f = |tape: &mut Tape<f64>, vars: &[Var]| {
        let right = temporal_harmonics(tape, vars[0], vars[1], 0.3, STORED, STORED);
        let other = temporal_harmonics(tape, vars[0], vars[1], 0.3001, STORED, STORED);
        let (right, constant) = (tape.detach(right), tape.detach(other));
        let difference = crate::pointwise::sub(tape, right, constant);
        crate::pointwise::add(tape, other, difference)
    };
    assert!(check::gradients(f, &inputs(), TOLERANCE).is_err());
}

#[test]
fn waves_are_cosines_of_the_time_since_the_center() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let waves = tape.constant(Tensor::from_vec([1, 2, 3], vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0]));
    let times = tape.constant(Tensor::from_vec([1, 1], vec![0.2]));
    for time in [0.2, 0.45, 0.7, 0.9] {
        let sum = temporal_harmonics(&mut tape, waves, times, time, 1, 1);
        let expected = [(TAU * (time - 0.2)).cos(), (2.0 * TAU * (time - 0.2)).cos(), 0.0];
        check::agree(tape.value(sum), &Tensor::from_vec([1, 1, 3], expected.to_vec()), 1e-12).unwrap();
    }
}
