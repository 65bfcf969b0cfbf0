//! `attach`: follows a submitted run or search.

use std::path::Path;

use ::cluster::{ClusterRun, RunFile, Site};
use engine::event::Event;
use engine::exit;

use super::cluster::{existing_store, follow, on_cluster};
use super::process::process;
use super::search;
use crate::args::{AttachArgs, command};
use crate::device::ChosenDevice;
use crate::display::{self, Eta, summary};
use crate::error::CliError;
use crate::measured::{self, Measured};
use crate::session::Session;

pub(crate) fn attach(typed: &Path, args: &AttachArgs) -> Result<u8, CliError> {
    let store = existing_store(typed)?;
    let run = on_cluster(&store, args.run.as_deref())?;
    let (file, plan) = RunFile::read(&store, &run)?;
    if let cluster_run @ ClusterRun { site: Site { search: Some(_), .. }, .. } = &ClusterRun::read(&store, &run, &plan)?
    {
        if args.json {
            return Err(CliError::Usage("a search has no events: omit --json".into()));
        }
        return search::attach(store.root(), cluster_run);
    }
    let places = [typed, &file.data_root, Path::new(&file.device)];
    let table = command("table", &file.recipe, &plan.changes, places);
    let session = Session::of_run(store, &file, plan, ChosenDevice::Cpu);
    let eta = Eta::new(&session, &session.predict()?, 1)?;
    let mut display = display::choose(args.json, eta);
    let process = process(ChosenDevice::Cpu, None, None)?;
    // If the reader of the output exits, the wait ends as after a signal.
    let watch = &mut |event: &Event| {
        if display.show(event).is_err() {
            process.stop.reader_is_gone();
        }
    };
    let result = follow((&session.store, &session.plan), &run, &process, watch)?;
    drop(display);
    match args.json {
        true => drop(summary::link(&session, &result)),
        false => summary::print(&session, &result, &table),
    }
    let Measured { runs, .. } = measured::of_run(&session, &result)?;
    let is_degenerate = summary::degenerate(&runs, args.json);
    Ok(match result.exit_code(false) {
        exit::OK if is_degenerate => exit::DEGENERATE,
        code => code,
    })
}
