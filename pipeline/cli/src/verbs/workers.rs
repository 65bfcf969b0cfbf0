//! `run --workers` and `run --devices`: a run that several processes of this machine share.

use ::cluster::{Process, RunFile, Worker, run_with_workers};
use engine::event::Event;
use engine::scheduler::{RunOptions, RunSummary};
use engine::{Failure, FailureKind};

use crate::args::{RecipeArgs, RunArgs};
use crate::device::ChosenDevice;
use crate::error::CliError;
use crate::session::Session;

/// The workers of a run, with what they have in common.
pub(super) struct Workers {
    file: RunFile,
    workers: Vec<Worker>,
}

/// The workers that the command line requests; `None` if only this process runs the jobs.
pub(super) fn of(session: &Session, args: &RunArgs, recipe: &RecipeArgs) -> Result<Option<Workers>, CliError> {
    let workers = crew(session, args)?;
    if workers.is_empty() { Ok(None) } else { Ok(Some(Workers { file: run_file(session, args, recipe)?, workers })) }
}

/// The workers with their devices, and with their shares of jobs and threads.
pub(super) fn crew(session: &Session, args: &RunArgs) -> Result<Vec<Worker>, CliError> {
    let available = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = args.threads.unwrap_or(available);
    let devices = match (args.workers.filter(|_| args.on.is_none()), &args.devices[..]) {
        (None, []) => return Ok(Vec::new()),
        (Some(count), _) => vec![session.device.id(); count],
        (None, names) => devices(session, names)?,
    };
    let share = |all: usize| (all / devices.len()).max(1);
    let (jobs, threads) = (share(args.jobs.unwrap_or(threads)), share(threads));
    Ok(devices.into_iter().map(|device| Worker { device, jobs, threads }).collect())
}

/// The ids of the devices named by `--devices`, which must be of the class that the plan was made for.
fn devices(session: &Session, names: &[String]) -> Result<Vec<String>, CliError> {
    let chosen = ChosenDevice::choose_several(names)?;
    if let Some(other) = chosen.iter().find(|device| device.class() != session.device.class()) {
        let class = session.device.class().as_str();
        let message = format!("{} is not a {class}, for which the run is planned", other.id());
        let hint = format!("add --device {}", other.class().as_str());
        return Err(CliError::Input(Failure::new(FailureKind::BadInput, message).hint(hint).into()));
    }
    chosen.iter().try_for_each(|device| device.check())?;
    Ok(chosen.into_iter().map(ChosenDevice::id).collect())
}

/// The options that all processes of a shared run have in common.
pub(super) fn run_file(session: &Session, args: &RunArgs, recipe: &RecipeArgs) -> Result<RunFile, CliError> {
    Ok(RunFile {
        recipe: recipe.recipe.clone(),
        data_root: std::path::absolute(&session.data_root)?,
        targets: session.targets.clone(),
        force: session.force.clone(),
        device: recipe.with.device.clone(),
        profile: args.profile,
        max_failures: if args.fail_fast { Some(1) } else { args.max_failures },
        timeout: args.timeout,
        log_filter: args.log.clone(),
        lease: args.lease,
    })
}

impl Workers {
    /// Runs the plan of `session` with the workers; this process has the other `options`.
    pub(super) fn run(
        &self,
        session: &Session,
        options: &RunOptions,
        watch: &mut dyn FnMut(&Event),
    ) -> anyhow::Result<RunSummary> {
        run_with_workers((&session.plan, &session.store), &self.file, &self.workers, &process(options), watch)
    }
}

/// This process as a part of a shared run.
pub(super) fn process(options: &RunOptions) -> Process {
    Process {
        jobs: options.jobs,
        threads: options.threads,
        device: options.device.clone(),
        command: options.command.clone(),
        stop: options.stop.clone(),
    }
}
