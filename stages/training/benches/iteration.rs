//! Milliseconds per training iteration, split by activity, at 20 000 Gaussians and 200×200 pixels.

use std::collections::BTreeMap;
use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use glam::DVec3;
use image::RgbImage;
use scene::{Camera, Capture, CaptureInfo, CaptureWriter, Frame, Intrinsics, Protocol, Split, TimeMap};
use serde_json::json;
use training::{Dataset, NOTHING, Trainer, TrainingParams};

/// The allocator of the `pipeline` binary: the system's allocator returns tens of megabytes per step to the kernel.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const SIZE: u32 = 200;
const GAUSSIANS: usize = 20_000;
const VIEWS: usize = 8;
/// Iterations averaged in the table of activities.
const TABLE_ITERATIONS: u64 = 50;

fn iterations(criterion: &mut Criterion) {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dataset = Dataset::load(capture(dir.path()).expect("a capture"), 1).expect("its images");
    for method in ["static3dgs", "deformable4dgs"] {
        // The fine phase alone, with a fixed number of Gaussians and all harmonics after the first iterations.
        let params: TrainingParams = serde_json::from_value(json!({
            "method": method,
            "iterations": if method == "static3dgs" { json!({ "train": 1_000_000 }) } else { json!({ "coarse": 0, "fine": 1_000_000 }) },
            "initial_points": { "random_count": GAUSSIANS },
            "harmonics": { "interval": 1 },
            "density": { "until": 0 },
            "curve": { "points": 0 },
        }))
        .expect("valid parameters");
        let mut trainer = Trainer::new(&dataset, &NOTHING, &params).expect("a trainer");
        criterion.bench_function(&format!("{method} iteration at 20k Gaussians, 200×200"), |bencher| {
            bencher.iter(|| trainer.advance().expect("a finite step"));
        });
        print_table(method, &mut trainer);
        black_box(trainer.steps());
    }
}

/// Milliseconds per iteration and activity over the next iterations.
fn print_table(method: &str, trainer: &mut Trainer<'_>) {
    let before = trainer.report().phases;
    (0..TABLE_ITERATIONS).for_each(|_| trainer.advance().expect("a finite step"));
    let after = trainer.report();
    let spent: BTreeMap<_, _> =
        after.phases.iter().map(|(name, secs)| (name, secs - before.get(name).unwrap_or(&0.0))).collect();
    println!("{method}: ms per iteration by activity");
    for (name, secs) in spent {
        println!("  {name:12} {:7.2}", 1e3 * secs / TABLE_ITERATIONS as f64);
    }
    for (name, [forward, backward]) in &after.kernels_ms {
        println!("    {name:24} {forward:7.2} forward {backward:7.2} backward");
    }
}

/// Writes a capture of smooth colours, viewed from a circle of cameras.
fn capture(dir: &std::path::Path) -> scene::Result<Capture> {
    let protocol = Protocol {
        dataset: "benchmark".into(),
        split: "official".into(),
        width: SIZE,
        height: SIZE,
        resize: "none".into(),
        background: "white".into(),
        time: "analytic".into(),
    };
    let info = CaptureInfo {
        name: "benchmark".into(),
        pose_source: "analytic".into(),
        protocol,
        background: [1.0; 3],
        time_map: TimeMap { start_secs: 0.0, end_secs: 1.0, frame_secs: 1.0 / (VIEWS - 1) as f64 },
        class_names: Vec::new(),
        bounds_world: Some([[-1.3; 3], [1.3; 3]]),
    };
    let writer = CaptureWriter::create(dir, info)?;
    let half = 0.5 * f64::from(SIZE);
    let focal = 277.8;
    let intrinsics =
        Intrinsics { width: SIZE, height: SIZE, focal_x: focal, focal_y: focal, center_x: half, center_y: half };
    for at in 0..VIEWS {
        let angle = std::f64::consts::TAU * at as f64 / VIEWS as f64;
        let position = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0);
        let camera = Camera::look_at(intrinsics, position, DVec3::ZERO, DVec3::Z);
        let image = RgbImage::from_fn(SIZE, SIZE, |x, y| image::Rgb([x as u8, y as u8, 30 * at as u8]));
        writer.write_view(&Frame {
            name: format!("view_{at}"),
            split: Split::Train,
            camera,
            camera_index: 0,
            frame_index: at as u32,
            time_secs: at as f64 / (VIEWS - 1) as f64,
            image,
            alpha: None,
            depth: None,
            flow: None,
            mask: None,
            velocity: None,
        })?;
    }
    writer.finish()
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = iterations
}
criterion_main!(benches);
