//! `gpu_bench DEVICE SPLATS SIZE`: the time of kernels on an adapter, and the minimum that its measured rates allow, as
//! JSON.
//!
//! A floor is the time for the data that a kernel must at least move and the arithmetic that it must at least do: every
//! input read once, every output written once, and the arithmetic of its definition. Every variant of summing pixels in
//! the backward pass of blending is timed, too. `ci/gpu-bench` and `ci/gpu-day` run this and more.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use shaders::adam::{Adam, Group, Update};
use shaders::check::noise;
use shaders::geometry::camera::PinholeCamera;
use shaders::gpu::{Gpu, GpuFailure, KernelCost, Rates};
use shaders::losses::l1::l1_dssim;
use shaders::networks::hexplane::{HexplaneShape, hexplane};
use shaders::networks::linear::{Activation, linear};
use shaders::rasteriser::blending::PixelSums;
use shaders::rasteriser::{self, RasterSettings, SplatTensors};
use shaders::tape::{Device, Tape, Tensor, Var};

/// Measured runs, after those that compile and warm up.
const RUNS: usize = 20;
/// Duration of the runs that warm up: an adapter that was idle, e.g. while the host drew numbers, first raises its clocks.
/// Runs upload nothing, because an adapter that waits for the host lowers them.
const WARM_UP: Duration = Duration::from_secs(1);
/// Bytes of a number.
const WORD: f64 = 4.0;

/// The radix sort with its scans.
const SORT: [&str; 6] = ["sort, counts", "sort, rows", "sort, scatter", "sort, starts", "scan", "scan, offsets"];

/// The backward pass of blending.
const BLEND_BACKWARD: [&str; 2] = ["blending backward", "blending, sums"];

/// The minimum work, in a run, of a kernel or of several kernels for one task.
struct Work {
    name: &'static str,
    kernels: Vec<&'static str>,
    /// Read and written.
    bytes: f64,
    flops: f64,
}

/// The measured work of a kernel in a run.
struct Row {
    work: Work,
    ms: f64,
    launches: u64,
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [device, splats, size] = &arguments[..] else { return usage() };
    let (Ok(splats), Ok(size)) = (splats.parse(), size.parse()) else { return usage() };
    let gpu = match Device::open(device).map(Device::gpu) {
        Ok(Some(gpu)) => gpu,
        Ok(None) => return usage(),
        Err(error) => {
            eprintln!("error: {error}");
            return ExitCode::FAILURE;
        }
    };
    // Before kernels are timed, which costs a wait per submission.
    let host = match catch_failures(|| host_secs_per_launch(gpu)) {
        Ok(secs) => secs,
        Err(code) => return code,
    };
    let is_timed = gpu.time_kernels();
    let rates = gpu.measure_rates();
    let run = || {
        let rows = [render(gpu, splats, size), dense(gpu, splats), losses(gpu, size), optimizer(gpu, splats)];
        (rows, backward_ways(gpu, splats, size))
    };
    let (benchmarks, ways) = match catch_failures(run) {
        Ok(measured) => measured,
        Err(code) => return code,
    };
    let rows: Vec<String> = benchmarks.iter().flatten().map(|row| row.json(&rates)).collect();
    println!("{{");
    println!("  \"adapter\": {:?}, \"timestamps\": {is_timed}, \"splats\": {splats}, \"size_px\": {size},", gpu.name());
    let Rates { copied_bytes_per_sec, flops_per_sec } = rates;
    println!("  \"copied_bytes_per_sec\": {copied_bytes_per_sec:.4e}, \"flops_per_sec\": {flops_per_sec:.4e},");
    println!("  \"host_us_per_launch\": {:.3},", 1e6 * host);
    let subgroup = gpu.subgroup_size().map_or("null".to_owned(), |size| size.to_string());
    println!("  \"subgroup_size\": {subgroup}, \"backward\": [\n{}\n  ],", ways.join(",\n"));
    println!("  \"kernels\": [\n{}\n  ]\n}}", rows.join(",\n"));
    ExitCode::SUCCESS
}

