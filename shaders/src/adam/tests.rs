use super::*;
use crate::check::noise;

fn vector(values: &[f32]) -> Tensor<f32> {
    Tensor::from_vec([values.len()], values.to_vec())
}

fn step(group: &mut Group, gradient: &Tensor<f32>, learning_rate: f64) {
    Adam::default().step(&mut [Update { group, gradient: Some(gradient), learning_rate }]);
}

/// The equations of the paper in f64, for one parameter with the gradients `gradients[t]`.
fn textbook(adam: Adam, mut value: f64, gradients: impl Iterator<Item = f64>, rate: f64) -> f64 {
    let (mut first, mut second) = (0.0, 0.0);
    for (t, gradient) in gradients.enumerate() {
        first = adam.beta1 * first + (1.0 - adam.beta1) * gradient;
        second = adam.beta2 * second + (1.0 - adam.beta2) * gradient * gradient;
        let first_hat = first / (1.0 - adam.beta1.powi(t as i32 + 1));
        let second_hat: f64 = second / (1.0 - adam.beta2.powi(t as i32 + 1));
        value -= rate * first_hat / (second_hat.sqrt() + adam.epsilon);
    }
    value
}

#[test]
fn a_thousand_steps_equal_the_textbook() {
    let gradients: Vec<Vec<f32>> = (0..1000).map(|t| noise(3, t).iter().map(|&g| (0.3 + g) as f32).collect()).collect();
    let start = [1.0, -2.0, 0.5];
    let mut group = Group::new("test", vector(&start));
    gradients.iter().for_each(|gradient| step(&mut group, &vector(gradient), 1e-3));
    assert_eq!(group.step(), 1000);
    for (index, &start) in start.iter().enumerate() {
        let of_index = gradients.iter().map(|gradient| gradient[index] as f64);
        let expected = textbook(Adam::default(), start as f64, of_index, 1e-3);
        let travelled = (expected - start as f64).abs();
        let error = (group.tensor().as_slice()[index] as f64 - expected).abs();
        // f32 stores the value with a relative error of 6e-8, and a thousand additions accumulate √1000 times that.
        assert!(error <= 4e-6 * start.abs().max(1.0) as f64 && travelled > 0.1, "{error} after {travelled}");
    }
}

#[test]
fn a_wrong_beta_is_noticed() {
    let gradients = || noise(100, 1).into_iter();
    let faulty = Adam { beta2: 0.99, ..Adam::default() };
    assert!(
        (textbook(Adam::default(), 1.0, gradients(), 1e-3) - textbook(faulty, 1.0, gradients(), 1e-3)).abs() > 1e-4
    );
}

#[test]
fn tiny_gradients_take_a_full_first_step() {
    let mut group = Group::new("tiny", vector(&[0.0, 0.0]));
    step(&mut group, &vector(&[1e-12, -1e-12]), 0.01);
    let values = group.tensor().as_slice();
    assert!((values[0] / -0.01 - 1.0).abs() <= 2e-3 && values[0] == -values[1], "{values:?}");
}

#[test]
fn zero_gradients_do_not_move() {
    let mut group = Group::new("still", vector(&[0.25, -3.0]));
    (0..5).for_each(|_| step(&mut group, &vector(&[0.0, 0.0]), 0.1));
    assert_eq!(group.tensor(), &vector(&[0.25, -3.0]));
}

#[test]
fn subnormal_second_moments_stay_bounded() {
    let mut group = Group::new("subnormal", vector(&[0.0]));
    (0..50).for_each(|_| step(&mut group, &vector(&[1e-25]), 0.1));
    assert!(group.tensor().as_slice()[0].abs() <= 0.1 * 50.0);
}

#[test]
fn a_missing_gradient_leaves_the_group_alone() {
    let mut group = Group::new("absent", vector(&[1.0]));
    step(&mut group, &vector(&[1.0]), 0.1);
    let before = group.clone();
    Adam::default().step(&mut [Update { group: &mut group, gradient: None, learning_rate: 0.1 }]);
    assert_eq!(group, before);
}

#[test]
fn rows_are_kept_appended_and_forgotten_with_their_moments() {
    let mut group = Group::new("rows", Tensor::from_vec([3, 2], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
    step(&mut group, &Tensor::from_vec([3, 2], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), 0.0);
    group.keep_rows(&[true, false, true]);
    group.append_rows(&[7.0, 8.0]);
    let state = group.state();
    assert_eq!((state.shape.as_slice(), state.values.as_slice()), (&[3, 2][..], &[1.0, 2.0, 5.0, 6.0, 7.0, 8.0][..]));
    let expected: Vec<f32> = [1.0f32, 2.0, 5.0, 6.0, 0.0, 0.0].iter().map(|g| (1.0 - 0.9f32) * g).collect();
    assert_eq!(state.first_moment, expected);
    assert!(state.second_moment[..4].iter().all(|&v| v > 0.0) && state.second_moment[4..] == [0.0, 0.0]);
    group.reset_moments();
    assert!(group.state().first_moment.iter().chain(&group.state().second_moment).all(|&moment| moment == 0.0));
    assert_eq!(group.step(), 1);
    group.keep_rows(&[false; 3]);
    assert_eq!(group.tensor().shape(), [0, 2]);
}

#[test]
fn a_restored_group_continues_with_the_same_bits() {
    let gradient = |t: u64| Tensor::from_vec([50, 3], noise(150, t).iter().map(|&g| g as f32).collect());
    let mut group = Group::new("saved", gradient(99));
    (0..3).for_each(|t| step(&mut group, &gradient(t), 0.01));
    let mut restored = Group::from_state(group.state());
    (3..6).for_each(|t| step(&mut group, &gradient(t), 0.01));
    (3..6).for_each(|t| step(&mut restored, &gradient(t), 0.01));
    assert_eq!(restored, group);
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let tensor = |seed| Tensor::from_vec([30_000], noise(30_000, seed).iter().map(|&x| x as f32).collect());
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut group = Group::new("threads", tensor(0));
            (1..5).for_each(|t| step(&mut group, &tensor(t), 0.01));
            group
        })
    };
    assert!([2, 3, 8].iter().all(|&threads| run_with(threads) == run_with(1)));
}
