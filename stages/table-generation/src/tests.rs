//! Reports of synthetic runs: structure, rules, snapshots of the text, and planted faults.

mod content;
mod degenerate;
mod formats;
mod influence;
mod outcomes;
mod page;
mod papers;
mod seeds;
mod stage;

use std::collections::BTreeMap;

use engine::FailureKind;
use metric_evaluation::{MaskName, MeanImage, MeanOver, Metric, Score, Trivial};
use scene::Protocol;

use crate::collect::{CurvePoint, FrameScore, Job, Machine, Run, RunFailure};
use crate::column::Column;
use crate::library;
use crate::params::TableGenerationParams;
use crate::report::Report;

/// The protocol of D-NeRF with images of `size` px.
fn protocol(size: u32) -> Protocol {
    Protocol {
        dataset: "dnerf".into(),
        split: "official".into(),
        width: size,
        height: size,
        resize: if size == 800 { "none" } else { "area" }.into(),
        background: "white".into(),
        time: "file time".into(),
    }
}

/// PSNR of the best constant image in every scene, dB.
const CONSTANT_PSNR: f64 = 15.0;

/// The scores of images that need no model.
fn trivial() -> Trivial {
    Trivial {
        colour: [0.9; 3],
        constant_psnr: CONSTANT_PSNR,
        mean_image: Some(MeanImage { psnr: 16.5, over: MeanOver::AllImages }),
        background_share: Some(0.93),
        without_motion: BTreeMap::from([(Metric::VelocityError, 1.5)]),
        moving_mean_image: BTreeMap::from([(Metric::PsnrMoving, 12.5)]),
        masked_mean_image: BTreeMap::from([(MaskName::Foreground, BTreeMap::from([(Metric::MaskedPsnr, 11.25)]))]),
        least_render_variance: 0.01,
    }
}

/// A run with measurements at 800 px.
fn run(scene: &str, method: &str, seed: u32, psnr: f64) -> Run {
    let values = [
        (Column::PSNR, psnr),
        (Column::Metric(Metric::Ssim), 0.9 + psnr / 1000.0),
        (Column::TrainingSecs, 100.0 + psnr),
        (Column::Gaussians, 12345.0),
        (Column::SizeMb, 2.5),
        (Column::FpsModel, 50.0),
        (Column::AboveConstant, psnr - CONSTANT_PSNR),
    ];
    let mut run = Run {
        scene: scene.into(),
        row: method.into(),
        method: method.into(),
        seed: seed.to_string(),
        protocol: Some(protocol(800)),
        judged_by: Some("test images · 8-bit levels (rounded) · per-image means · metric version 1".into()),
        figures: values.into_iter().map(|(column, value)| (column, Score::Value(value))).collect(),
        phases: [("blend".to_owned(), 30.0), ("custom".to_owned(), 2.0)].into(),
        machines: [("training".to_owned(), machine("Processor 1"))].into(),
        jobs: [("model".to_owned(), job("train", scene, method, seed))].into(),
        schedule_scale: Some(1.0),
        frames: (0..4).map(|i| frame(i, psnr)).collect(),
        trivial: Some(trivial()),
        ..Run::default()
    };
    run.figures.insert(Column::Metric(Metric::MsSsim), Score::undefined("image smaller than 161 px"));
    run.figures.insert(Column::Metric(Metric::LpipsAlex), Score::undefined("no weights"));
    run.set_curve((0..6).map(|i| point(f64::from(i), psnr)).collect());
    run
}

/// A machine with a processor of this name.
fn machine(cpu: &str) -> Machine {
    Machine { device: "cpu".into(), threads: Some(2), cpu: Some(cpu.into()), ..Machine::default() }
}

fn job(node: &str, scene: &str, method: &str, seed: u32) -> Job {
    let key = "0123456789ab".into();
    Job { name: format!("{node}/{scene}/{method}/{seed}"), key, wall_secs: Some(12.0) }
}

/// Frame `i`; the third frame is 3 dB below `psnr`, all others 1 dB above it.
fn frame(i: u32, psnr: f64) -> FrameScore {
    let psnr = if i == 2 { psnr - 3.0 } else { psnr + 1.0 };
    FrameScore { name: format!("test_{i}"), time_secs: Some(f64::from(i) / 4.0), psnr }
}

/// Point `i` of a curve that approaches `psnr`.
fn point(i: f64, psnr: f64) -> CurvePoint {
    let psnr_val = Some(psnr * (1.0 - 0.5 * (-i).exp()));
    CurvePoint { seconds: 20.0 * i, iteration: 100 * i as u64, n_gaussians: 10, psnr_val }
}

/// A run whose training failed.
fn failed(scene: &str, method: &str, seed: u32, kind: FailureKind) -> Run {
    let (row, seed) = (method.to_owned(), seed.to_string());
    let failure =
        RunFailure { producer: format!("train/{scene}/{method}/{seed}"), kind, message: format!("{scene} went wrong") };
    Run { scene: scene.into(), method: row.clone(), row, seed, failure: Some(failure), ..Run::default() }
}

fn report(runs: Vec<Run>) -> Report {
    let report = Report::new(runs, &library::claims().expect("valid claims"), &TableGenerationParams::default());
    report.check().expect("a valid report");
    report
}

/// Two methods on two scenes with two seeds.
fn two_by_two() -> Vec<Run> {
    let mut runs = Vec::new();
    for (seed, shift) in [(0, 0.0), (1, 0.2)] {
        runs.push(run("bouncingballs", "static3dgs", seed, 25.0 + shift));
        runs.push(run("bouncingballs", "deformable4dgs", seed, 40.5 + shift));
        runs.push(run("trex", "static3dgs", seed, 23.0 + shift));
        runs.push(run("trex", "deformable4dgs", seed, 33.0 + shift));
    }
    runs
}
