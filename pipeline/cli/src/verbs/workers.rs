//! `run --workers` and `run --devices`: a run that several processes of this machine share.

use ::cluster::{EarlyEnd, Process, RunFile, Worker, run_with_workers};
use engine::event::Event;
use engine::scheduler::{RunOptions, RunSummary};
use engine::{Failure, FailureKind};

use crate::args::{RecipeArgs, RunArgs};
use crate::device::ChosenDevice;
use crate::error::CliError;
use crate::output::note;
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
    let count = devices.len();
    refuse_too_few(args, count)?;
    let shares = shares(args.jobs.unwrap_or(threads), count).zip(shares(threads, count));
    Ok(devices.into_iter().zip(shares).map(|(device, (jobs, threads))| Worker { device, jobs, threads }).collect())
}

/// Refuses fewer jobs or threads than workers: all workers together would use more than the user wants.
fn refuse_too_few(args: &RunArgs, count: usize) -> Result<(), CliError> {
    for (option, typed) in [("--jobs", args.jobs), ("--threads", args.threads)] {
        if let Some(all) = typed.filter(|all| *all < count) {
            let message = format!("{option} {all} is not enough for {count} workers, each of which needs one");
            let hint = format!("omit {option}, or start fewer workers");
            return Err(CliError::Input(Failure::new(FailureKind::BadInput, message).hint(hint).into()));
        }
    }
    Ok(())
}

/// `all` in shares for `count` workers, which differ by at most one; each is at least one.
fn shares(all: usize, count: usize) -> impl Iterator<Item = usize> {
    (0..count).map(move |worker| (all / count + usize::from(worker < all % count)).max(1))
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
        let of_run = (&session.plan, &session.store);
        let note_end = |EarlyEnd { worker, status, log }: &EarlyEnd| {
            let log = log.display();
            note(&format!("worker {worker} ended early ({status}) and leaves its jobs to the others; see {log}"));
        };
        run_with_workers(of_run, &self.file, &self.workers, &process(options), watch, &note_end)
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

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Cli, Verb};

    #[test]
    fn fewer_jobs_or_threads_than_workers_are_refused() {
        let check = |option: &str| {
            let Verb::Run(args) = Cli::parse_from(["pipeline", "run", "r.toml", option]).verb else {
                panic!("another verb")
            };
            refuse_too_few(&args, 4).map_err(|error| error.to_string())
        };
        assert!(check("--jobs=1").unwrap_err().contains("--jobs 1 is not enough for 4 workers"));
        assert!(check("--threads=3").unwrap_err().contains("--threads 3 is not enough for 4 workers"));
        assert!(check("--threads=4").is_ok() && check("--workers=4").is_ok());
    }

    #[test]
    fn shares_leave_nothing_over_and_are_never_empty() {
        let of = |all, count| shares(all, count).collect::<Vec<_>>();
        assert_eq!(of(7, 2), [4, 3]);
        assert_eq!(of(8, 4), [2, 2, 2, 2]);
        assert_eq!(of(2, 3), [1, 1, 1]);
    }
}
