//! Cost of rendering 20 000 splats: milliseconds per phase, and nominal (pixel, splat) pairs per second of blending, i.e.
//! 256 pixels for each splat of each tile. `RAYON_NUM_THREADS=1` measures one core.

#[path = "../examples/kernel_bench/scenes.rs"]
#[allow(dead_code)]
mod scenes;

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use scenes::{ball, camera};
use shaders::rasteriser::binning::{self, Grid, Lists};
use shaders::rasteriser::blending;
use shaders::rasteriser::projection;
use shaders::rasteriser::{Isa, ProjectedVars, RasterSettings, SplatVars};
use shaders::tape::{Device, Tape, Tensor};

const SPLATS: usize = 20_000;

/// A tape that ends where blending begins.
struct Prepared {
    tape: Tape<f32>,
    splats: SplatVars,
    projected: ProjectedVars,
    lists: Arc<Lists>,
}

fn prepare(size: usize) -> Prepared {
    let mut tape = Tape::new(Device::Cpu);
    let splats = ball(SPLATS).leaves(&mut tape);
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
    let scene = ball(SPLATS);
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
