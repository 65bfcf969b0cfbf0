use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

fn image(height: usize, width: usize, channels: usize) -> Tensor<f64> {
    Tensor::from_vec([height, width, channels], noise(height * width * channels, 1))
}

fn pooled<T: Real>(image: &Tensor<f64>, rows: usize, columns: usize) -> Tensor<T> {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let image = tape.constant(image.cast());
    let grid = average_pool(&mut tape, image, rows, columns);
    tape.value(grid).clone()
}

#[test]
fn gradients_equal_central_differences() {
    for (rows, columns) in [(3, 2), (2, 5), (1, 1), (9, 8)] {
        let pool = |tape: &mut Tape<f64>, vars: &[Var]| average_pool(tape, vars[0], rows, columns);
        gradients(pool, &[image(6, 5, 2)], TOLERANCE).unwrap();
    }
}

#[test]
fn cells_of_whole_pixels_are_plain_means() {
    let image = Tensor::from_vec([2, 4, 1], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);
    assert_eq!(pooled::<f64>(&image, 1, 2).as_slice(), [3.5, 5.5]);
    // Three pixels over two cells: the middle one counts half in each.
    let image = Tensor::from_vec([1, 3, 1], vec![3.0, 6.0, 12.0]);
    agree(&pooled::<f64>(&image, 1, 2), &Tensor::from_vec([1, 2, 1], vec![4.0, 10.0]), 1e-15).unwrap();
}

#[test]
fn the_mean_of_the_cells_is_the_mean_of_the_image() {
    let mean = |tensor: &Tensor<f64>| tensor.as_slice().iter().sum::<f64>() / tensor.len() as f64;
    for (rows, columns) in [(1, 1), (3, 4), (7, 11), (20, 30)] {
        let (image, grid) = (image(13, 17, 1), pooled::<f64>(&image(13, 17, 1), rows, columns));
        assert!((mean(&image) - mean(&grid)).abs() <= 1e-14, "{rows}×{columns}");
    }
}

#[test]
fn f32_agrees_with_f64_and_rejects_a_planted_fault() {
    let mut image = image(50, 41, 3);
    let exact = pooled::<f64>(&image, 8, 9);
    agree(&pooled::<f32>(&image, 8, 9), &exact, 1e-6).unwrap();
    image.make_mut()[1000] += 1e-2;
    assert!(agree(&pooled::<f32>(&image, 8, 9), &exact, 1e-6).is_err());
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| pooled::<f32>(&image(61, 47, 5), 7, 9))
    };
    assert!([2, 3].iter().all(|&threads| run_with(threads) == run_with(1)));
}
