use super::*;
use crate::check::{TOLERANCE, gradients, noise};
use crate::tape::{Backward, Device, Op, Tensor};

const NEAR: f64 = 0.1;
const EDGES: Sampling = Sampling::NearestAcrossEdges { relative: 0.1 };

/// A turned camera (a rotation about y, then about x) that stands off the origin.
fn camera() -> PinholeCamera {
    let ((sin_a, cos_a), (sin_b, cos_b)) = (0.4_f64.sin_cos(), (-0.3_f64).sin_cos());
    PinholeCamera {
        width: 8,
        height: 6,
        focal: [9.0, 10.0],
        center: [4.2, 2.9],
        rotation: [[cos_a, 0.0, sin_a], [sin_b * sin_a, cos_b, -sin_b * cos_a], [-cos_b * sin_a, sin_b, cos_b * cos_a]],
        translation: [0.3, -0.2, 2.5],
    }
}

fn points(count: usize) -> Tensor<f64> {
    Tensor::from_vec([count, 3], noise(3 * count, 1))
}

fn image(channels: usize) -> Tensor<f64> {
    Tensor::from_vec([6, 8, channels], noise(48 * channels, 2))
}

fn pixels(positions: &[[f64; 2]]) -> Tensor<f64> {
    Tensor::from_vec([positions.len(), 2], positions.concat())
}

/// Between the centres, between centre and border, and outside.
fn scattered_pixels() -> Tensor<f64> {
    pixels(&[[3.3, 2.2], [6.9, 4.1], [0.2, 3.7], [7.8, 5.9], [-0.4, 2.0], [4.4, 6.1], [3.7, 2.9]])
}

fn sample(image: &Tensor<f64>, positions: &[[f64; 2]], sampling: Sampling) -> (Vec<f64>, Vec<bool>) {
    let mut tape = Tape::new(Device::Cpu);
    let (image, pixels) = (tape.constant(image.clone()), tape.constant(pixels(positions)));
    let Sampled { values, valid } = lookup(&mut tape, image, pixels, sampling);
    (tape.value(values).as_slice().to_vec(), tape.value(valid).as_slice().iter().map(|&valid| valid == 1.0).collect())
}

#[test]
fn gradients_equal_central_differences() {
    let pixels_of = |tape: &mut Tape<f64>, vars: &[Var]| project_points(tape, vars[0], &camera(), NEAR).pixels;
    let depths_of = |tape: &mut Tape<f64>, vars: &[Var]| project_points(tape, vars[0], &camera(), NEAR).depths;
    gradients(pixels_of, &[points(9)], TOLERANCE).unwrap();
    gradients(depths_of, &[points(9)], TOLERANCE).unwrap();

    let depths = Tensor::from_vec([7], noise(7, 3).iter().map(|depth| 2.0 + depth).collect());
    let back = |tape: &mut Tape<f64>, vars: &[Var]| unproject(tape, vars[0], vars[1], &camera());
    gradients(back, &[scattered_pixels(), depths], TOLERANCE).unwrap();

    for (channels, sampling) in [(1, Sampling::Bilinear), (3, Sampling::Bilinear), (1, EDGES)] {
        let values = |tape: &mut Tape<f64>, vars: &[Var]| lookup(tape, vars[0], vars[1], sampling).values;
        gradients(values, &[image(channels), scattered_pixels()], TOLERANCE).unwrap();
    }
}

/// An operation whose gradient of one input is a thousandth too large.
struct Faulty<O>(O, usize);

impl<O: Op<f64>> Op<f64> for Faulty<O> {
    fn name(&self) -> &'static str {
        "faulty"
    }

    fn forward(&mut self, inputs: &[&Tensor<f64>]) -> Vec<Tensor<f64>> {
        self.0.forward(inputs)
    }

    fn backward(&mut self, pass: Backward<f64>) -> Vec<Option<Tensor<f64>>> {
        let mut found = self.0.backward(pass);
        if let Some(gradient) = &mut found[self.1] {
            gradient.make_mut().iter_mut().for_each(|value| *value *= 1.001);
        }
        found
    }
}

#[test]
fn planted_faults_are_rejected() {
    let camera = camera();
    let project = |tape: &mut Tape<f64>, vars: &[Var]| tape.apply(Faulty(Project::new(&camera, NEAR), 0), vars)[0];
    assert!(gradients(project, &[points(9)], TOLERANCE).is_err());
    for input in 0..2 {
        let back = |tape: &mut Tape<f64>, vars: &[Var]| tape.apply_one(Faulty(Unproject::new(&camera), input), vars);
        assert!(gradients(back, &[scattered_pixels(), Tensor::full([7], 2.0)], TOLERANCE).is_err(), "input {input}");
        let op = || Lookup::new(&[6, 8, 2], Sampling::Bilinear);
        let values = |tape: &mut Tape<f64>, vars: &[Var]| tape.apply_one(Faulty(op(), input), vars);
        assert!(gradients(values, &[image(2), scattered_pixels()], TOLERANCE).is_err(), "input {input}");
    }
}

