//! `show`, `export` and `render`: results of single jobs.

use std::path::{Path, PathBuf};

use anyhow::Context;
use engine::{Digest, Failure, FailureKind};
use rendering::Show;
use rendering::film::{Film, Gif, Panels, film_to_folder, film_to_gif, film_to_sheet};
use serde_json::json;
use training::{Edit, compute_on};

use crate::args::{ExportArgs, ExportFormat, RenderArgs, ShowArgs};
use crate::error::CliError;
use crate::output::{bytes, duration, print, print_json, print_line};
use crate::session::{Session, TRAINING};

pub(crate) fn show(store: &Path, args: &ShowArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.node.recipe)?;
    let record = session.record(session.node(&args.node.node)?)?;
    let view = session.store.view(&record.content)?;
    let measurements = session.store.read_measurements(&record.measurements)?;
    if args.path {
        print_line(&view.display().to_string())?;
    } else if args.node.json {
        print_json(&json!({ "path": view, "record": record, "measurements": measurements }))?;
    } else {
        let made = &record.provenance;
        let pretty = |value: &serde_json::Value| serde_json::to_string_pretty(value);
        print(&format!(
            "{}\n  folder       {}\n  size         {} in {} files\n  key          {}\n  content      {}\n  \
             made         by run {} on {} in {}\nparams {}\nmeasurements {}\n",
            made.node,
            view.display(),
            bytes(record.size_bytes),
            record.files,
            record.key,
            record.content,
            made.run,
            made.host,
            duration(made.wall_secs),
            pretty(&record.components.params)?,
            pretty(&measurements)?,
        ))?;
    }
    Ok(engine::exit::OK)
}

/// The folders of a training job's model and of the capture that it was trained on.
fn model_and_capture(session: &Session, job: &str) -> Result<[PathBuf; 2], CliError> {
    let index = session.node(job)?;
    let node = &session.plan.nodes[index];
    if node.stage != TRAINING {
        return Err(CliError::nothing(format!("{} does not train a model", node.name), "name a training job"));
    }
    let record = session.record(index)?;
    // From the record: the recipe may name another capture by now.
    let capture = record.components.inputs.get("capture").and_then(|inputs| inputs.first()?.content.as_deref());
    let capture =
        Digest::from_hex(capture.unwrap_or_default()).context("the record of the training names no capture")?;
    session.require_intact(&format!("the capture of {}", node.name), &capture)?;
    Ok([session.store.view(&record.content)?, session.store.view(&capture)?])
}

pub(crate) fn export(store: &Path, args: &ExportArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.recipe)?;
    let [model, capture] = model_and_capture(&session, &args.node)?;
    let report = match args.format {
        ExportFormat::PlySeq => {
            let selection = args.prompt.selection(Show::Edit(Edit::Keep));
            rendering::export::ply_sequence(&model, &capture, &args.times.0, selection.as_ref(), &args.out)
        }
    };
    print_line(report.map_err(CliError::of_input)?.trim_end())?;
    Ok(engine::exit::OK)
}

pub(crate) fn render(store: &Path, args: &RenderArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.recipe)?;
    session.device.check()?;
    let (models, capture) = models_and_capture(&session, &args.jobs)?;
    let times = args.times.as_ref().map_or(&[][..], |times| &times.0);
    let film = Film { times, views: &args.views, selection: args.prompt.selection(Show::Highlight) };
    let panels = Panels { truth: args.truth, scale: args.scale };
    let summary = compute_on(&session.device.id(), |device| match (&args.gif, &args.sheet, &args.out, &models[..]) {
        (Some(file), ..) => film_to_gif(&models, &capture, &film, Gif { panels, fps: args.fps }, device, file),
        (_, Some(file), ..) => film_to_sheet(&models, &capture, &film, panels, device, file),
        (_, _, Some(out), [model]) => film_to_folder(model, &capture, &film, device, out),
        _ => {
            let failure = Failure::new(FailureKind::BadInput, "--out writes the frames of one job only");
            Err(failure.hint("use --gif FILE or --sheet FILE for several jobs side by side").into())
        }
    });
    print_line(&summary.map_err(CliError::of_input)?)?;
    Ok(engine::exit::OK)
}

/// The folders of the models that training jobs made, and of the one capture that all of them were trained on.
fn models_and_capture(session: &Session, jobs: &[String]) -> Result<(Vec<PathBuf>, PathBuf), CliError> {
    let mut models = Vec::new();
    let mut first: Option<PathBuf> = None;
    for job in jobs {
        let [model, capture] = model_and_capture(session, job)?;
        if first.as_ref().is_some_and(|first| *first != capture) {
            let message = format!("{} and {job} were trained on different captures", jobs[0]);
            return Err(CliError::nothing(message, "name jobs of one scene"));
        }
        models.push(model);
        first = Some(capture);
    }
    Ok((models, first.context("no job was named")?))
}
