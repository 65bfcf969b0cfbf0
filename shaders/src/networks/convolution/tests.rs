use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

fn tensor(shape: &[usize], seed: u64) -> Tensor<f64> {
    Tensor::from_vec(shape, noise(shape.iter().product(), seed))
}

/// Image, weight and bias of noise.
fn arguments(image: [usize; 3], outputs: usize, kernel: [usize; 2]) -> [Tensor<f64>; 3] {
    [tensor(&image, 1), tensor(&[outputs, kernel[0], kernel[1], image[2]], 2), tensor(&[outputs], 3)]
}

const SAMPLINGS: [Sampling; 4] = [
    Sampling { stride: 1, dilation: 1, padding: 1 },
    Sampling { stride: 2, dilation: 1, padding: 0 },
    Sampling { stride: 1, dilation: 2, padding: 2 },
    Sampling { stride: 3, dilation: 2, padding: 1 },
];

/// Output and the three gradients for an upstream gradient of noise.
fn run<T: Real>(arguments: &[Tensor<f64>; 3], sampling: Sampling) -> Vec<Tensor<T>> {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let vars = arguments.each_ref().map(|tensor| tape.leaf(tensor.cast()));
    let y = convolution(&mut tape, vars[0], vars[1], vars[2], sampling);
    let value = tape.value(y).clone();
    let gradients = tape.backward(&[(y, tensor(value.shape(), 4).cast())]);
    std::iter::once(value).chain(vars.map(|var| gradients.get(var).unwrap().clone())).collect()
}

#[test]
fn gradients_equal_central_differences() {
    for kernel in [[3, 3], [1, 1], [2, 3]] {
        for sampling in SAMPLINGS {
            let layer = |tape: &mut Tape<f64>, vars: &[Var]| convolution(tape, vars[0], vars[1], vars[2], sampling);
            gradients(layer, &arguments([6, 7, 2], 3, kernel), TOLERANCE).unwrap();
        }
    }
}

#[test]
fn the_fast_body_agrees_with_the_f64_reference() {
    for (image, outputs, kernel) in [([23, 19, 5], 7, [3, 3]), ([9, 70, 1], 1, [5, 1]), ([40, 40, 16], 33, [1, 1])] {
        let arguments = arguments(image, outputs, kernel);
        for sampling in SAMPLINGS {
            let (fast, exact) = (run::<f32>(&arguments, sampling), run::<f64>(&arguments, sampling));
            fast.iter().zip(&exact).for_each(|(fast, exact)| agree(fast, exact, 5e-6).unwrap());
        }
    }
}

#[test]
fn a_planted_fault_is_rejected() {
    let arguments = arguments([12, 12, 3], 4, [3, 3]);
    let exact = run::<f64>(&arguments, SAMPLINGS[0]);
    let mut faulty = arguments.clone();
    faulty[1].make_mut()[17] += 1e-3;
    assert!(agree(&run::<f32>(&faulty, SAMPLINGS[0])[0], &exact[0], 5e-6).is_err());
    let wider = Sampling { dilation: 2, padding: 2, ..SAMPLINGS[0] };
    assert!(agree(&run::<f32>(&arguments, wider)[1], &exact[1], 5e-6).is_err());
}

#[test]
fn a_small_example_by_hand() {
    let image = Tensor::from_vec([2, 2, 1], vec![1.0, 2.0, 3.0, 4.0]);
    let weight = Tensor::from_vec([1, 1, 3, 1], vec![10.0, 1.0, 100.0]);
    let sampling = Sampling { stride: 1, dilation: 1, padding: 1 };
    let y = &run::<f32>(&[image, weight, Tensor::from_vec([1], vec![0.5])], sampling)[0];
    assert_eq!(y.shape(), [4, 2, 1]);
    assert_eq!(y.as_slice(), [0.5, 0.5, 201.5, 12.5, 403.5, 34.5, 0.5, 0.5]);
}

/// The central-difference convolution by its definition: conv(w) − θ·conv₁ₓ₁(Σ w).
fn by_definition(tape: &mut Tape<f64>, image: Var, weight: &Tensor<f64>, theta: f64, sampling: Sampling) -> Vec<f64> {
    let &[outputs, height, width, channels] = weight.shape() else { unreachable!() };
    let sum = |output: usize, channel: usize| {
        (0..height * width).map(|tap| weight.as_slice()[(output * height * width + tap) * channels + channel]).sum()
    };
    let sums = (0..outputs).flat_map(|output| (0..channels).map(move |channel| sum(output, channel))).collect();
    let zeros = tape.constant(Tensor::zeros([outputs]));
    let (weight, sums) =
        (tape.constant(weight.clone()), tape.constant(Tensor::from_vec([outputs, 1, 1, channels], sums)));
    let ordinary = convolution(tape, image, weight, zeros, sampling);
    let central = convolution(tape, image, sums, zeros, Sampling::same_size(1, 1));
    tape.value(ordinary).as_slice().iter().zip(tape.value(central).as_slice()).map(|(y, x)| y - theta * x).collect()
}

#[test]
fn central_differences_follow_their_definition() {
    for dilation in [1, 2] {
        let (mut tape, sampling) = (Tape::new(Device::Cpu), Sampling::same_size(3, dilation));
        let weight = tensor(&[4, 3, 3, 2], 2);
        let (image, zeros) = (tape.constant(tensor(&[8, 6, 2], 1)), tape.constant(Tensor::zeros([4])));
        let expected = by_definition(&mut tape, image, &weight, 0.7, sampling);
        let weight = tape.constant(weight);
        let reduced = central_difference(&mut tape, weight, 0.7);
        let found = convolution(&mut tape, image, reduced, zeros, sampling);
        agree(tape.value(found), &Tensor::from_vec([8, 6, 4], expected), 1e-14).unwrap();
    }
}

#[test]
fn central_difference_gradients_equal_central_differences() {
    let reduced = |tape: &mut Tape<f64>, vars: &[Var]| central_difference(tape, vars[0], 0.7);
    gradients(reduced, &[tensor(&[2, 3, 3, 2], 1)], TOLERANCE).unwrap();
}

#[test]
fn full_central_differences_do_not_see_a_constant() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let (image, zeros) = (tape.constant(Tensor::full([7, 7, 3], 0.8)), tape.constant(Tensor::zeros([5])));
    let weight = tape.constant(tensor(&[5, 3, 3, 3], 2));
    let reduced = central_difference(&mut tape, weight, 1.0);
    let y = convolution(&mut tape, image, reduced, zeros, Sampling { stride: 1, dilation: 1, padding: 0 });
    assert!(tape.value(y).as_slice().iter().all(|value| value.abs() <= 1e-14));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let arguments = arguments([45, 33, 8], 16, [3, 3]);
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run::<f32>(&arguments, SAMPLINGS[0]))
    };
    assert!([2, 3, 8].iter().all(|&threads| run_with(threads) == run_with(1)));
}

#[test]
#[should_panic(expected = "larger than the padded image")]
fn a_kernel_that_does_not_fit_is_refused() {
    run::<f32>(&arguments([2, 9, 1], 1, [3, 3]), Sampling { stride: 1, dilation: 1, padding: 0 });
}
