use super::reference::{Gaussian, slice as slice_one};
use super::*;
use crate::check::{self, TOLERANCE, noise};
use crate::geometry::algebra::{Mat3, product as product3, rotation, scale_columns, transposed as transposed3};
use crate::tape::{Backward, Device};

const COUNT: usize = 5;
const TIME: f64 = 0.45;

/// Scales, temporal scales, both quaternions, times and logits of [`COUNT`] Gaussians, in the order of the inputs.
fn tensors(seed: u64) -> Vec<Tensor<f64>> {
    let tensor = |len: usize, kind: u64, factor: f64, offset: f64| {
        let values = noise(COUNT * len, 8 * seed + kind).into_iter().map(|value| offset + factor * value).collect();
        Tensor::from_vec([COUNT, len], values)
    };
    vec![
        tensor(3, 0, 0.7, -1.5),
        tensor(1, 1, 0.5, -1.0),
        tensor(4, 2, 1.0, 0.0),
        tensor(4, 3, 1.0, 0.0),
        tensor(1, 4, 0.4, 0.5),
        tensor(1, 5, 2.0, 0.0),
    ]
}

fn vars(inputs: &[Var]) -> Gaussians4dVars {
    let &[log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits] = inputs else {
        panic!("six variables")
    };
    Gaussians4dVars { log_scales, log_scales_time, rotations_left, rotations_right, times, opacity_logits }
}

fn outputs(tape: &mut Tape<f64>, inputs: &[Var], least_share: f64) -> [Var; 4] {
    let sliced = slice(tape, &vars(inputs), TIME, least_share);
    [sliced.displacements, sliced.velocities, sliced.factors, sliced.opacity_logits]
}

/// A least share that every Gaussian exceeds.
const ALL: f64 = 1e-300;

/// A Gaussian of opacity logit ½.
fn one<T: Real>(log_scales: [f64; 4], left: [f64; 4], right: [f64; 4], offset: f64) -> Gaussian<T> {
    let f = T::from_f64;
    Gaussian {
        log_scales: log_scales.map(f),
        rotation_left: left.map(f),
        rotation_right: right.map(f),
        offset_time: f(offset),
        opacity_logit: f(0.5),
    }
}

fn covariance(factor: &Mat3<f64>) -> Mat3<f64> {
    product3(factor, &transposed3(factor))
}

#[test]
fn gradients_are_central_differences() {
    for output in 0..4 {
        for seed in 0..3 {
            // All Gaussians are present, and only some.
            for least_share in [ALL, 0.9] {
                let f = |tape: &mut Tape<f64>, inputs: &[Var]| outputs(tape, inputs, least_share)[output];
                check::gradients(f, &tensors(seed), TOLERANCE).unwrap();
            }
        }
    }
}

/// The identity with a gradient that is off by a ten thousandth in every second element.
struct NearlyIdentity;

#[test]
fn a_slightly_wrong_gradient_is_found() {
    let wrong = |tape: &mut Tape<f64>, inputs: &[Var]| {
        let sliced = slice(tape, &vars(inputs), TIME, ALL);
        tape.apply_one(NearlyIdentity, &[sliced.displacements])
    };
    assert!(check::gradients(wrong, &tensors(0), TOLERANCE).is_err());
}

impl Op<f64> for NearlyIdentity {
    fn name(&self) -> &'static str {
        "nearly identity"
    }

    fn forward(&mut self, inputs: &[&Tensor<f64>]) -> Vec<Tensor<f64>> {
        vec![inputs[0].clone()]
    }

    fn backward(&mut self, pass: Backward<f64>) -> Vec<Option<Tensor<f64>>> {
        let gradient = pass.output_grads[0].unwrap();
        let values = gradient.as_slice().iter().enumerate().map(|(at, value)| value * (1.0 + 1e-4 * (at % 2) as f64));
        vec![Some(Tensor::from_vec(gradient.shape(), values.collect()))]
    }
}

