//! Cost of the dense kernels at the sizes of one training iteration: 20 000 Gaussians, 200×200 pixels.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use shaders::adam::{Adam, Group, Update};
use shaders::check::noise;
use shaders::losses::l1::l1_dssim;
use shaders::networks::hexplane::{HexplaneShape, PlaneMean, hexplane, is_time_plane, plane_means};
use shaders::networks::linear::{Activation, linear};
use shaders::tape::{Device, Tape, Tensor, Var};

const POINTS: usize = 20_000;

fn random(shape: &[usize], seed: u64) -> Tensor<f32> {
    Tensor::from_vec(shape, noise(shape.iter().product(), seed).iter().map(|&value| value as f32).collect())
}

/// Benchmarks the forward pass of `f` alone, and forward and backward together.
fn forward_and_backward(
    criterion: &mut Criterion,
    name: &str,
    throughput: Throughput,
    inputs: &[Tensor<f32>],
    f: impl Fn(&mut Tape<f32>, &[Var]) -> Var,
) {
    let run = |backward: bool| {
        let mut tape = Tape::new(Device::Cpu);
        let vars: Vec<Var> = inputs.iter().map(|input| tape.leaf(input.clone())).collect();
        let output = f(&mut tape, &vars);
        if backward {
            let seed = Tensor::full(tape.value(output).shape(), 1.0);
            black_box(tape.backward(&[(output, seed)]));
        }
        black_box(tape);
    };
    let mut group = criterion.benchmark_group(name);
    group.sample_size(20).throughput(throughput);
    group.bench_function("forward", |bencher| bencher.iter(|| run(false)));
    group.bench_function("forward and backward", |bencher| bencher.iter(|| run(true)));
}

fn linear_layer(criterion: &mut Criterion) {
    let inputs = [random(&[POINTS, 64], 1), random(&[64, 64], 2), random(&[64], 3)];
    let flops = Throughput::Elements((2 * POINTS * 64 * 64) as u64);
    forward_and_backward(criterion, "linear 20k 64-64", flops, &inputs, |tape, vars| {
        linear(tape, vars[0], vars[1], vars[2], Activation::Relu)
    });
}

fn hexplane_field(criterion: &mut Criterion) {
    let shape = HexplaneShape { channels: 32, resolution: [64, 64, 64, 50], multipliers: vec![1, 2] };
    let planes: Vec<_> = shape.plane_shapes().iter().map(|shape| random(shape, 5)).collect();
    let inputs: Vec<_> = [random(&[POINTS, 3], 6)].into_iter().chain(planes.clone()).collect();
    let points = Throughput::Elements(POINTS as u64);
    forward_and_backward(criterion, "hexplane 20k, 2 scales, 32 channels", points, &inputs, |tape, vars| {
        hexplane(tape, &vars[1..], vars[0], 0.3)
    });
    let spatial: Vec<_> = (0..12).filter(|&index| !is_time_plane(index)).map(|index| planes[index].clone()).collect();
    let texels = Throughput::Elements(spatial.iter().map(Tensor::len).sum::<usize>() as u64);
    forward_and_backward(criterion, "smoothness of the spatial planes", texels, &spatial, |tape, planes| {
        plane_means(tape, &[(PlaneMean::SecondDifference, planes.to_vec())])[0]
    });
}

fn photometric_loss(criterion: &mut Criterion) {
    let [render, target] = [7, 8].map(|seed| random(&[200, 200, 3], seed));
    forward_and_backward(criterion, "L1 and SSIM 200x200", Throughput::Elements(40_000), &[render], |tape, vars| {
        let target = tape.constant(target.clone());
        l1_dssim(tape, vars[0], target, 0.2)
    });
}

fn optimiser(criterion: &mut Criterion) {
    let mut group = Group::new("gaussians", random(&[POINTS, 59], 9));
    let gradient = random(&[POINTS, 59], 10);
    let mut benchmark = criterion.benchmark_group("Adam 20k x 59");
    benchmark.sample_size(20).throughput(Throughput::Elements((POINTS * 59) as u64));
    benchmark.bench_function("step", |bencher| {
        bencher.iter(|| {
            let update = Update { group: &mut group, gradient: Some(&gradient), learning_rate: 1e-3 };
            Adam::default().step(&mut [update]);
        })
    });
}

criterion_group!(benches, linear_layer, hexplane_field, photometric_loss, optimiser);
criterion_main!(benches);
