use super::*;
use crate::check::{TOLERANCE, agree, gradients, noise};
use crate::tape::Device;

fn shape(channels: usize) -> HexplaneShape {
    HexplaneShape { channels, resolution: [4, 5, 3, 6], multipliers: vec![1, 2] }
}

/// Positions (some of them outside the field), then all planes around 1.
fn arguments(shape: &HexplaneShape, points: usize) -> Vec<Tensor<f64>> {
    let spread = noise(3 * points, 7).iter().map(|x| 1.3 * x).collect();
    let plane = |(seed, shape): (usize, [usize; 3])| {
        let values = noise(shape.iter().product(), 10 + seed as u64).iter().map(|x| 1.0 + 0.5 * x).collect();
        Tensor::from_vec(shape, values)
    };
    let planes = shape.plane_shapes().into_iter().enumerate().map(plane);
    std::iter::once(Tensor::from_vec([points, 3], spread)).chain(planes).collect()
}

/// Features and all gradients for an upstream gradient of noise.
fn run<T: Real>(arguments: &[Tensor<f64>], time: f64) -> Vec<Tensor<T>> {
    let mut tape = Tape::<T>::new(Device::Cpu);
    let vars: Vec<Var> = arguments.iter().map(|tensor| tape.leaf(tensor.cast())).collect();
    let y = hexplane(&mut tape, &vars[1..], vars[0], time);
    let value = tape.value(y).clone();
    let seed = Tensor::from_vec(value.shape(), noise(value.len(), 4)).cast();
    let gradients = tape.backward(&[(y, seed)]);
    std::iter::once(value).chain(vars.iter().map(|&var| gradients.get(var).unwrap().clone())).collect()
}

/// A field of one channel and one scale in which only the xy plane differs from 1.
fn run_xy(plane: Tensor<f64>, positions: &[[f64; 3]]) -> Vec<Tensor<f64>> {
    let resolution = [plane.shape()[1], plane.shape()[0], 3, 2];
    let shape = HexplaneShape { channels: 1, resolution, multipliers: vec![1] };
    let positions = Tensor::from_vec([positions.len(), 3], positions.concat());
    let others = shape.plane_shapes().into_iter().skip(1).map(|shape| Tensor::full(shape, 1.0));
    run(&[positions, plane].into_iter().chain(others).collect::<Vec<_>>(), 0.3)
}

#[test]
fn gradients_equal_central_differences() {
    let field = |tape: &mut Tape<f64>, vars: &[Var]| hexplane(tape, &vars[1..], vars[0], 0.37);
    gradients(field, &arguments(&shape(2), 6), TOLERANCE).unwrap();
}

#[test]
fn the_fast_body_agrees_with_the_reference_for_every_width() {
    for (channels, time) in [(4, -1.0), (8, 0.123), (32, 1.0), (3, 0.5)] {
        let arguments = arguments(&shape(channels), 700);
        let (fast, exact) = (run::<f32>(&arguments, time), run::<f64>(&arguments, time));
        for (index, (fast, exact)) in fast.iter().zip(&exact).enumerate() {
            agree(fast, exact, 1e-5)
                .unwrap_or_else(|mismatch| panic!("{channels} channels, result {index}: {mismatch}"));
        }
    }
}

#[test]
fn a_planted_fault_is_rejected() {
    let mut arguments = arguments(&shape(8), 100);
    let exact = run::<f64>(&arguments, 0.2);
    arguments[1].make_mut().swap(0, 80);
    let faulty = run::<f32>(&arguments, 0.2);
    assert!(faulty.iter().zip(&exact).any(|(faulty, exact)| agree(faulty, exact, 1e-5).is_err()));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let arguments = arguments(&shape(32), 3000);
    let run_with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run::<f32>(&arguments, 0.4))
    };
    assert!([2, 3, 8].iter().all(|&threads| run_with(threads) == run_with(1)));
}