#[test]
fn a_slice_is_the_schur_complement() {
    let tensors = tensors(7);
    for row in 0..COUNT {
        let inputs: Vec<&Tensor<f64>> = tensors.iter().collect();
        let gaussian = gaussian(&inputs, row, TIME);
        let unit = |q: [f64; 4]| crate::geometry::algebra::normalised(q).0;
        let rotation = algebra::product(
            &algebra::left(unit(gaussian.rotation_left)),
            &algebra::right(unit(gaussian.rotation_right)),
        );
        let lengths = rotation.map(|row| [0, 1, 2, 3].map(|axis| row[axis] * gaussian.log_scales[axis].exp()));
        let sigma = algebra::product(&lengths, &algebra::transposed(&lengths));
        let sliced = slice_one(&gaussian);
        let found = covariance(&sliced.factor);
        for i in 0..3 {
            assert!((sliced.velocity[i] - sigma[i][3] / sigma[3][3]).abs() <= 1e-12);
            for j in 0..3 {
                let expected = sigma[i][j] - sigma[i][3] * sigma[j][3] / sigma[3][3];
                assert!((found[i][j] - expected).abs() <= 1e-12);
            }
        }
        let opacity = |logit: f64| 1.0 / (1.0 + (-logit).exp());
        let share = (-0.5 * gaussian.offset_time.powi(2) / sigma[3][3]).exp();
        assert!((opacity(sliced.opacity_logit) - opacity(gaussian.opacity_logit) * share).abs() <= 1e-12);
        assert!((gaussian.log_share() - share.ln()).abs() <= 1e-12);
    }
}

#[test]
fn equal_quaternions_rotate_space_as_that_of_a_3d_gaussian() {
    let q = [0.5, -0.1, 0.7, 0.3];
    let sliced = slice_one(&one::<f64>([-1.0, -2.0, -0.5, -1.0], q, q, 0.2));
    let unit = crate::geometry::algebra::normalised(q).0;
    let expected = covariance(&scale_columns(&rotation(unit), [-1.0, -2.0, -0.5].map(f64::exp)));
    let found = covariance(&sliced.factor);
    assert!(found.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() <= 1e-12));
    assert!(sliced.displacement.iter().all(|value| value.abs() <= 1e-12), "it does not move");
}

#[test]
fn rotations_keep_lengths_and_angles() {
    let q = |seed| -> [f64; 4] { crate::geometry::algebra::normalised(noise(4, seed).try_into().unwrap()).0 };
    let matrix = algebra::product(&algebra::left(q(1)), &algebra::right(q(2)));
    let gram = algebra::product(&matrix, &algebra::transposed(&matrix));
    let identity = [0, 1, 2, 3].map(|row| [0, 1, 2, 3].map(|column| f64::from(u8::from(row == column))));
    assert!(gram.iter().flatten().zip(identity.iter().flatten()).all(|(a, b)| (a - b).abs() <= 1e-12));
}

#[test]
fn shapes_of_all_proportions_are_finite_and_accurate_in_f32() {
    for case in 0..2000 {
        let values = noise(16, case);
        let log_scales = [0, 1, 2, 3].map(|axis| -6.0 + 12.0 * values[axis]);
        let quaternion = |first: usize| [0, 1, 2, 3].map(|axis| values[first + axis]);
        let parameters = (log_scales, quaternion(4), quaternion(8), 0.1 * values[12]);
        let narrow = slice_one(&one::<f32>(parameters.0, parameters.1, parameters.2, parameters.3));
        let wide = slice_one(&one::<f64>(parameters.0, parameters.1, parameters.2, parameters.3));
        // The factor is accurate to the rounding of the longest axis; which factor it is may differ between precisions.
        let longest = log_scales.map(f64::exp).into_iter().fold(0.0, f64::max);
        let largest = wide.factor.iter().flatten().fold(0.0, |max: f64, value| max.max(value.abs()));
        let allowed = 1e-5 * longest * (largest + 1e-6 * longest);
        let (found, expected) = (covariance(&narrow.factor.map(|row| row.map(f64::from))), covariance(&wide.factor));
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() <= allowed, "case {case}: {found} {expected}");
        }
        assert!(narrow.velocity.iter().all(|value| value.is_finite()) && !narrow.opacity_logit.is_nan(), "case {case}");
    }
}

