use super::*;
use crate::arrays::rows::validate_map;
use crate::check::conformance::{Tolerance, compare};
use crate::check::{TOLERANCE, gradients, noise};
use crate::gpu::tests::test_gpu;
use crate::tape::{Device, Tensor};

const ENCODINGS: [PositionalEncoding; 3] = [
    PositionalEncoding { bands: 3, with_input: true },
    PositionalEncoding { bands: 2, with_input: false },
    PositionalEncoding { bands: 0, with_input: true },
];

#[test]
fn gradients_equal_central_differences() {
    for encoding in ENCODINGS {
        let x = Tensor::from_vec([5, 3], noise(15, 1));
        gradients(|tape, vars| encoding.encode(tape, vars[0]), &[x], TOLERANCE).unwrap();
    }
}

#[test]
fn the_columns_are_x_then_sines_and_cosines_by_band() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let x = tape.constant(Tensor::from_vec([1, 2], vec![0.3, -0.7]));
    let y = PositionalEncoding { bands: 2, with_input: true }.encode(&mut tape, x);
    let (a, b): (f64, f64) = (0.3, -0.7);
    let (sines, doubled) = ([a.sin(), b.sin(), a.cos(), b.cos()], [0.6_f64, -1.4]);
    let expected = [&[a, b][..], &sines, &doubled.map(f64::sin), &doubled.map(f64::cos)].concat();
    let worst =
        tape.value(y).as_slice().iter().zip(&expected).map(|(y, expected)| (y - expected).abs()).fold(0.0, f64::max);
    assert!(tape.value(y).shape() == [1, 10] && worst <= 1e-15, "{worst}");
}

#[test]
fn a_wrong_frequency_is_rejected() {
    /// The encoding, with a gradient that lacks one band.
    #[derive(Clone, Copy)]
    struct Faulty(PositionalEncoding);
    impl RowMap<1> for Faulty {
        const NAME: &'static str = "faulty";
        fn output_columns(&self, columns: [usize; 1]) -> usize {
            self.0.output_columns(columns)
        }
        fn value<T: Real>(&self, inputs: [&[T]; 1], y: &mut [T]) {
            self.0.value(inputs, y);
        }
        fn gradient<T: Real>(&self, inputs: [&[T]; 1], y: &[T], dy: &[T], gradients: [&mut [T]; 1]) {
            PositionalEncoding { bands: self.0.bands - 1, ..self.0 }.gradient(inputs, y, dy, gradients);
        }
    }
    let x = Tensor::from_vec([5, 3], noise(15, 1));
    assert!(gradients(|tape, vars| map_rows(tape, Faulty(ENCODINGS[0]), [vars[0]]), &[x], TOLERANCE).is_err());
}

/// Sines of angles up to 2⁹; the factors of the gradient are up to 2⁹, too.
const WIDE_ANGLES: Tolerance = Tolerance { value: 1e-6, gradient: 2e-5 };

#[test]
fn a_gpu_encodes_and_differentiates() {
    let Some(gpu) = test_gpu() else { return };
    let wide = PositionalEncoding { bands: 10, with_input: true };
    for encoding in ENCODINGS.into_iter().chain([wide]) {
        validate_map(&encoding, [3]);
        for rows in [0, 1, 86, 1000] {
            let x = Tensor::from_vec([rows, 3], noise(3 * rows, 1)).cast();
            let what = format!("{encoding:?} of {rows} rows");
            compare(gpu, &what, &[x], WIDE_ANGLES, |tape, vars| vec![encoding.encode(tape, vars[0])]).unwrap();
        }
    }
}

#[test]
fn a_gpu_with_a_band_that_is_not_the_cpus_is_noticed() {
    let Some(gpu) = test_gpu() else { return };
    let x: Tensor<f32> = Tensor::from_vec([50, 3], noise(150, 1)).cast();
    let doubled = |tape: &mut Tape<f32>, vars: &[Var]| {
        let factor = if tape.device() == Device::Cpu { 1.0 } else { 1.001 };
        let x = crate::pointwise::scale(tape, vars[0], factor);
        vec![ENCODINGS[0].encode(tape, x)]
    };
    assert!(compare(gpu, "another frequency", &[x], WIDE_ANGLES, doubled).is_err());
}