#[test]
fn corners_are_texels_and_outside_is_the_border() {
    let plane = Tensor::from_vec([2, 3, 1], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    let points = [[-1.0, -1.0, 0.1], [1.0, -1.0, 0.1], [0.0, 1.0, 0.1], [1.0, 1.0, 0.1], [5.0, -5.0, 0.1]];
    let results = run_xy(plane, &points);
    assert_eq!(results[0].as_slice(), [1.0, 3.0, 5.0, 6.0, 3.0]);
    assert_eq!(results[1].row(4), [0.0; 3], "no gradient outside");
    assert!(results[1].row(3)[0] != 0.0, "the border itself is inside");
}

#[test]
fn texel_gradients_sum_to_the_upstream_gradient() {
    let points = [[0.31, -0.77, 0.0], [2.0, 0.4, 0.0]];
    let results = run_xy(Tensor::full([4, 5, 1], 1.0), &points);
    let (total, expected) = (results[2].as_slice().iter().sum::<f64>(), noise(2, 4).iter().sum::<f64>());
    assert!((total - expected).abs() < 1e-14, "{total} instead of {expected}");
}

#[test]
fn an_axis_of_one_texel_is_constant() {
    let results = run_xy(Tensor::from_vec([2, 1, 1], vec![3.0, 4.0]), &[[-1.0, -1.0, 0.0], [0.5, -1.0, 0.0]]);
    assert_eq!(results[0].as_slice(), [3.0, 3.0]);
    assert_eq!((results[1].row(0)[0], results[1].row(1)[0]), (0.0, 0.0));
}

#[test]
fn a_nan_position_gives_nan_features_and_leaves_the_others() {
    let mut arguments = arguments(&shape(8), 3);
    let clean = run::<f32>(&arguments, 0.0);
    arguments[0].make_mut()[4] = f64::NAN;
    let poisoned = run::<f32>(&arguments, 0.0);
    assert!(poisoned[0].row(1).iter().all(|value| value.is_nan()));
    assert!([0, 2].iter().all(|&point| poisoned[0].row(point) == clean[0].row(point)));
}

pub(super) fn smoothness<T: Real>(tape: &mut Tape<T>, planes: &[Var]) -> Var {
    plane_means(tape, &[(PlaneMean::SecondDifference, planes.to_vec())])[0]
}

pub(super) fn distance_to_one<T: Real>(tape: &mut Tape<T>, planes: &[Var]) -> Var {
    plane_means(tape, &[(PlaneMean::DistanceToOne, planes.to_vec())])[0]
}

/// The sum of three means; the last two share planes.
fn all_means(tape: &mut Tape<f64>, planes: &[Var]) -> Var {
    let terms = [
        (PlaneMean::SecondDifference, planes[..1].to_vec()),
        (PlaneMean::SecondDifference, planes[1..].to_vec()),
        (PlaneMean::DistanceToOne, planes[1..].to_vec()),
    ];
    let means = plane_means(tape, &terms);
    means.into_iter().reduce(|a, b| crate::pointwise::add(tape, a, b)).expect("three means")
}

type Regulariser = fn(&mut Tape<f64>, &[Var]) -> Var;
const REGULARISERS: [Regulariser; 2] = [smoothness, distance_to_one];

fn regularise(regulariser: Regulariser, plane: &Tensor<f64>) -> f64 {
    let mut tape = Tape::new(Device::Cpu);
    let var = tape.leaf(plane.clone());
    let value = regulariser(&mut tape, &[var]);
    tape.value(value).as_slice()[0]
}

fn plane(shape: [usize; 3], value: impl Fn(usize, usize, usize) -> f64) -> Tensor<f64> {
    let [height, width, channels] = shape;
    let at = |i: usize| value(i / (width * channels), i / channels % width, i % channels);
    Tensor::from_vec(shape, (0..height * width * channels).map(at).collect())
}

#[test]
fn regulariser_gradients_equal_central_differences() {
    let inputs =
        [[7, 3, 2], [2, 5, 2], [3, 2, 4]].map(|shape| plane(shape, |i, j, k| ((3 * i + 5 * j + 7 * k) as f64).sin()));
    for regulariser in REGULARISERS.into_iter().chain([all_means as Regulariser]) {
        gradients(regulariser, &inputs, TOLERANCE).unwrap();
    }
}

#[test]
fn smoothness_sees_curvature_along_the_height_only() {
    assert_eq!(regularise(smoothness, &plane([6, 4, 3], |_, _, _| 0.7)), 0.0, "constant");
    assert_eq!(regularise(smoothness, &plane([6, 4, 3], |i, _, _| 2.0 * i as f64)), 0.0, "ramp");
    assert_eq!(regularise(smoothness, &plane([6, 4, 3], |_, j, k| (j * j + k) as f64)), 0.0, "curved across");
    assert_eq!(regularise(smoothness, &plane([6, 4, 3], |i, _, _| (i * i) as f64)), 4.0, "second difference 2");
    assert_eq!(regularise(smoothness, &plane([2, 4, 3], |i, _, _| i as f64)), 0.0, "too low for a second difference");
}

#[test]
fn regularisers_do_not_change_when_channels_are_duplicated() {
    let value = |i: usize, j: usize, k: usize| ((3 * i + 5 * j + 7 * k) as f64).cos();
    for regulariser in REGULARISERS {
        let (once, twice) = (plane([5, 4, 3], value), plane([5, 4, 6], |i, j, k| value(i, j, k % 3)));
        let (once, twice) = (regularise(regulariser, &once), regularise(regulariser, &twice));
        assert!((once - twice).abs() < 1e-14 && once > 0.0, "{once} and {twice}");
    }
}

#[test]
fn the_distance_to_one_is_a_mean() {
    assert_eq!(regularise(distance_to_one, &plane([2, 2, 1], |i, _, _| if i == 0 { 1.0 } else { 0.5 })), 0.25);
}
