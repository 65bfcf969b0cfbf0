//! Inputs and output folders of films and exports.

use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context as _, bail, ensure};
use engine::{Artifact as _, Failure, FailureKind};
use scene::{Capture, Split, View};
use training::Model;

/// Times outside the capture by at most this share of its duration are moved to its ends. It covers the rounding of a
/// manually typed range with four digits.
const TIME_SLACK: f64 = 1e-4;

/// Opens a model and checks it.
pub(crate) fn open_model(dir: &Path) -> anyhow::Result<Model> {
    let model = Model::open(dir)?;
    model.check().with_context(|| format!("not a valid model: {}", dir.display()))?;
    Ok(model)
}

/// Returns the first test view, or the first training view of a capture without test views.
pub(crate) fn first_view(capture: &Capture) -> anyhow::Result<&View> {
    let view = capture.views_of(Split::Test).next().or_else(|| capture.views_of(Split::Train).next());
    let (_, view) =
        view.with_context(|| format!("the capture has no test or training view: {}", capture.dir.display()))?;
    Ok(view)
}

/// Checks that there is a time and that all times lie within the capture, and clamps them to its ends.
pub(crate) fn times_within(times: &[f64], capture: &Capture) -> anyhow::Result<Vec<f64>> {
    let map = &capture.time_map;
    let slack = TIME_SLACK * (map.end_secs - map.start_secs).max(1.0);
    ensure!(!times.is_empty(), "no times given; name some, e.g. 0:1:30");
    for &time in times {
        if !(time >= map.start_secs - slack && time <= map.end_secs + slack) {
            let [start, end] = [map.start_secs, map.end_secs];
            bail!(
                "time {time} s is outside of the capture; choose times from {start} to {end} s, e.g. {start}:{end}:30"
            );
        }
    }
    Ok(times.iter().map(|time| time.clamp(map.start_secs, map.end_secs)).collect())
}

/// Creates a folder for frames. A folder with files is refused, because frames of another sequence could stay in it.
pub(crate) fn create_folder(out: &Path) -> anyhow::Result<()> {
    let cannot = || format!("cannot create the folder {}", out.display());
    match std::fs::create_dir_all(out) {
        Err(error) if matches!(error.kind(), ErrorKind::AlreadyExists | ErrorKind::NotADirectory) => {
            let failure = Failure::new(FailureKind::BadInput, "not a folder");
            return Err(failure.hint("name another folder").at(out).into());
        }
        created => created.with_context(cannot)?,
    }
    if std::fs::read_dir(out).with_context(cannot)?.next().is_some() {
        let failure = Failure::new(FailureKind::BadInput, "the folder is not empty");
        return Err(failure.hint("name another folder, or remove its files").at(out).into());
    }
    Ok(())
}
