//! One run of a recipe: executes the jobs whose results are missing from the store.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use engine::Failure;
use engine::event::Event;
use engine::exit;
use engine::job::StopRequests;
use engine::scheduler::{self, RunOptions, RunSummary};
use engine::status::{Prediction, State};
use table_generation::RowDifference;

use crate::args::{RecipeArgs, RunArgs};
use crate::display::{self, Eta, profile, summary};
use crate::error::CliError;
use crate::measured::{self, Measured};
use crate::output::note;
use crate::session::Session;
use crate::verbs::process::own_program;
use crate::verbs::{cluster, data, workers};

/// Without a terminal, a line is printed at least this often to show that the run is alive.
const HEARTBEAT: Duration = Duration::from_secs(30);

/// The end of a run.
pub(super) struct Ended {
    /// The exit code.
    pub code: u8,
    /// The differences in its reports.
    pub differences: Vec<RowDifference>,
}

/// Runs a recipe once.
pub(super) fn once(store: &Path, recipe: &RecipeArgs, args: &RunArgs) -> Result<Ended, CliError> {
    if args.frozen {
        let session = Session::read_only(store, recipe)?.select(&args.selection)?;
        check_frozen(&session)?;
        if session.store.exists() && !session.store.is_writable() {
            note("no job would have to run; the store is read-only, so no run is recorded and links stay as they are");
            return Ok(Ended { code: exit::OK, differences: Vec::new() });
        }
    }
    let session = Session::open(store, recipe)?.select(&args.selection)?;
    // No clean-up may remove what the predictions find.
    let _in_use = session.store.enter()?;
    let predictions = session.predict()?;
    if args.on.is_none() {
        session.check_device(&predictions)?;
    }
    refuse_without_data(&session, &predictions)?;
    print_fetch_hints(&session, &predictions)?;
    let stop = StopRequests::listen().context("cannot listen to signals")?;
    let mut options = options(&session, args, stop)?;
    let submitted = args.on.map(|_| cluster::submit(&session, args, recipe)).transpose()?.flatten();
    if args.detach {
        return Ok(Ended { code: exit::OK, differences: Vec::new() });
    }
    let eta = Eta::new(&session, &predictions, options.threads)?;
    // Without a job to run, workers would only start and end.
    let has_work = predictions.values().any(Prediction::may_run);
    options.found = predictions.into_iter().filter_map(|(index, found)| Some((index, found.cached()?))).collect();
    let mut display = display::choose(args.json, eta);
    let mut closed = None;
    let watch = &mut |event: &Event| {
        if closed.is_none()
            && let Err(error) = display.show(event)
        {
            // The reader of the events has exited: stop the jobs, which save their progress.
            options.stop.reader_is_gone();
            closed = Some(error);
        }
    };
    let result = match (submitted, workers::of(&session, args, recipe)?.filter(|_| has_work)) {
        (Some(run), _) => {
            let process = workers::process(&options);
            cluster::follow((&session.store, &session.plan), &run, &process, watch)?
        }
        (_, Some(workers)) => workers.run(&session, &options, watch)?,
        (None, None) => scheduler::run(&session.plan, &session.store, &options, watch)?,
    };
    drop(display);
    finish(session, args, &recipe.command("table", store), &result, closed)
}

/// Prints the summary of a run, and checks its reports for degenerate runs. `closed` is the error that ended the
/// display of events, if there was one.
fn finish(
    session: Session,
    args: &RunArgs,
    table: &str,
    result: &RunSummary,
    closed: Option<CliError>,
) -> Result<Ended, CliError> {
    match args.json {
        true => drop(summary::link(&session, result)),
        false => summary::print(&session, result, table),
    }
    let Measured { runs, differences, .. } = measured::of_run(&session, result)?;
    let is_degenerate = summary::degenerate(&runs, args.json);
    if let Some(error) = closed {
        return Err(error);
    }
    if args.profile {
        // The forced jobs have run now, so their results count as cached.
        profile::print(&Session { force: BTreeSet::new(), ..session })?;
    }
    let code = match result.exit_code(args.require_data) {
        exit::OK if is_degenerate => exit::DEGENERATE,
        code => code,
    };
    Ok(Ended { code, differences })
}

/// The options of a run in this process.
pub(super) fn options(session: &Session, args: &RunArgs, stop: StopRequests) -> anyhow::Result<RunOptions> {
    let available = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = args.threads.unwrap_or_else(available);
    Ok(RunOptions {
        data_root: session.data_root.clone(),
        targets: session.targets.clone(),
        force: session.force.clone(),
        found: Default::default(),
        jobs: args.jobs.unwrap_or(threads),
        threads,
        device: session.device.id(),
        profile: args.profile,
        pause_at: Default::default(),
        max_failures: if args.fail_fast { Some(1) } else { args.max_failures },
        timeout: args.timeout,
        rehash: session.rehash,
        log_filter: args.log.clone(),
        command: vec![own_program()?.into(), "exec-job".into()],
        stop,
        heartbeat: HEARTBEAT,
        lease: args.lease,
        share: None,
    })
}

/// Refuses a run for which all data is missing: its tables would be empty.
fn refuse_without_data(session: &Session, predictions: &BTreeMap<usize, Prediction>) -> Result<(), CliError> {
    let missing: Vec<&Failure> = predictions.values().filter_map(Prediction::missing_data).collect();
    let mut has_data = vec![false; session.plan.nodes.len()];
    for (&index, prediction) in predictions {
        let producers = session.plan.nodes[index].producers();
        let is_fed = producers.is_empty() || producers.iter().any(|&producer| has_data[producer]);
        has_data[index] = is_fed && (prediction.may_run() || matches!(prediction.state, State::Cached { .. }));
    }
    match missing[..] {
        [first, ..] if !has_data.contains(&true) => {
            let path = first.path.as_deref().unwrap_or(&session.data_root);
            let message = format!("all data of this recipe is missing, e.g. {}", path.display());
            let advice =
                data::how_to_get(missing.iter().filter_map(|failure| failure.path.as_deref()), &session.data_root)?;
            let get = if advice.is_empty() { String::new() } else { format!("{}, or ", advice.join("; ")) };
            let hint = format!("{get}choose another folder with --data-root (now {})", session.data_root.display());
            Err(CliError::nothing(message, hint))
        }
        _ => Ok(()),
    }
}

/// Prints how to get the data that some jobs lack.
fn print_fetch_hints(session: &Session, predictions: &BTreeMap<usize, Prediction>) -> Result<(), CliError> {
    let missing = predictions.values().filter_map(Prediction::missing_data);
    let advice = data::how_to_get(missing.filter_map(|failure| failure.path.as_deref()), &session.data_root)?;
    advice.iter().for_each(|advice| note(&format!("missing data: {advice}")));
    Ok(())
}

/// Checks `--frozen`: an error names the jobs that would have to run, if there are any.
fn check_frozen(session: &Session) -> Result<(), CliError> {
    let predictions = session.predict()?;
    let stale = predictions.iter().filter(|(_, prediction)| prediction.may_run());
    let names: Vec<String> = stale.map(|(&index, _)| session.plan.nodes[index].name.clone()).collect();
    if names.is_empty() { Ok(()) } else { Err(CliError::Frozen(names)) }
}