#[test]
fn the_shortest_gaussians_in_time_have_finite_gradients() {
    let upstream = Sliced { displacement: [1.0; 3], velocity: [1.0; 3], factor: [[1.0; 3]; 3], opacity_logit: 1.0_f32 };
    for log_scale_time in [-5.0, -9.0, -12.0, -40.0, -200.0] {
        for offset in [0.0, 1e-6, 0.5] {
            let identity = [1.0, 0.0, 0.0, 0.0];
            let short = one::<f32>([-40.0, -2.0, -200.0, log_scale_time], identity, identity, offset);
            let gradient = reference::backward(&short, &upstream);
            let all = gradient.log_scales.iter().chain(&gradient.rotation_left).chain(&gradient.rotation_right);
            assert!(all.chain([&gradient.offset_time, &gradient.opacity_logit]).all(|value| value.is_finite()));
        }
    }
}

#[test]
fn opacities_fade_without_overflow() {
    let identity = [1.0, 0.0, 0.0, 0.0];
    let faded = |logit: f32, offset: f64| {
        let gaussian = one::<f32>([-1.0; 4], identity, identity, offset);
        slice_one(&Gaussian { opacity_logit: logit, ..gaussian }).opacity_logit
    };
    for logit in [-200.0, -5.0, 0.0, 5.0, 50.0_f32] {
        assert!((faded(logit, 0.0) - logit).abs() <= 1e-4 * logit.abs().max(1.0), "nothing fades at its own time");
        assert!(faded(logit, 1.0) < logit);
    }
    assert!(faded(1e4, 0.0).is_finite());
}

/// Static Gaussians whose times are this many of their standard deviations away.
fn at_distances(distances: [f64; COUNT]) -> Vec<Tensor<f64>> {
    let mut tensors = tensors(3);
    let identity = Tensor::from_vec([COUNT, 4], [1.0, 0.0, 0.0, 0.0].repeat(COUNT));
    (tensors[2], tensors[3]) = (identity.clone(), identity);
    tensors[1] = Tensor::full([COUNT, 1], 0.1_f64.ln());
    tensors[4] = Tensor::from_vec([COUNT, 1], distances.map(|at| TIME + 0.1 * at).to_vec());
    tensors
}

#[test]
fn gaussians_are_hidden_where_little_opacity_is_left() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    // 2.4477 standard deviations leave 5 %.
    let tensors = at_distances([0.0, 2.44, 2.46, -2.44, -2.46]);
    let inputs: Vec<Var> = tensors.into_iter().map(|tensor| tape.constant(tensor)).collect();
    let sliced = slice(&mut tape, &vars(&inputs), TIME, 0.05);
    assert_eq!(tape.value(sliced.present).as_slice(), [1.0, 1.0, 0.0, 1.0, 0.0]);
    let hidden = tape.value(sliced.opacity_logits).as_slice().iter().map(|&logit| logit == HIDDEN_LOGIT);
    assert_eq!(hidden.collect::<Vec<_>>(), [false, false, true, false, true]);
}

#[test]
fn a_gaussian_that_is_no_number_is_not_hidden() {
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let tensors = at_distances([f64::NAN; COUNT]);
    let inputs: Vec<Var> = tensors.into_iter().map(|tensor| tape.constant(tensor)).collect();
    let sliced = slice(&mut tape, &vars(&inputs), TIME, 0.05);
    assert_eq!(tape.value(sliced.present).as_slice(), [1.0; COUNT]);
    assert!(tape.value(sliced.displacements).as_slice().iter().any(|value| value.is_nan()));
}

#[test]
fn gaussians_that_are_hidden_change_nothing_for_the_others() {
    let run = |least_share| {
        let mut tape = Tape::<f64>::new(Device::Cpu);
        let tensors = at_distances([0.1, 2.9, -0.3, 2.7, 0.2]);
        let inputs: Vec<Var> = tensors.into_iter().map(|tensor| tape.leaf(tensor)).collect();
        let factors = outputs(&mut tape, &inputs, least_share)[2];
        let seed = Tensor::full(tape.value(factors).shape(), 1.0);
        let mut gradients = tape.backward(&[(factors, seed)]);
        (tape.value(factors).clone(), gradients.take(inputs[2]).unwrap())
    };
    let ((every, g_every), (some, g_some)) = (run(ALL), run(0.05));
    for row in [0, 2, 4] {
        assert_eq!((every.row(row), g_every.row(row)), (some.row(row), g_some.row(row)));
    }
    for row in [1, 3] {
        assert!(some.row(row).iter().chain(g_some.row(row)).all(|&value| value == 0.0));
        assert!(g_every.row(row).iter().any(|&value| value != 0.0));
    }
}
