//! What is measured, here and in `benches/blend.rs`: a rendered ball, a layer and a field, the photometric loss, and a step of
//! the optimiser.

use shaders::adam::{Adam, Group, Update};
use shaders::check::noise;
use shaders::geometry::camera::PinholeCamera;
use shaders::losses::l1::l1_dssim;
use shaders::networks::hexplane::{HexplaneShape, hexplane};
use shaders::networks::linear::{Activation, linear};
use shaders::rasteriser::{self, RasterSettings, SplatTensors};
use shaders::tape::{Device, Tape, Tensor, Var};

/// Features of the layer's inputs and outputs.
pub(crate) const WIDTH: usize = 64;

pub(crate) fn random(shape: &[usize], seed: u64, factor: f64, offset: f64) -> Tensor<f32> {
    let values = noise(shape.iter().product(), seed).into_iter().map(|value| (offset + factor * value) as f32);
    Tensor::from_vec(shape, values.collect())
}

pub(crate) fn camera(size: usize) -> PinholeCamera {
    let size_px = size as f64;
    PinholeCamera {
        width: size,
        height: size,
        focal: [1.39 * size_px; 2],
        center: [0.5 * size_px; 2],
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0, 0.0, 4.0],
    }
}

/// A ball of splats like those of a training at low resolution, seen from outside: standard deviations around a hundredth
/// of the ball's radius.
pub(crate) fn ball(splats: usize) -> SplatTensors<f32> {
    SplatTensors {
        positions: random(&[splats, 3], 0, 1.0, 0.0),
        log_scales: random(&[splats, 3], 1, 0.8, -4.0),
        rotations: random(&[splats, 4], 2, 1.0, 0.0),
        opacity_logits: random(&[splats, 1], 3, 3.0, -1.0),
        sh: random(&[splats, 16, 3], 4, 0.2, 0.1),
    }
}

/// A run that renders a ball and differentiates the image.
pub(crate) fn render(device: Device, splats: usize, size: usize) -> impl FnMut() -> Tape<f32> {
    let (scene, camera) = (ball(splats), camera(size));
    let seed = Tensor::full([size, size, 3], 1e-3);
    move || {
        let mut tape = Tape::new(device);
        let vars = scene.leaves(&mut tape);
        let rendered =
            rasteriser::render(&mut tape, &vars, None, &camera, &RasterSettings::default()).expect("it fits");
        tape.backward(&[(rendered.color, seed.clone())]);
        tape
    }
}

/// The field of the run of [`dense`].
pub(crate) fn field() -> HexplaneShape {
    HexplaneShape { channels: 32, resolution: [64, 64, 64, 75], multipliers: vec![1, 2] }
}

/// A run of a layer and a field at N points, forward and backward.
pub(crate) fn dense(device: Device, points: usize) -> impl FnMut() -> Tape<f32> {
    let layer =
        [random(&[points, WIDTH], 1, 1.0, 0.0), random(&[WIDTH, WIDTH], 2, 0.1, 0.0), random(&[WIDTH], 3, 0.1, 0.0)];
    let planes: Vec<Tensor<f32>> = field().plane_shapes().iter().map(|plane| random(plane, 5, 0.1, 1.0)).collect();
    let positions = random(&[points, 3], 6, 1.0, 0.0);
    let seeds = [WIDTH, field().features()].map(|width| Tensor::full([points, width], 1.0));
    move || {
        let mut tape = Tape::new(device);
        let [x, weight, bias] = layer.clone().map(|tensor| tape.leaf(tensor));
        let planes: Vec<Var> = planes.iter().map(|plane| tape.leaf(plane.clone())).collect();
        let positions = tape.leaf(positions.clone());
        let layer = linear(&mut tape, x, weight, bias, Activation::Relu);
        let field = hexplane(&mut tape, &planes, positions, 0.3);
        tape.backward(&[(layer, seeds[0].clone()), (field, seeds[1].clone())]);
        tape
    }
}

/// A run of the photometric loss of an image.
pub(crate) fn losses(device: Device, size: usize) -> impl FnMut() -> Tape<f32> {
    let images = [random(&[size, size, 3], 7, 0.5, 0.5), random(&[size, size, 3], 8, 0.5, 0.5)];
    let seed = Tensor::full([1], 1.0);
    move || {
        let mut tape = Tape::new(device);
        let (render, truth) = (tape.leaf(images[0].clone()), tape.constant(images[1].clone()));
        let loss = l1_dssim(&mut tape, render, truth, 0.2);
        tape.backward(&[(loss, seed.clone())]);
        tape
    }
}

/// A step of the optimiser on the harmonics of all splats.
pub(crate) fn optimizer(device: Device, splats: usize) -> impl FnMut() {
    let mut group = Group::new("harmonics", random(&[splats, 48], 9, 1.0, 0.0));
    let gradient = {
        // The result of a backward pass on the device.
        let mut tape = Tape::new(device);
        let x = tape.leaf(random(&[splats, 48], 10, 1e-3, 0.0));
        let y = shaders::pointwise::square(&mut tape, x);
        tape.backward(&[(y, Tensor::full([splats, 48], 1.0))]).take(x).expect("it has one")
    };
    move || {
        let update = Update { group: &mut group, gradient: Some(&gradient), learning_rate: 1e-3 };
        Adam::default().step(&mut [update]);
    }
}
