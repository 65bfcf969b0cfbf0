use super::*;
use crate::check::{TOLERANCE, gradients, noise};
use crate::tape::Device;

fn inputs() -> [Tensor<f64>; 3] {
    let column = |seed| Tensor::from_vec([6], noise(6, seed));
    [Tensor::from_vec([5, 6], noise(30, 1)), column(2), column(3)]
}

#[test]
fn gradients_equal_central_differences() {
    gradients(|tape, vars| layer_norm(tape, vars[0], vars[1], vars[2]), &inputs(), TOLERANCE).unwrap();
}

#[test]
fn a_gradient_that_forgets_the_moments_is_rejected() {
    /// As if mean and deviation did not depend on x.
    struct Faulty;
    impl RowMap<1> for Faulty {
        const NAME: &'static str = "faulty";
        fn output_columns(&self, columns: [usize; 1]) -> usize {
            Standardize.output_columns(columns)
        }
        fn value<T: Real>(&self, inputs: [&[T]; 1], y: &mut [T]) {
            Standardize.value(inputs, y);
        }
        fn gradient<T: Real>(&self, [x]: [&[T]; 1], _y: &[T], dy: &[T], [dx]: [&mut [T]; 1]) {
            let (_, deviation) = Standardize::moments(x);
            dx.iter_mut().zip(dy).for_each(|(dx, &dy)| *dx = dy / deviation);
        }
    }
    assert!(gradients(|tape, vars| map_rows(tape, Faulty, [vars[0]]), &inputs()[..1], TOLERANCE).is_err());
}

#[test]
fn rows_have_mean_zero_and_variance_one_before_the_affine_map() {
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let x = tape.constant(Tensor::from_vec([1, 4], vec![101.0, 103.0, 105.0, 107.0]));
    let (ones, zeros) = (tape.constant(Tensor::full([4], 1.0)), tape.constant(Tensor::zeros([4])));
    let y = layer_norm(&mut tape, x, ones, zeros);
    let expected = [-3.0, -1.0, 1.0, 3.0].map(|value: f32| value / 5.0_f32.sqrt());
    assert!(tape.value(y).as_slice().iter().zip(expected).all(|(y, expected)| (y - expected).abs() <= 1e-5));
}

#[test]
fn a_row_of_equal_values_becomes_the_offset_with_finite_gradients() {
    let mut tape = Tape::<f32>::new(Device::Cpu);
    let x = tape.leaf(Tensor::full([1, 4], 7.0));
    let (scale, offset) = (tape.leaf(Tensor::full([4], 2.0)), tape.leaf(Tensor::full([4], 0.5)));
    let y = layer_norm(&mut tape, x, scale, offset);
    assert_eq!(tape.value(y).as_slice(), [0.5; 4]);
    let gradients = tape.backward(&[(y, Tensor::from_vec([1, 4], vec![1.0, -1.0, 2.0, 0.0]))]);
    assert!([x, scale, offset].iter().all(|&var| gradients.get(var).unwrap().is_finite()));
}
