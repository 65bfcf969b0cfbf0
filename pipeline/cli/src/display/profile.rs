//! `--profile`: prints where the steps of each training spend their time.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

use engine::status::{Prediction, State};
use serde::Deserialize;

use crate::error::CliError;
use crate::output;
use crate::session::{Session, TRAINING};

/// The measurements of a training that concern its steps.
#[derive(Deserialize)]
struct Measured {
    device: String,
    ms_per_iteration: f64,
    /// Milliseconds per call of each operation, forward and backward, by the host's clock.
    kernels_ms: BTreeMap<String, [f64; 2]>,
    gpu: Option<GpuUse>,
}

/// Use of the GPU per iteration.
#[derive(Deserialize)]
struct GpuUse {
    launches: f64,
    submissions: f64,
    readbacks: f64,
    bytes_read: f64,
    uploads: f64,
    bytes_uploaded: f64,
    kernels: BTreeMap<String, KernelUse>,
}

#[derive(Deserialize)]
struct KernelUse {
    launches: f64,
    ms_per_launch: Option<f64>,
}

/// Prints a table for each selected training that has a result.
pub(crate) fn print(session: &Session) -> Result<(), CliError> {
    let trains = |index: &usize| session.plan.nodes[*index].stage == TRAINING;
    let needed = session.plan.with_ancestors(&session.targets);
    let trainings: BTreeSet<usize> = needed.into_iter().filter(trains).collect();
    for (index, Prediction { state, .. }) in session.predict_for(&trainings)? {
        if let (true, State::Cached { record }) = (trainings.contains(&index), state) {
            let measured = session.store.read_measurements(&record.measurements)?;
            let measured = Measured::deserialize(measured).map_err(|error| CliError::Other(error.into()))?;
            output::print(&table(&session.plan.nodes[index].name, &measured))?;
        }
    }
    Ok(())
}

fn table(job: &str, measured: &Measured) -> String {
    let Measured { device, ms_per_iteration, .. } = measured;
    let mut text = format!("\n**{job} on {device}: {ms_per_iteration:.2} ms per iteration**\n\n");
    match &measured.gpu {
        None => operations(&mut text, &measured.kernels_ms),
        Some(gpu) => kernels(&mut text, gpu),
    }
    text
}

fn operations(text: &mut String, operations: &BTreeMap<String, [f64; 2]>) {
    text.push_str("| operation | forward (ms per call) | backward (ms per call) |\n| --- | ---: | ---: |\n");
    let mut rows: Vec<_> = operations.iter().collect();
    rows.sort_by(|(_, a), (_, b)| b.iter().sum::<f64>().total_cmp(&a.iter().sum()));
    for (name, [forward, backward]) in rows {
        let _ = writeln!(text, "| {name} | {forward:.3} | {backward:.3} |");
    }
}

fn kernels(text: &mut String, gpu: &GpuUse) {
    let GpuUse { launches, submissions, readbacks, bytes_read, uploads, bytes_uploaded, kernels } = gpu;
    let _ = writeln!(
        text,
        "Per iteration {launches:.1} launches in {submissions:.1} submissions, {readbacks:.1} readbacks of \
         {bytes_read:.0} bytes, {uploads:.1} uploads of {bytes_uploaded:.0} bytes.\n"
    );
    text.push_str(
        "| kernel | launches per iteration | ms per launch | ms per iteration |\n| --- | ---: | ---: | ---: |\n",
    );
    let mut rows: Vec<_> = kernels.iter().collect();
    let cost = |kernel: &KernelUse| (kernel.launches * kernel.ms_per_launch.unwrap_or(0.0), kernel.launches);
    rows.sort_by(|(_, a), (_, b)| cost(b).partial_cmp(&cost(a)).expect("both are finite"));
    for (name, kernel) in rows {
        let shown = |ms: Option<f64>| ms.map_or_else(|| "–".to_owned(), |ms| format!("{ms:.4}"));
        let (each, all) = (kernel.ms_per_launch, kernel.ms_per_launch.map(|ms| ms * kernel.launches));
        let _ = writeln!(text, "| {name} | {:.2} | {} | {} |", kernel.launches, shown(each), shown(all));
    }
}