/// The result, unless the GPU fails.
fn catch_failures<R>(run: impl FnOnce() -> R) -> Result<R, ExitCode> {
    catch_unwind(AssertUnwindSafe(run)).map_err(|payload| match payload.downcast::<GpuFailure>() {
        Ok(failure) => {
            eprintln!("error: {failure}");
            ExitCode::FAILURE
        }
        Err(bug) => resume_unwind(bug),
    })
}

/// Seconds in which the host records and submits one launch of a step with small arrays: the least of several samples. They
/// begin on an idle GPU and fit into one submission, because drivers let a submission wait for earlier ones.
fn host_secs_per_launch(gpu: Gpu) -> f64 {
    const LAYERS: usize = 100;
    const STEPS: usize = 2;
    let inputs = [random(&[64, 8], 1, 1.0, 0.0), random(&[8, 8], 2, 0.1, 0.0), random(&[8], 3, 0.1, 0.0)];
    let step = || {
        let mut tape = Tape::<f32>::new(Device::Gpu(gpu));
        let [mut x, weights, bias] = [0, 1, 2].map(|index| tape.constant(inputs[index].clone()));
        for _ in 0..LAYERS {
            x = linear(&mut tape, x, weights, bias, Activation::Relu);
        }
    };
    let sample = || {
        let (before, started) = (gpu.counts(), Instant::now());
        (0..STEPS).for_each(|_| step());
        gpu.submit();
        let secs = started.elapsed().as_secs_f64();
        gpu.wait();
        secs / gpu.counts().since(before).launches as f64
    };
    (0..200).map(|_| sample()).fold(f64::INFINITY, f64::min)
}

fn usage() -> ExitCode {
    eprintln!("usage: gpu_bench DEVICE SPLATS SIZE, as gpu_bench gpu 200000 800; DEVICE is a GPU");
    ExitCode::FAILURE
}

impl Row {
    fn json(&self, rates: &Rates) -> String {
        let Row { work: Work { name, bytes, flops, .. }, ms, launches } = self;
        let floor_ms = 1e3 * rates.floor_secs(*bytes, *flops);
        format!(
            "    {{ \"kernel\": {name:?}, \"launches\": {launches}, \"ms\": {ms:.5}, \"bytes\": {bytes:.0}, \
             \"flops\": {flops:.0}, \"floor_ms\": {floor_ms:.5} }}"
        )
    }
}

/// The total cost of every kernel over a few runs, by name.
fn spent(gpu: Gpu, mut run: impl FnMut()) -> BTreeMap<String, KernelCost> {
    let started = Instant::now();
    loop {
        run();
        gpu.wait();
        if started.elapsed() >= WARM_UP {
            break;
        }
    }
    let before = gpu.usage();
    (0..RUNS).for_each(|_| run());
    gpu.wait();
    gpu.usage().since(&before).kernels
}

/// The mean cost of each kernel over a few runs.
fn measure(gpu: Gpu, works: Vec<Work>, run: impl FnMut()) -> Vec<Row> {
    let spent = spent(gpu, run);
    for (name, cost) in spent.iter().filter(|(name, _)| !works.iter().any(|work| work.kernels.contains(&name.as_str())))
    {
        eprintln!("in no row: {name}, {:.4} ms", 1e3 * cost.secs / RUNS as f64);
    }
    let row = |work: Work| {
        let mine = spent.iter().filter(|(name, _)| work.kernels.contains(&name.as_str()));
        let (secs, launches) = mine.fold((0.0, 0), |sum, (_, cost)| (sum.0 + cost.secs, sum.1 + cost.launches));
        Row { work, ms: 1e3 * secs / RUNS as f64, launches: launches / RUNS as u64 }
    };
    works.into_iter().map(row).collect()
}

fn random(shape: &[usize], seed: u64, factor: f64, offset: f64) -> Tensor<f32> {
    let values = noise(shape.iter().product(), seed).into_iter().map(|value| (offset + factor * value) as f32);
    Tensor::from_vec(shape, values.collect())
}

