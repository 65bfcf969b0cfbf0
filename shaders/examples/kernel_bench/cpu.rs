//! Measurements on the CPU.

use std::hint::black_box;
use std::time::Instant;

use rayon::prelude::*;
use shaders::gpu::Rates;
use shaders::networks::linear::{Activation, linear};
use shaders::rasteriser::Isa;
use shaders::tape::{Device, Profile, Tape};

use crate::Report;
use crate::scenes::{self, random};
use crate::work::{self, LAYER, RUNS, Row, SSIM, Work};

pub(crate) fn report(splats: usize, size: usize) -> Report {
    let rates = rates();
    let cpu = Device::Cpu;
    let rows = [
        measure(rates, work::render(splats, size), scenes::render(cpu, splats, size)),
        measure(rates, work::dense(splats), scenes::dense(cpu, splats)),
        measure(rates, work::losses(size), scenes::losses(cpu, size)),
        optimizer(rates, splats),
    ];
    let Rates { copied_bytes_per_sec, flops_per_sec } = rates;
    let about = vec![
        ("adapter", format!("\"cpu, {} threads, {:?}\"", rayon::current_num_threads(), Isa::best())),
        ("copied_bytes_per_sec", format!("{copied_bytes_per_sec:.4e}")),
        ("flops_per_sec", format!("{flops_per_sec:.4e}")),
    ];
    Report { about, rows: rows.into_iter().flatten().collect() }
}

/// The rate of copies between arrays that fit into the last-level cache, as most arrays of a step do, and that of a product of
/// large matrices.
fn rates() -> Rates {
    /// 4 MiB per array, copied in parts of 512 KiB.
    const NUMBERS: usize = 1 << 20;
    const PART: usize = 1 << 17;
    /// Enough arithmetic per number read that memory does not limit the product.
    const ROWS: usize = 8192;
    const FEATURES: usize = 512;
    let (source, mut target) = (vec![1.0_f32; NUMBERS], vec![0.0_f32; NUMBERS]);
    let copy_secs = fastest_secs(|| {
        target.par_chunks_mut(PART).zip(source.par_chunks(PART)).for_each(|(to, from)| to.copy_from_slice(from));
        black_box(&target);
    });
    let shapes = [&[ROWS, FEATURES][..], &[FEATURES, FEATURES], &[FEATURES]];
    let inputs = shapes.map(|shape| random(shape, 0, 1.0, 0.0));
    let product_secs = fastest_secs(|| {
        let mut tape = Tape::<f32>::new(Device::Cpu);
        let [x, weights, bias] = inputs.clone().map(|tensor| tape.constant(tensor));
        linear(&mut tape, x, weights, bias, Activation::Identity);
    });
    Rates {
        copied_bytes_per_sec: (2 * size_of::<f32>() * NUMBERS) as f64 / copy_secs,
        flops_per_sec: (2 * ROWS * FEATURES * FEATURES) as f64 / product_secs,
    }
}

/// The seconds of the fastest run, because no disturbance makes a run faster.
fn fastest_secs(mut run: impl FnMut()) -> f64 {
    let secs = (0..RUNS).map(|_| {
        let started = Instant::now();
        run();
        started.elapsed().as_secs_f64()
    });
    secs.fold(f64::INFINITY, f64::min)
}

/// The mean time of each task, after a run that warms up.
fn measure(rates: Rates, works: Vec<Work>, mut run: impl FnMut() -> Tape<f32>) -> Vec<Row> {
    run();
    let mut spent = Profile::default();
    (0..RUNS).for_each(|_| spent.merge(run().profile()));
    let secs = |task: &str| {
        let (name, is_backward) = task.strip_suffix(" backward").map_or((task, false), |name| (name, true));
        let cost = spent.ops.get(name).unwrap_or_else(|| panic!("no operation {name}"));
        let forward = if is_backward { 0.0 } else { cost.forward.secs };
        let backward = if is_backward || [LAYER, SSIM].contains(&task) { cost.backward.secs } else { 0.0 };
        (forward + backward) / RUNS as f64
    };
    let row = |work: Work| {
        let secs = secs(work.task);
        work.took(secs, None, rates)
    };
    works.into_iter().map(row).collect()
}

fn optimizer(rates: Rates, splats: usize) -> Vec<Row> {
    let mut step = scenes::optimizer(Device::Cpu, splats);
    step();
    let started = Instant::now();
    (0..RUNS).for_each(|_| step());
    let secs = started.elapsed().as_secs_f64() / RUNS as f64;
    work::optimizer(splats).into_iter().map(|work| work.took(secs, None, rates)).collect()
}
