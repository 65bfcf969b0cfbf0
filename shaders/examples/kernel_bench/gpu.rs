//! Measurements on a GPU.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::time::{Duration, Instant};

use shaders::gpu::{Gpu, GpuFailure, KernelCost, Rates};
use shaders::networks::linear::{Activation, linear};
use shaders::rasteriser::blending::PixelSums;
use shaders::tape::{Device, Tape};

use crate::Report;
use crate::scenes::{self, random};
use crate::work::{self, RUNS, Row, Work};

/// Duration of the runs that warm up: an adapter that was idle, e.g. while the host drew numbers, first raises its clocks.
/// Runs upload nothing, because an adapter that waits for the host lowers them.
const WARM_UP: Duration = Duration::from_secs(1);

/// The radix sort with its scans.
const SORT: [&str; 6] = ["sort, counts", "sort, rows", "sort, scatter", "sort, starts", "scan", "scan, offsets"];

/// The kernels of a task.
fn kernels(task: &str) -> Vec<&str> {
    match task {
        "binning" => [&SORT[..], &["binning, counts", "binning, ranks", "binning, hits", "binning, entries"]].concat(),
        "blending" => vec!["blending, records", "blending"],
        "blending backward" => vec!["blending backward", "blending, sums"],
        work::LAYER => vec!["linear", "products, parts"],
        work::SSIM => vec!["ssim", "ssim backward"],
        "hexplane backward" => {
            [&SORT[..], &["hexplane backward", "hexplane, cells", "hexplane, blocks", "hexplane, texels"]].concat()
        }
        _ => vec![task],
    }
}

pub(crate) fn report(gpu: Gpu, splats: usize, size: usize) -> Result<Report, String> {
    catch_unwind(AssertUnwindSafe(|| measured(gpu, splats, size))).map_err(|payload| {
        match payload.downcast::<GpuFailure>() {
            Ok(failure) => failure.to_string(),
            Err(bug) => resume_unwind(bug),
        }
    })
}

fn measured(gpu: Gpu, splats: usize, size: usize) -> Report {
    // Before kernels are timed, which costs a wait per submission.
    let host = host_secs_per_launch(gpu);
    let is_timed = gpu.time_kernels();
    let rates = gpu.measure_rates();
    let device = Device::Gpu(gpu);
    let rows = [
        measure(gpu, rates, work::render(splats, size), scenes::render(device, splats, size)),
        measure(gpu, rates, work::dense(splats), scenes::dense(device, splats)),
        measure(gpu, rates, work::losses(size), scenes::losses(device, size)),
        measure(gpu, rates, work::optimizer(splats), scenes::optimizer(device, splats)),
    ];
    let ways = backward_ways(gpu, splats, size);
    let Rates { copied_bytes_per_sec, flops_per_sec } = rates;
    let about = vec![
        ("adapter", format!("{:?}", gpu.name())),
        ("timestamps", is_timed.to_string()),
        ("copied_bytes_per_sec", format!("{copied_bytes_per_sec:.4e}")),
        ("flops_per_sec", format!("{flops_per_sec:.4e}")),
        ("host_us_per_launch", format!("{:.3}", 1e6 * host)),
        ("subgroup_size", gpu.subgroup_size().map_or("null".to_owned(), |size| size.to_string())),
        ("backward", format!("[\n{}\n  ]", ways.join(",\n"))),
    ];
    Report { about, rows: rows.into_iter().flatten().collect() }
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

/// The total cost of every kernel over a few runs, by name.
fn spent<R>(gpu: Gpu, mut run: impl FnMut() -> R) -> BTreeMap<String, KernelCost> {
    let started = Instant::now();
    loop {
        run();
        gpu.wait();
        if started.elapsed() >= WARM_UP {
            break;
        }
    }
    let before = gpu.usage();
    (0..RUNS).for_each(|_| drop(run()));
    gpu.wait();
    gpu.usage().since(&before).kernels
}

/// The mean cost of each task over a few runs.
fn measure<R>(gpu: Gpu, rates: Rates, works: Vec<Work>, run: impl FnMut() -> R) -> Vec<Row> {
    let spent = spent(gpu, run);
    let is_named = |name: &str| works.iter().any(|work| kernels(work.task).contains(&name));
    for (name, cost) in spent.iter().filter(|(name, _)| !is_named(name)) {
        eprintln!("in no row: {name}, {:.4} ms", 1e3 * cost.secs / RUNS as f64);
    }
    let row = |work: Work| {
        let kernels = kernels(work.task);
        let mine = spent.iter().filter(|(name, _)| kernels.contains(&name.as_str()));
        let (secs, launches) = mine.fold((0.0, 0), |sum, (_, cost)| (sum.0 + cost.secs, sum.1 + cost.launches));
        work.took(secs / RUNS as f64, Some(launches / RUNS as u64), rates)
    };
    works.into_iter().map(row).collect()
}

/// Every variant of the backward pass of blending that the adapter supports, as JSON.
fn backward_ways(gpu: Gpu, splats: usize, size: usize) -> Vec<String> {
    let mut run = scenes::render(Device::Gpu(gpu), splats, size);
    let possible = PixelSums::ALL.into_iter().filter(|way| way.is_possible(gpu));
    let mut ms = |way| {
        PixelSums::choose(Some(way));
        let spent = spent(gpu, &mut run);
        let secs: f64 =
            kernels("blending backward").iter().filter_map(|kernel| spent.get(*kernel)).map(|cost| cost.secs).sum();
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
