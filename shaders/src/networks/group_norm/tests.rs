use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

fn arguments(height: usize, width: usize, channels: usize) -> [Tensor<f64>; 3] {
    let tensor = |shape: &[usize], seed| Tensor::from_vec(shape, noise(shape.iter().product(), seed));
    [tensor(&[height, width, channels], 1), tensor(&[channels], 2), tensor(&[channels], 3)]
}

/// Output and the three gradients for an upstream gradient of noise.
fn run<T: Real>(arguments: &[Tensor<f64>; 3], groups: usize) -> Vec<Tensor<T>> {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let vars = arguments.each_ref().map(|tensor| tape.leaf(tensor.cast()));
    let y = group_norm(&mut tape, vars[0], vars[1], vars[2], groups);
    let value = tape.value(y).clone();
    let seed = Tensor::from_vec(value.shape(), noise(value.len(), 4)).cast();
    let gradients = tape.backward(&[(y, seed)]);
    std::iter::once(value).chain(vars.map(|var| gradients.get(var).unwrap().clone())).collect()
}

#[test]
fn gradients_equal_central_differences() {
    for groups in [1, 2, 4] {
        let layer = |tape: &mut Tape<f64>, vars: &[Var]| group_norm(tape, vars[0], vars[1], vars[2], groups);
        gradients(layer, &arguments(3, 4, 4), TOLERANCE).unwrap();
    }
}

#[test]
fn every_group_has_mean_zero_and_variance_one() {
    let [mut x, ..] = arguments(9, 7, 6);
    x.make_mut().iter_mut().for_each(|value| *value = 5.0 + 3.0 * *value);
    let y = &run::<f32>(&[x, Tensor::full([6], 1.0), Tensor::zeros([6])], 3)[0];
    for group in 0..3 {
        let values: Vec<f64> =
            (0..63).flat_map(|pixel| [0, 1].map(|at| f64::from(y.as_slice()[pixel * 6 + 2 * group + at]))).collect();
        let mean = values.iter().sum::<f64>() / 126.0;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 126.0;
        assert!(mean.abs() <= 1e-6 && (variance - 1.0).abs() <= 1e-4, "mean {mean}, variance {variance}");
    }
}

#[test]
fn a_constant_image_is_the_shift() {
    let shift = Tensor::from_vec([2], vec![0.25, -1.5]);
    let found = run::<f32>(&[Tensor::full([3, 3, 2], 7.0), Tensor::full([2], 2.0), shift], 2);
    assert!(found[0].as_slice().chunks(2).all(|pixel| pixel == [0.25, -1.5]));
    assert!(found[1].is_finite());
}

#[test]
fn f32_agrees_with_f64_and_rejects_a_planted_fault() {
    let mut arguments = arguments(40, 31, 8);
    let exact = run::<f64>(&arguments, 4);
    run::<f32>(&arguments, 4).iter().zip(&exact).for_each(|(fast, exact)| agree(fast, exact, 2e-6).unwrap());
    arguments[1].make_mut()[3] += 1e-3;
    assert!(agree(&run::<f32>(&arguments, 4)[1], &exact[1], 2e-6).is_err());
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run::<f32>(&arguments(70, 50, 8), 4))
    };
    assert!([2, 3].iter().all(|&threads| run_with(threads) == run_with(1)));
}