#[test]
fn unprojection_inverts_projection() {
    let mut tape = Tape::new(Device::Cpu);
    let world = tape.constant(points(50));
    let PointsInImage { pixels, depths } = project_points(&mut tape, world, &camera(), NEAR);
    let back = unproject(&mut tape, pixels, depths, &camera());
    crate::check::agree(tape.value(back), tape.value(world), 1e-12).unwrap();
}

#[test]
fn a_point_in_the_optical_axis_is_seen_at_the_principal_point() {
    let camera = PinholeCamera { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ..camera() };
    let mut tape = Tape::<f64>::new(Device::Cpu);
    let world = tape.constant(Tensor::from_vec([1, 3], vec![-0.3, 0.2, 1.5]));
    let seen = project_points(&mut tape, world, &camera, NEAR);
    assert_eq!(tape.value(seen.pixels).as_slice(), camera.center);
    assert_eq!(tape.value(seen.depths).as_slice(), [4.0]);
}

#[test]
fn what_is_not_beyond_the_near_plane_is_nowhere_and_has_a_finite_gradient() {
    let camera = PinholeCamera { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], ..camera() };
    let mut tape = Tape::new(Device::Cpu);
    // In the camera's centre, behind it, before the near plane.
    let world = vec![-0.3, 0.2, -2.5, 1.0, 1.0, -9.0, 0.0, 0.0, 0.5 * NEAR - 2.5];
    let world = tape.leaf(Tensor::from_vec([3, 3], world));
    let seen = project_points(&mut tape, world, &camera, NEAR);
    assert_eq!(tape.value(seen.pixels).as_slice(), [NOWHERE; 6]);
    let image = tape.constant(image(1));
    let valid = lookup(&mut tape, image, seen.pixels, Sampling::Bilinear).valid;
    assert_eq!(tape.value(valid).as_slice(), [0.0; 3]);
    let gradients = tape.backward(&[(seen.pixels, Tensor::full([3, 2], 1.0))]);
    assert_eq!(gradients.get(world).unwrap().as_slice(), [0.0; 9]);
}

#[test]
fn pixel_centres_give_the_pixels_and_the_border_continues() {
    let image = image(1);
    let at = |i: usize, j: usize| image.as_slice()[8 * j + i];
    let (values, valid) = sample(&image, &[[2.5, 3.5], [7.5, 5.5], [0.0, 0.0], [3.0, 3.5]], Sampling::Bilinear);
    assert_eq!(values, [at(2, 3), at(7, 5), at(0, 0), 0.5 * (at(2, 3) + at(3, 3))]);
    assert_eq!(valid, [true; 4]);
    let outside = [[-0.1, 3.0], [8.1, 3.0], [3.0, 6.1], [f64::NAN, 3.0], [3.0, f64::INFINITY]];
    assert_eq!(sample(&image, &outside, Sampling::Bilinear), (vec![0.0; 5], vec![false; 5]));
}

#[test]
fn a_depth_edge_is_not_interpolated_but_a_slope_is() {
    let step = Tensor::from_vec([1, 4], vec![2.0, 2.0, 5.0, 5.2]);
    // Across the step the nearer pixel's depth; within 10 % the mean.
    let positions = [[1.9, 0.5], [2.1, 0.5], [3.0, 0.5]];
    let (across, _) = sample(&step, &positions, EDGES);
    assert!(across[0] == 2.0 && across[1] == 5.0 && (across[2] - 5.1).abs() <= 1e-12, "{across:?}");
    let (mixed, _) = sample(&step, &positions, Sampling::Bilinear);
    assert!((mixed[0] - 3.2).abs() <= 1e-12, "{mixed:?}");
}

#[test]
fn a_channel_that_crosses_zero_is_no_edge_beside_a_large_one() {
    let flow = Tensor::from_vec([1, 2, 2], vec![5.0, -0.1, 5.2, 0.1]);
    let (between, _) = sample(&flow, &[[1.0, 0.5]], EDGES);
    assert!((between[0] - 5.1).abs() <= 1e-12 && between[1].abs() <= 1e-12, "{between:?}");
}

#[test]
fn holes_are_not_valid_and_do_not_spread_where_the_nearest_pixel_is_known() {
    let holed = Tensor::from_vec([1, 3], vec![2.0, f64::NAN, 4.0]);
    let positions = [[0.9, 0.5], [1.1, 0.5], [2.5, 0.5]];
    assert_eq!(sample(&holed, &positions, EDGES), (vec![2.0, 0.0, 4.0], vec![true, false, true]));
    assert_eq!(sample(&holed, &positions[..2], Sampling::Bilinear), (vec![0.0; 2], vec![false; 2]));
}

#[test]
fn an_image_of_one_pixel_is_the_same_everywhere() {
    let pixel = Tensor::from_vec([1, 1, 2], vec![3.0, 4.0]);
    assert_eq!(sample(&pixel, &[[0.1, 0.9]], Sampling::Bilinear), (vec![3.0, 4.0], vec![true]));
}
