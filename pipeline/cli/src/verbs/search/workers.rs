//! Several processes of this machine that work on one search.

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitStatus, Stdio};

use anyhow::Context;
use engine::{Failure, FailureKind, exit};

use super::Search;
use crate::error::CliError;
use crate::session::Session;
use crate::verbs::process::own_program;
use crate::verbs::workers;

/// Options with a value that are not copied to the command lines of worker processes.
const WITH_VALUE: [&str; 15] = [
    "--store",
    "--data-root",
    "--workers",
    "--devices",
    "--device",
    "--jobs",
    "--threads",
    "--on",
    "--cluster",
    "--search-end",
    "--search-parent",
    "--search-part",
    "--search-run",
    "--search-wave",
    "--until",
];
/// Options that belong to the process that starts others, without values.
const WITHOUT_VALUE: [&str; 2] = ["--detach", "--search-report"];

/// Runs the worker processes of a search until they end; an error if one ended without having done its part. Stop requests
/// to this process are passed on to all of them.
pub(super) fn run(search: &Search<'_>) -> Result<(), CliError> {
    let args = search.args;
    let crew = workers::crew(&Session::read_only(search.store, &args.recipe)?, args)?;
    let count = crew.len();
    let start = |(at, worker): (usize, &::cluster::Worker)| {
        let mut command = Command::new(own_program()?);
        command.arg("--store").arg(search.store).args(arguments(search)?);
        command.args(["--search-part", &format!("{}/{count}", at + 1), "--device", &worker.device]);
        command.args(["--jobs", &worker.jobs.to_string(), "--threads", &worker.threads.to_string()]);
        command.args(["--search-parent", &std::process::id().to_string()]);
        // In its own process group: this process passes on the user's signals.
        command.process_group(0).stdin(Stdio::null()).stdout(Stdio::null());
        command.spawn().context("cannot start a worker")
    };
    let children = crew.iter().enumerate().map(start).collect::<anyhow::Result<Vec<_>>>()?;
    let mut early = None;
    ::cluster::wait(children, &search.stop, &mut |worker, status| _ = early.get_or_insert((worker, status)))?;
    early.map_or(Ok(()), |(worker, status)| Err(ended_early(worker, status)))
}

/// The error for a worker that ended without having done its part, e.g. because its device was refused.
fn ended_early(worker: usize, status: ExitStatus) -> CliError {
    let of_kind = |kind| {
        let message = format!("worker {worker} of the search ended early ({status}); it printed the reason");
        Failure::new(kind, message).hint("remove the cause and run the command again: the search continues").into()
    };
    match status.code() == Some(exit::INPUT.into()) {
        true => CliError::Input(of_kind(FailureKind::BadInput)),
        false => CliError::Other(of_kind(FailureKind::World)),
    }
}

/// The arguments of this process, starting with the verb, for a process in any folder that works on the same search until
/// the same time.
pub(super) fn arguments(search: &Search<'_>) -> anyhow::Result<Vec<OsString>> {
    let mut arguments = without(std::env::args_os().skip(1));
    let data_root = std::path::absolute(&search.recipe.with.data.root).context("cannot locate the data folder")?;
    arguments.extend(["--data-root".into(), data_root.into()]);
    if search.end_secs.is_finite() {
        arguments.extend(["--search-end".into(), search.end_secs.to_string().into()]);
    }
    Ok(arguments)
}

/// The arguments without the options that belong to the process that starts others.
fn without(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut kept = Vec::new();
    let mut arguments = arguments.peekable();
    while let Some(argument) = arguments.next() {
        let text = argument.to_string_lossy();
        let name = text.split('=').next().unwrap_or_default();
        if WITH_VALUE.contains(&name) {
            if !text.contains('=') {
                arguments.next();
            }
        } else if !WITHOUT_VALUE.contains(&name) {
            kept.push(argument);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_get_the_arguments_of_the_search_but_not_its_place() {
        let line = "--store s run r.toml --on slurm --workers=4 --detach --data-root d --sweep a=1,2 --device gpu \
                    -s b=--on --trials 9";
        let kept = without(line.split(' ').map(OsString::from));
        assert_eq!(kept.join(std::ffi::OsStr::new(" ")), "run r.toml --sweep a=1,2 -s b=--on --trials 9");
    }
}
