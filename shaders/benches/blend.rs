//! Cost of rendering 20 000 splats: milliseconds per phase, and nominal (pixel, splat) pairs per second of blending, i.e.
//! 256 pixels for each splat of each tile. `RAYON_NUM_THREADS=1` measures one core.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use shaders::check::noise;
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::binning::{self, Grid, Lists};
use shaders::rasteriser::blending;
use shaders::rasteriser::projection;
use shaders::rasteriser::{Isa, ProjectedVars, RasterSettings, SplatTensors, SplatVars};
use shaders::tape::{Device, Tape, Tensor};

const SPLATS: usize = 20_000;

/// A ball of splats like those of a training at low resolution: standard deviations around a hundredth of the ball's
/// radius.
fn scene() -> SplatTensors<f32> {
    let random = |seed, len: usize, factor: f64, offset: f64| -> Vec<f32> {
        noise(SPLATS * len, seed).into_iter().map(|value| (offset + factor * value) as f32).collect()
    };
    SplatTensors {
        positions: Tensor::from_vec([SPLATS, 3], random(0, 3, 1.0, 0.0)),
        log_scales: Tensor::from_vec([SPLATS, 3], random(1, 3, 0.8, -4.0)),
        rotations: Tensor::from_vec([SPLATS, 4], random(2, 4, 1.0, 0.0)),
        opacity_logits: Tensor::from_vec([SPLATS, 1], random(3, 1, 3.0, -1.0)),
        sh: Tensor::from_vec([SPLATS, 16, 3], random(4, 48, 0.2, 0.1)),
    }
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

/// A tape that ends where blending begins.
struct Prepared {
    tape: Tape<f32>,
    splats: SplatVars,
    projected: ProjectedVars,
    lists: Arc<Lists>,
}

fn prepare(size: usize) -> Prepared {
    let mut tape = Tape::new(Device::Cpu);
    let splats = scene().leaves(&mut tape);
    let projected = projection::project(&mut tape, &splats, &camera(size), &RasterSettings::default());
    let lists = binning::bin(&mut tape, &projected, Grid { width: size, height: size }).expect("it fits");
    Prepared { tape, splats, projected, lists }
}

/// The projected splats on a separate tape, as leaves so that backward ends there, or as constants.
fn fresh_tape(prepared: &Prepared, with_gradients: bool) -> (Tape<f32>, ProjectedVars) {
    let mut tape = Tape::new(Device::Cpu);
    let mut copy = |var| {
        let value = prepared.tape.value(var).clone();
        if with_gradients { tape.leaf(value) } else { tape.constant(value) }
    };
    let ProjectedVars { means2d, conics, depths, opacities, colors, cutoffs } = prepared.projected;
    let projected = ProjectedVars {
        means2d: copy(means2d),
        conics: copy(conics),
        depths: copy(depths),
        opacities: copy(opacities),
        colors: copy(colors),
        cutoffs: copy(cutoffs),
    };
    (tape, projected)
}

fn blend(criterion: &mut Criterion) {
    for size in [200, 800] {
        let prepared = prepare(size);
        let intersections = prepared.lists.entry_count();
        println!("{size}×{size}: {} visible, {intersections} intersections", prepared.lists.visible_count());
        let mut group = criterion.benchmark_group(format!("blend {size}"));
        group.throughput(Throughput::Elements(256 * intersections as u64)).sample_size(20);
        for isa in Isa::available().into_iter().filter(|&isa| isa != Isa::Portable) {
            for depth in [false, true] {
                let settings = RasterSettings { isa, depth, ..RasterSettings::default() };
                let name = format!("{isa:?}{}", if depth { " + depth" } else { "" });
                group.bench_function(BenchmarkId::new("forward", &name), |bencher| {
                    bencher.iter(|| {
                        let (mut tape, projected) = fresh_tape(&prepared, false);
                        black_box(blending::blend(&mut tape, &projected, None, &prepared.lists, &settings))
                    });
                });
                group.bench_function(BenchmarkId::new("backward", &name), |bencher| {
                    let (mut tape, projected) = fresh_tape(&prepared, true);
                    let blended = blending::blend(&mut tape, &projected, None, &prepared.lists, &settings);
                    let outputs = [Some(blended.color), blended.depth].into_iter().flatten();
                    let seed = |var| (var, Tensor::full(tape.value(var).shape(), 1e-3_f32));
                    let seeds: Vec<_> = outputs.map(seed).collect();
                    bencher.iter(|| black_box(tape.backward(&seeds)));
                });
            }
        }
        group.finish();
    }
}

fn project_and_bin(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("20k splats, 800");
    group.sample_size(20);
    let settings = RasterSettings::default();
    let scene = scene();
    group.bench_function("projection forward", |bencher| {
        bencher.iter(|| {
            let mut tape = Tape::new(Device::Cpu);
            let splats = scene.constants(&mut tape);
            black_box(projection::project(&mut tape, &splats, &camera(800), &settings));
        });
    });
    let mut prepared = prepare(800);
    let ProjectedVars { means2d, conics, opacities, colors, .. } = prepared.projected;
    let seeds =
        [means2d, conics, opacities, colors].map(|var| (var, Tensor::full(prepared.tape.value(var).shape(), 1e-3_f32)));
    group.bench_function("projection backward", |bencher| {
        bencher.iter(|| black_box(prepared.tape.backward(&seeds).take(prepared.splats.positions)));
    });
    for size in [200, 800] {
        let prepared = prepare(size);
        group.bench_function(BenchmarkId::new("binning", size), |bencher| {
            bencher.iter(|| {
                let (mut tape, projected) = fresh_tape(&prepared, false);
                black_box(binning::bin(&mut tape, &projected, Grid { width: size, height: size }).expect("it fits"))
            });
        });
    }
    group.finish();
}

criterion_group!(benches, blend, project_and_bin);
criterion_main!(benches);
