use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

/// A smooth random image with values within [0, 1].
fn image(height: usize, width: usize, seed: u64) -> Tensor<f64> {
    let noise = noise(height * width * 3, seed);
    let value = |i: usize| 0.5 + 0.3 * ((i / 3) as f64 * 0.37 + seed as f64).sin() + 0.2 * noise[i];
    Tensor::from_vec([height, width, 3], (0..height * width * 3).map(value).collect())
}

/// Mean SSIM and its gradient with respect to the first image.
fn run<T: Real>(x: &Tensor<f64>, y: &Tensor<f64>, window: Window) -> (f64, Tensor<T>) {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let (x, y) = (tape.leaf(x.cast()), tape.constant(y.cast()));
    let mean = ssim(&mut tape, x, y, window);
    let gradient = tape.backward(&[(mean, Tensor::scalar(T::ONE))]).take(x).unwrap();
    (tape.value(mean).as_slice()[0].to_f64(), gradient)
}

#[test]
fn gradients_equal_central_differences() {
    for (height, width, window) in [(7, 6, Window::ZeroPadded), (13, 12, Window::Valid), (5, 5, Window::ZeroPadded)] {
        let target = image(height, width, 2);
        let mean = |tape: &mut Tape<f64>, vars: &[Var]| {
            let target = tape.constant(target.clone());
            ssim(tape, vars[0], target, window)
        };
        gradients(mean, &[image(height, width, 1)], TOLERANCE).unwrap();
    }
}

#[test]
fn the_fast_body_agrees_with_the_f64_reference() {
    for (height, width) in [(40, 33), (5, 5), (1, 17), (11, 11), (33, 17)] {
        for window in [Window::ZeroPadded, Window::Valid] {
            if window == Window::Valid && height.min(width) < TAPS {
                continue;
            }
            let (x, y) = (image(height, width, 1), image(height, width, 2));
            let (fast, exact) = (run::<f32>(&x, &y, window), run::<f64>(&x, &y, window));
            assert!((fast.0 - exact.0).abs() <= 1e-5, "{fast:?} and {exact:?}");
            agree(&fast.1, &exact.1, 1e-4).unwrap();
        }
    }
}

#[test]
fn a_planted_fault_is_rejected() {
    let (x, y) = (image(20, 20, 1), image(20, 20, 2));
    let exact = run::<f64>(&x, &y, Window::ZeroPadded);
    let faulty = run::<f32>(&x, &y, Window::Valid);
    assert!(agree(&faulty.1, &exact.1, 1e-4).is_err() && (faulty.0 - exact.0).abs() > 1e-5);
}

#[test]
fn an_image_equals_itself() {
    let constant = |value| Tensor::full([16, 20, 3], value);
    for x in [image(30, 31, 3), constant(0.0), constant(0.7), constant(1.0)] {
        let (value, gradient) = run::<f32>(&x, &x, Window::ZeroPadded);
        assert!((value - 1.0).abs() <= 1e-6, "{value}");
        assert!(gradient.as_slice().iter().all(|gradient| gradient.abs() <= 1e-6));
    }
}

#[test]
fn black_against_white_leaves_the_stabiliser() {
    let images = [0.0, 1.0].map(|value| Tensor::full([24, 24, 3], value));
    let (value, gradient) = run::<f32>(&images[0], &images[1], Window::Valid);
    assert!((value - C1 / (1.0 + C1)).abs() <= 1e-8, "{value}");
    assert!(gradient.is_finite());
}

#[test]
fn noise_never_exceeds_one() {
    // Nearly equal flat images: variances are nothing but rounding.
    let flat = Tensor::full([32, 32, 3], 0.9);
    let nearly = Tensor::from_vec([32, 32, 3], noise(32 * 32 * 3, 5).iter().map(|x| 0.9 + 1e-4 * x).collect());
    let (value, gradient) = run::<f32>(&nearly, &flat, Window::ZeroPadded);
    assert!(value <= 1.0 && value > 0.99, "{value}");
    assert!(gradient.as_slice().iter().all(|gradient| gradient.abs() <= 1.0 / 32.0), "bounded where variances vanish");
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    // With one, two, and more threads, a band has 81, 41 and 32 rows; the last of the shortest ones has one row.
    let (x, y) = (image(161, 17, 1), image(161, 17, 2));
    for window in [Window::ZeroPadded, Window::Valid] {
        let run_with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run::<f32>(&x, &y, window))
        };
        assert!([2, 3, 8].iter().all(|&threads| run_with(threads) == run_with(1)));
    }
}

#[test]
#[should_panic(expected = "no window fits")]
fn an_image_without_a_valid_window_is_refused() {
    run::<f32>(&image(10, 30, 1), &image(10, 30, 2), Window::Valid);
}
