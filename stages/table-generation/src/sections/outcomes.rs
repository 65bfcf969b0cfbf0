//! Outcome of every run: its last step or failure, its gain over the baseline, its largest gradient, and the guards that fired.

use engine::FailureKind;

use super::content::Content;
use crate::collect::{Run, TensorGradient, failure_mark, is_whole};
use crate::column::Column;
use crate::distinct::distinct;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, signed};
use crate::pairs::differing;

/// The table of outcomes, if the recipe requests it or a training diverged.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let diverged = |run: &Run| run.failure.as_ref().is_some_and(|failure| failure.kind == FailureKind::Diverged);
    if !content.params.hard_cases && !content.report.runs.iter().any(diverged) {
        return Vec::new();
    }
    vec![Block::Table(outcome_table(content))]
}

/// One line per run, below a heading per scene.
fn outcome_table(content: &Content<'_>) -> Table {
    let baseline = &content.params.baseline;
    let gain = format!("gain over {baseline} (dB)");
    let header = ["method", "outcome", "where", "guards that fired", &gain, "largest gradient"].map(String::from);
    let mut table = Table::new("Outcome of every run", header.into()).with_text_columns(4);
    let runs = || content.report.runs.iter().filter(|run| !run.misses_data());
    let one_seed = distinct(runs().map(|run| run.seed.as_str())).len() == 1;
    for scene in distinct(runs().map(|run| run.scene.as_str())) {
        table.rows.push(vec![Text::plain(&scene)]);
        for run in runs().filter(|run| run.scene == scene) {
            let seed = if one_seed { String::new() } else { format!(", seed {}", run.seed) };
            let name = Text::plain(format!("{}{seed}", run.row)).linked(content.traces.scene(&run.row, &scene));
            let gradient =
                run.largest_gradient.as_ref().map_or(NONE.into(), |g| format!("{:.1e}", g.largest.magnitude));
            let cells = [outcome(run), place(run), guards(run), gain_text(content, run), gradient];
            table.rows.push([name].into_iter().chain(cells.map(Text::plain)).collect());
        }
    }
    table.remarks.push(
        "Where: for a failed run the message of the failure, for a degenerate one the reason; otherwise tensor and iteration of the largest gradient. \
         Guards: how often the rasteriser clamped a value, summed over all renders of the training. Neither includes a \
         shared first phase, because both are counted from the last start of the training."
            .into(),
    );
    table
}

fn outcome(run: &Run) -> String {
    match &run.failure {
        None => run.outcome().into(),
        Some(failure) if failure.kind == FailureKind::Diverged => "diverged".into(),
        Some(failure) => format!("failed: {}", failure_mark(failure.kind)),
    }
}

/// The message of the failure, why the run is degenerate, or tensor and iteration of the largest gradient.
fn place(run: &Run) -> String {
    let of_gradient = || {
        let TensorGradient { tensor, largest } = run.largest_gradient.as_ref()?;
        Some(format!("{tensor}, iteration {} of {}", largest.iteration, largest.phase))
    };
    let of_failure = run.failure.as_ref().map(|failure| failure.message.clone());
    let of_degenerate = || run.degenerate.as_ref().map(|degenerate| degenerate.message.clone());
    of_failure.or_else(of_degenerate).or_else(of_gradient).unwrap_or_else(|| NONE.into())
}

fn guards(run: &Run) -> String {
    let fired: Vec<String> = run.guards.iter().map(|(what, times)| format!("{what} ×{times}")).collect();
    if fired.is_empty() { NONE.into() } else { fired.join(", ") }
}

/// Gain in PSNR over the baseline on the same scene with the same seed, protocol and metric definitions.
fn gain_text(content: &Content<'_>, run: &Run) -> String {
    let is_baseline = |other: &&Run| {
        other.method == content.params.baseline
            && is_whole(other.variant.as_deref())
            && (&other.scene, &other.seed) == (&run.scene, &run.seed)
            && (&other.protocol, &other.judged_by) == (&run.protocol, &run.judged_by)
    };
    let sound = |run: &Run| run.degenerate.is_none();
    let psnr = |run: &Run| run.figures.get(&Column::PSNR)?.value().filter(|psnr| psnr.is_finite() && sound(run));
    let baselines = content.report.runs.iter().filter(is_baseline);
    let baseline = baselines.min_by_key(|other| differing(&run.axes, &other.axes));
    let gain = || Some(psnr(run)? - psnr(baseline?)?);
    if run.method == content.params.baseline {
        return NONE.into();
    }
    gain().map_or(NONE.into(), |gain| signed(gain, Column::PSNR.decimals()))
}