fn camera(size: usize) -> PinholeCamera {
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

/// A ball of splats, seen from outside.
fn ball(splats: usize) -> SplatTensors<f32> {
    SplatTensors {
        positions: random(&[splats, 3], 0, 1.0, 0.0),
        log_scales: random(&[splats, 3], 1, 0.8, -4.0),
        rotations: random(&[splats, 4], 2, 1.0, 0.0),
        opacity_logits: random(&[splats, 1], 3, 3.0, -1.0),
        sh: random(&[splats, 16, 3], 4, 0.2, 0.1),
    }
}

/// A run that renders a ball and differentiates the image.
fn step(gpu: Gpu, scene: SplatTensors<f32>, camera: PinholeCamera) -> impl FnMut() {
    let seed = Tensor::full([camera.height, camera.width, 3], 1e-3);
    move || {
        let mut tape = Tape::new(Device::Gpu(gpu));
        let vars = scene.leaves(&mut tape);
        let rendered =
            rasteriser::render(&mut tape, &vars, None, &camera, &RasterSettings::default()).expect("it fits");
        tape.backward(&[(rendered.color, seed.clone())]);
    }
}

/// Every variant of the backward pass of blending that the adapter supports, as JSON.
fn backward_ways(gpu: Gpu, splats: usize, size: usize) -> Vec<String> {
    let mut run = step(gpu, ball(splats), camera(size));
    let possible = PixelSums::ALL.into_iter().filter(|way| way.is_possible(gpu));
    let mut ms = |way| {
        PixelSums::choose(Some(way));
        let spent = spent(gpu, &mut run);
        let secs: f64 = BLEND_BACKWARD.iter().filter_map(|kernel| spent.get(*kernel)).map(|cost| cost.secs).sum();
        1e3 * secs / RUNS as f64
    };
    let row = |way| {
        let is_own = way == PixelSums::of(gpu);
        format!("    {{ \"sums\": \"{way:?}\", \"ms\": {:.5}, \"is_used\": {is_own} }}", ms(way))
    };
    let rows = possible.map(row).collect();
    PixelSums::choose(None);
    rows
}

/// The kernels of a rendered and differentiated ball.
fn render(gpu: Gpu, splats: usize, size: usize) -> Vec<Row> {
    let scene = ball(splats);
    let (camera, settings) = (camera(size), RasterSettings::default());
    let stats = {
        let mut tape = Tape::new(Device::Cpu);
        let vars = scene.constants(&mut tape);
        rasteriser::render(&mut tape, &vars, None, &camera, &settings).expect("it fits").stats()
    };
    let entries = stats.intersections as f64;
    let (count, pixels) = (splats as f64, (size * size) as f64);
    // Per splat: position, scales, rotation, opacity, 48 harmonics; and means, conic, depth, opacity, colour, cutoff.
    let (parameters, projected) = (59.0 * WORD, 11.0 * WORD);
    // Per pair of a pixel and a splat that it blends: offset, exponent, alpha, three colours; backward about
    // three times that. The backward pass reads an image and its gradient, and has no gradients of depths and cutoffs.
    let pairs = stats.blended_pixel_splats.expect("counted on the CPU") as f64;
    let (seen, image) = (count * projected + entries * WORD, pixels * 4.0 * WORD);
    let seen_backward = seen + 2.0 * image + count * 9.0 * WORD;
    let lists = [&SORT[..], &["binning, counts", "binning, ranks", "binning, hits", "binning, entries"]].concat();
    let work = |name, kernels, bytes, flops| Work { name, kernels, bytes, flops };
    let works = vec![
        work("projection", vec!["projection"], count * (parameters + projected), count * 500.0),
        work(
            "projection backward",
            vec!["projection backward"],
            count * (2.0 * parameters + projected),
            count * 1500.0,
        ),
        work("binning with its sort", lists, count * projected + 4.0 * entries * WORD, 0.0),
        work("blending", vec!["blending, records", "blending"], seen + image, pairs * 20.0),
        work("blending backward", BLEND_BACKWARD.to_vec(), seen_backward, pairs * 60.0),
    ];
    measure(gpu, works, step(gpu, scene, camera))
}

/// A layer and a field at N points, forward and backward.
fn dense(gpu: Gpu, points: usize) -> Vec<Row> {
    const WIDTH: usize = 64;
    let shape = HexplaneShape { channels: 32, resolution: [64, 64, 64, 75], multipliers: vec![1, 2] };
    let layer =
        [random(&[points, WIDTH], 1, 1.0, 0.0), random(&[WIDTH, WIDTH], 2, 0.1, 0.0), random(&[WIDTH], 3, 0.1, 0.0)];
    let planes: Vec<Tensor<f32>> = shape.plane_shapes().iter().map(|plane| random(plane, 5, 0.1, 1.0)).collect();
    let positions = random(&[points, 3], 6, 1.0, 0.0);
    let (count, width) = (points as f64, WIDTH as f64);
    let texels: f64 = planes.iter().map(|plane| plane.len() as f64).sum();
    let features = shape.features() as f64;
    let field_backward =
        [&SORT[..], &["hexplane backward", "hexplane, cells", "hexplane, blocks", "hexplane, texels"]].concat();
    let work = |name, kernels, numbers: f64, flops| Work { name, kernels, bytes: numbers * WORD, flops };
    let works = vec![
        // The value, and the gradients of inputs and of weights.
        work("linear", vec!["linear", "products, parts"], 5.0 * count * width, 3.0 * 2.0 * count * width * width),
        work("hexplane", vec!["hexplane"], texels + count * (3.0 + features), count * features * 60.0),
        work("hexplane backward", field_backward, 2.0 * texels + count * (6.0 + features), count * features * 150.0),
    ];
    let seeds = [WIDTH, shape.features()].map(|width| Tensor::full([points, width], 1.0));
    measure(gpu, works, || {
        let mut tape = Tape::new(Device::Gpu(gpu));
        let [x, weight, bias] = layer.clone().map(|tensor| tape.leaf(tensor));
        let planes: Vec<Var> = planes.iter().map(|plane| tape.leaf(plane.clone())).collect();
        let positions = tape.leaf(positions.clone());
        let layer = linear(&mut tape, x, weight, bias, Activation::Relu);
        let field = hexplane(&mut tape, &planes, positions, 0.3);
        tape.backward(&[(layer, seeds[0].clone()), (field, seeds[1].clone())]);
    })
}

/// The photometric loss of an image.
fn losses(gpu: Gpu, size: usize) -> Vec<Row> {
    let images = [random(&[size, size, 3], 7, 0.5, 0.5), random(&[size, size, 3], 8, 0.5, 0.5)];
    let numbers = (3 * size * size) as f64;
    let work = |name, kernels, touched: f64, flops: f64| Work {
        name,
        kernels,
        bytes: touched * numbers * WORD,
        flops: flops * numbers,
    };
    let works = vec![
        // Five moments by two passes of eleven taps; the windows' own gradients are written for the backward pass.
        work("ssim", vec!["ssim"], 5.0, 5.0 * 2.0 * 2.0 * 11.0 + 40.0),
        work("ssim backward", vec!["ssim backward"], 6.0, 3.0 * 2.0 * 2.0 * 11.0 + 10.0),
    ];
    let seed = Tensor::full([1], 1.0);
    measure(gpu, works, || {
        let mut tape = Tape::new(Device::Gpu(gpu));
        let (render, truth) = (tape.leaf(images[0].clone()), tape.constant(images[1].clone()));
        let loss = l1_dssim(&mut tape, render, truth, 0.2);
        tape.backward(&[(loss, seed.clone())]);
    })
}

/// A step of the optimiser on the harmonics of all splats.
fn optimizer(gpu: Gpu, splats: usize) -> Vec<Row> {
    let mut group = Group::new("harmonics", random(&[splats, 48], 9, 1.0, 0.0));
    let gradient = {
        // The results of a backward pass on the GPU.
        let mut tape = Tape::new(Device::Gpu(gpu));
        let x = tape.leaf(random(&[splats, 48], 10, 1e-3, 0.0));
        let y = shaders::pointwise::square(&mut tape, x);
        tape.backward(&[(y, Tensor::full([splats, 48], 1.0))]).take(x).expect("it has one")
    };
    let numbers = (48 * splats) as f64;
    let works = vec![Work { name: "adam", kernels: vec!["adam"], bytes: 7.0 * numbers * WORD, flops: numbers * 12.0 }];
    measure(gpu, works, || {
        let update = Update { group: &mut group, gradient: Some(&gradient), learning_rate: 1e-3 };
        Adam::default().step(&mut [update]);
    })
}
