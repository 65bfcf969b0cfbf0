use super::*;
use crate::check::{Mismatch, TOLERANCE, gradients, noise};
use crate::tape::{Device, Tensor};

fn tensor(columns: usize, seed: u64) -> Tensor<f64> {
    Tensor::from_vec([9, columns], noise(9 * columns, seed))
}

/// The value of `f` at these rows.
fn value(f: impl Fn(&mut Tape<f64>, &[Var]) -> Var, inputs: &[&[f64]]) -> Vec<f64> {
    let mut tape = Tape::new(Device::Cpu);
    let vars: Vec<Var> =
        inputs.iter().map(|row| tape.constant(Tensor::from_vec([1, row.len()], row.to_vec()))).collect();
    let y = f(&mut tape, &vars);
    tape.value(y).as_slice().to_vec()
}

fn interpolate(tape: &mut Tape<f64>, vars: &[Var]) -> Var {
    slerp(tape, vars[0], vars[1], vars[2])
}

fn close(found: &[f64], expected: &[f64], tolerance: f64) {
    let worst = found.iter().zip(expected).map(|(found, expected)| (found - expected).abs()).fold(0.0, f64::max);
    assert!(found.len() == expected.len() && worst <= tolerance, "{found:?} instead of {expected:?}");
}

#[test]
fn gradients_equal_central_differences() {
    let (p, q, v) = (tensor(4, 1), tensor(4, 2), tensor(3, 3));
    gradients(|tape, vars| normalize(tape, vars[0]), std::slice::from_ref(&p), TOLERANCE).unwrap();
    gradients(|tape, vars| multiply(tape, vars[0], vars[1]), &[p, q.clone()], TOLERANCE).unwrap();
    gradients(|tape, vars| rotate(tape, vars[0], vars[1]), &[q, v], TOLERANCE).unwrap();
}

/// b at the angle of `closeness` from a: 0 is anywhere, 1 is a itself.
fn check_slerp(closeness: f64) -> Result<(), Mismatch> {
    let (a, far) = (tensor(4, 1), tensor(4, 2));
    let mixed =
        a.as_slice().iter().zip(far.as_slice()).map(|(a, far)| closeness * a + (1.0 - closeness) * far).collect();
    let shares = noise(9, 3).iter().map(|share| 0.5 + 0.5 * share).collect();
    gradients(interpolate, &[a, Tensor::from_vec([9, 4], mixed), Tensor::from_vec([9, 1], shares)], TOLERANCE)
}

#[test]
fn slerp_has_the_gradient_of_central_differences_on_arc_and_chord() {
    for closeness in [0.0, 0.5, 0.9, 0.999, 1.0] {
        check_slerp(closeness).unwrap_or_else(|mismatch| panic!("closeness {closeness}: {mismatch}"));
    }
}

#[test]
fn a_missing_share_of_the_gradient_is_rejected() {
    let detached = |tape: &mut Tape<f64>, vars: &[Var]| {
        let held = tape.detach(vars[1]);
        slerp(tape, vars[0], held, vars[2])
    };
    let inputs = [tensor(4, 1), tensor(4, 2), Tensor::from_vec([9, 1], vec![0.3; 9])];
    assert!(gradients(detached, &inputs, TOLERANCE).is_err());
}

#[test]
fn aligned_quaternions_are_on_the_side_of_the_reference() {
    let (q, reference) = (tensor(4, 1), tensor(4, 2));
    gradients(|tape, vars| align(tape, vars[0], vars[1]), &[q.clone(), reference.clone()], TOLERANCE).unwrap();
    let mut tape = Tape::new(Device::Cpu);
    let vars = [q.clone(), reference.clone()].map(|input| tape.constant(input));
    let aligned = align(&mut tape, vars[0], vars[1]);
    let mut turned = 0;
    for row in 0..9 {
        let (aligned, q, reference) = (tape.value(aligned).row(row), q.row(row), reference.row(row));
        assert!(aligned.iter().zip(reference).map(|(a, b)| a * b).sum::<f64>() >= 0.0);
        turned += usize::from(aligned.iter().zip(q).all(|(aligned, q)| *aligned == -q));
        assert!(aligned.iter().zip(q).all(|(aligned, q)| aligned.abs() == q.abs()));
    }
    assert!((1..9).contains(&turned), "{turned} of 9 turned");
}

#[test]
fn products_are_rotations_one_after_the_other() {
    let (p, q, v) = ([0.3, -0.4, 0.5, 0.7], [0.8, 0.1, -0.6, 0.2], [0.2, -1.0, 0.4]);
    let turned = value(|tape, vars| rotate(tape, vars[0], vars[1]), &[&q, &v]);
    let twice = value(|tape, vars| rotate(tape, vars[0], vars[1]), &[&p, &turned]);
    let product = value(|tape, vars| multiply(tape, vars[0], vars[1]), &[&p, &q]);
    close(&value(|tape, vars| rotate(tape, vars[0], vars[1]), &[&product, &v]), &twice, 1e-15);
    // A quarter turn about z.
    let half = 0.5_f64.sqrt();
    let quarter = value(|tape, vars| rotate(tape, vars[0], vars[1]), &[&[half, 0.0, 0.0, half], &[1.0, 0.0, 0.0]]);
    close(&quarter, &[0.0, 1.0, 0.0], 1e-15);
}

#[test]
fn slerp_moves_evenly_along_the_shorter_arc() {
    let about_x = |angle: f64| [(0.5 * angle).cos(), (0.5 * angle).sin(), 0.0, 0.0];
    for end in [1e-4, 0.05, 2.5] {
        let halfway = value(interpolate, &[&about_x(0.2), &about_x(0.2 + end), &[0.25]]);
        close(&halfway, &about_x(0.2 + 0.25 * end), 1e-6);
        let opposite = about_x(0.2 + end).map(|value| -3.0 * value);
        close(&value(interpolate, &[&about_x(0.2), &opposite, &[0.25]]), &halfway, 1e-14);
    }
}

#[test]
fn arc_and_chord_meet() {
    let at = |cosine: f64| {
        value(interpolate, &[&[1.0, 0.0, 0.0, 0.0], &[cosine, (1.0 - cosine * cosine).sqrt(), 0.0, 0.0], &[0.3]])
    };
    close(&at(slerp::CHORD_ABOVE - 1e-9), &at(slerp::CHORD_ABOVE + 1e-9), 2e-6);
}

#[test]
fn quaternions_without_direction_are_the_identity_and_have_no_gradient() {
    let at_zero = |operation: fn(&mut Tape<f64>, [Var; 4]) -> Var, expected: &[f64]| {
        let mut tape = Tape::new(Device::Cpu);
        let inputs = [vec![0.0; 4], vec![0.0; 4], vec![1.0, 2.0, 3.0], vec![0.5]];
        let vars = inputs.map(|row| tape.leaf(Tensor::from_vec([1, row.len()], row)));
        let y = operation(&mut tape, vars);
        assert_eq!(tape.value(y).as_slice(), expected);
        let seed = Tensor::full([1, expected.len()], 1.0);
        let gradients = tape.backward(&[(y, seed)]);
        assert!(gradients.get(vars[0]).unwrap().as_slice().iter().all(|&value| value == 0.0));
    };
    at_zero(|tape, [q, ..]| normalize(tape, q), &[1.0, 0.0, 0.0, 0.0]);
    at_zero(|tape, [q, _, v, _]| rotate(tape, q, v), &[1.0, 2.0, 3.0]);
    at_zero(|tape, [q, p, _, t]| slerp(tape, q, p, t), &[1.0, 0.0, 0.0, 0.0]);
}
