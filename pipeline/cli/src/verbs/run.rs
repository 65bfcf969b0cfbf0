//! `run`: executes the jobs whose results are missing from the store.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use engine::event::Event;
use engine::job::StopRequests;
use engine::scheduler::{self, RunOptions};

use crate::args::RunArgs;
use crate::display::{self, profile, summary};
use crate::error::CliError;
use crate::session::Session;

/// Without a terminal, a line is printed at least this often to show that the run is alive.
const HEARTBEAT: Duration = Duration::from_secs(30);

pub(crate) fn run(store: &Path, args: &RunArgs) -> Result<u8, CliError> {
    if args.frozen {
        refuse_to_run(&Session::read_only(store, &args.recipe)?.select(&args.selection)?)?;
    }
    let session = Session::open(store, &args.recipe)?.select(&args.selection)?;
    if session.needs_device()? {
        session.device.check()?;
    }
    let options = options(&session, args)?;
    let mut display = display::choose(args.json);
    let mut closed = None;
    let watch = &mut |event: &Event| {
        if closed.is_none()
            && let Err(error) = display.show(event)
        {
            // The reader of the events exited: stop the jobs, which save their progress.
            options.stop.reader_is_gone();
            closed = Some(error);
        }
    };
    let result = scheduler::run(&session.plan, &session.store, &options, watch)?;
    drop(display);
    summary::print(&session, &result);
    if let Some(error) = closed {
        return Err(error);
    }
    if !args.json {
        summary::print_tables(&session, &result)?;
        if args.profile {
            // The forced jobs have run now, so their results count as cached.
            profile::print(&Session { force: BTreeSet::new(), ..session })?;
        }
    }
    Ok(result.exit_code(args.require_data))
}

fn options(session: &Session, args: &RunArgs) -> anyhow::Result<RunOptions> {
    let available = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = args.threads.unwrap_or_else(available);
    Ok(RunOptions {
        data_root: session.data_root.clone(),
        targets: session.targets.clone(),
        force: session.force.clone(),
        jobs: args.jobs.unwrap_or(threads),
        threads,
        device: session.device.id(),
        profile: args.profile,
        max_failures: if args.fail_fast { Some(1) } else { args.max_failures },
        timeout: args.timeout,
        rehash: session.rehash,
        log_filter: args.log.clone(),
        command: vec![own_program()?.into(), "exec-job".into()],
        stop: StopRequests::listen().context("cannot listen to signals")?,
        heartbeat: HEARTBEAT,
    })
}

/// The path of this program. On Linux it is a link to the running image, which does not change when a build replaces
/// the file, so all jobs of a run execute the code that the plan was made with.
fn own_program() -> anyhow::Result<PathBuf> {
    let image = PathBuf::from("/proc/self/exe");
    if image.exists() { Ok(image) } else { std::env::current_exe().context("cannot find the program's own file") }
}

/// Checks `--frozen`: an error names the jobs that would have to run, if there are any.
fn refuse_to_run(session: &Session) -> Result<(), CliError> {
    let predictions = session.predict()?;
    let stale = predictions.iter().filter(|(_, prediction)| prediction.may_run());
    let names: Vec<String> = stale.map(|(&index, _)| session.plan.nodes[index].name.clone()).collect();
    if names.is_empty() { Ok(()) } else { Err(CliError::Frozen(names)) }
}
