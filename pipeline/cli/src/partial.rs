//! Reports of unfinished runs, made in a temporary folder from the results that exist.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use engine::status::{Prediction, State};
use engine::{Failure, FailureKind, InputRecord, JobContext, Measurements};
use serde_json::Value;

use crate::error::CliError;
use crate::output::{count, note};
use crate::session::Session;
use crate::stages::stages;

/// A report in a temporary folder, which is removed when this value is dropped.
pub(crate) struct PartialReport {
    context: JobContext,
    _folder: tempfile::TempDir,
}

impl PartialReport {
    /// Makes the report of the job `index` from the producers that have results. The others appear as not run.
    pub(crate) fn make(session: &Session, index: usize) -> Result<Self, CliError> {
        let node = &session.plan.nodes[index];
        let predictions = session.predict_for(&BTreeSet::from([index]))?;
        let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
        let mut context = JobContext::detached(folder.path()).context("cannot create a temporary folder")?;
        let (mut open, mut all) = (0, 0);
        for input in &node.inputs {
            let mut records = Vec::new();
            for &producer in &input.producers {
                let record = record(session, producer, predictions.get(&producer), input.measurements)?;
                all += 1;
                open += usize::from(record.artifact.is_err());
                records.push(record);
            }
            context.inputs.insert(input.port.clone(), records);
        }
        if open == all {
            return Err(CliError::nothing("no job of the table has a result yet", "run the recipe first"));
        }
        note(&format!("{} missing; the table reads {all}", count(open, "result")));
        let stage = stages();
        stage.get(&node.stage).context("the plan has stages of this program")?.run(&context, &node.params)?;
        Ok(Self { context, _folder: folder })
    }

    /// The folder of the report.
    pub(crate) fn dir(&self) -> &Path {
        self.context.output_dir()
    }
}

/// A producer of the report: its result, or the reason why it has none.
fn record(
    session: &Session,
    producer: usize,
    prediction: Option<&Prediction>,
    measurements: Measurements,
) -> Result<InputRecord, CliError> {
    let node = &session.plan.nodes[producer];
    let mut input = InputRecord {
        producer: node.name.clone(),
        coordinates: node.coordinates.clone(),
        artifact: Err(Failure::new(FailureKind::Interrupted, "not run yet")),
        measurements: Value::Null,
        action_key: String::new(),
    };
    match prediction.map(|prediction| &prediction.state) {
        Some(State::Cached { record }) => {
            input.artifact = Ok::<PathBuf, _>(session.store.view(&record.content)?);
            input.action_key = record.key.to_string();
            if measurements != Measurements::Unread {
                input.measurements = session.store.read_measurements(&record.measurements)?;
            }
        }
        Some(State::WillRun { last_failure: Some(failed), .. }) => input.artifact = Err(failed.failure.clone()),
        Some(State::MissingData { failure } | State::Blocked { failure, .. }) => input.artifact = Err(failure.clone()),
        _ => (),
    }
    Ok(input)
}
