use super::*;
use crate::tape::{Backward, Op};

/// y = x², with a gradient that is wrong by a factor `1 + fault` in one element.
struct Square {
    fault: f64,
}

impl Op<f64> for Square {
    fn name(&self) -> &'static str {
        "square"
    }

    fn forward(&mut self, inputs: &[&Tensor<f64>]) -> Vec<Tensor<f64>> {
        let squares = inputs[0].as_slice().iter().map(|x| x * x).collect();
        vec![Tensor::from_vec(inputs[0].shape(), squares)]
    }

    fn backward(&mut self, pass: Backward<f64>) -> Vec<Option<Tensor<f64>>> {
        let (inputs, dy) = (pass.inputs, pass.dy().as_slice());
        let mut dx: Vec<f64> = inputs[0].as_slice().iter().zip(dy).map(|(x, dy)| 2.0 * x * dy).collect();
        dx[2] *= 1.0 + self.fault;
        vec![Some(Tensor::from_vec(inputs[0].shape(), dx))]
    }
}

fn check_square(fault: f64) -> Result<(), Mismatch> {
    let inputs = [Tensor::from_vec([4], vec![0.3, 0.1, -2.0, 0.7]), Tensor::from_vec([4], vec![0.5, -0.2, 1.1, 0.9])];
    gradients(|tape, vars| tape.apply_one(Square { fault }, &vars[1..]), &inputs, TOLERANCE)
}

#[test]
fn accepts_a_right_gradient() {
    check_square(0.0).unwrap();
}

#[test]
fn rejects_planted_faults_and_names_the_element() {
    for fault in [1e-4, -1.0, f64::NAN, f64::INFINITY] {
        let mismatch = check_square(fault).unwrap_err();
        assert_eq!((mismatch.what.as_str(), mismatch.element), ("input 1", 2), "fault {fault}");
    }
}

#[test]
fn rejects_a_missing_gradient() {
    let detached = |tape: &mut Tape<f64>, vars: &[Var]| {
        let square = tape.apply_one(Square { fault: 0.0 }, vars);
        if tape.needs_gradient(square) { tape.detach(square) } else { square }
    };
    assert!(gradients(detached, &[Tensor::from_vec([3], vec![1.0, 2.0, 3.0])], TOLERANCE).is_err());
}

#[test]
fn agreement_rejects_differences_and_nan() {
    let expected = Tensor::from_vec([3], vec![1.0f64, -4.0, 0.0]);
    let with = |value: f32| Tensor::from_vec([3], vec![1.0f32, -4.0, value]);
    agree(&with(3e-6), &expected, 1e-6).unwrap();
    assert_eq!(agree(&with(5e-6), &expected, 1e-6).unwrap_err().element, 2);
    assert!(agree(&with(f32::NAN), &expected, 1e9).is_err());
    assert!(agree(&with(0.0), &Tensor::from_vec([3], vec![1.0, -4.0, f64::NAN]), 1e9).is_err());
}

#[test]
fn noise_is_centred_and_differs_by_seed() {
    let noise_of = |seed| noise(10_000, seed);
    let mean = noise_of(3).iter().sum::<f64>() / 1e4;
    let variance = noise_of(3).iter().map(|x| x * x).sum::<f64>() / 1e4;
    assert!(mean.abs() < 0.02 && (variance - 1.0 / 3.0).abs() < 0.01, "mean {mean}, variance {variance}");
    assert!(noise_of(3) != noise_of(4) && noise_of(3) == noise_of(3));
}
