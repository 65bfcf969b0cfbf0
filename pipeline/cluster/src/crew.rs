//! A crew of worker processes on this machine.

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use anyhow::Context;
use engine::event::Event;
use engine::job::StopRequests;
use engine::scheduler::{Crew, RunOptions, RunSummary, Share, begin, run};
use engine::{Plan, Store, exit};
use fs_err as fs;
use rustix::process::{Pid, Signal, kill_process};

use crate::{Process, RunFile};

/// The interval at which workers are polled: a run ends at most this long after its last worker.
const TICK: Duration = Duration::from_millis(10);

/// One worker of a crew.
#[derive(Clone, Debug)]
pub struct Worker {
    /// The identifier of the device, which the worker receives as `--device`.
    pub device: String,
    /// The maximum number of jobs at a time.
    pub jobs: usize,
    /// The number of threads of all its jobs.
    pub threads: usize,
}

/// Runs a plan with several workers, each in a separate process, and returns the usual summary. `process` is this one,
/// which only follows the workers, and runs the remaining jobs if all of them have died. `watcher` receives every
/// event, and `on_early_end` each worker that ends without having done its part, while the others continue.
pub fn run_with_workers(
    (plan, store): (&Plan, &Store),
    file: &RunFile,
    workers: &[Worker],
    process: &Process,
    watcher: &mut dyn FnMut(&Event),
    on_early_end: &(dyn Fn(&EarlyEnd) + Sync),
) -> anyhow::Result<RunSummary> {
    let name = begin(plan, store)?;
    file.write(store, &name)?;
    let crew = Crew::default();
    let share = follower(&name, &crew);
    let options = file.options(process, share);
    std::thread::scope(|scope| {
        // The workers end with the thread that starts them.
        let watch = scope.spawn(|| {
            let children = start(store, &name, workers, &options);
            let report = &mut |worker, status| {
                on_early_end(&EarlyEnd { worker, status, log: log_file(&store.run_dir(&name), worker) });
            };
            let ended = children.and_then(|children| wait(children, &options.stop, report));
            crew.take_over();
            ended
        });
        let summary = run(plan, store, &options, watcher);
        watch.join().map_err(|_| anyhow::anyhow!("the thread that watches the workers panicked"))??;
        summary
    })
}

/// The part of a process that only follows others, and reports to the user.
pub(crate) fn follower(run: &str, crew: &Crew) -> Share {
    Share {
        run: run.into(),
        name: String::new(),
        begin: 0.0,
        following: Some(crew.clone()),
        only: None,
        missing: None,
        idle: None,
    }
}

fn start(store: &Store, run: &str, workers: &[Worker], options: &RunOptions) -> anyhow::Result<Vec<Child>> {
    let program = options.command.first().context("no command to run workers with")?;
    let start = |(at, worker): (usize, &Worker)| {
        let log = fs::File::create(log_file(&store.run_dir(run), at + 1))?.into_parts().0;
        let mut command = Command::new(program);
        command.arg("--store").arg(store.root()).args(["worker", run]);
        command.args(["--part", &format!("{}/{}", at + 1, workers.len()), "--device", &worker.device]);
        command.args(["--jobs", &worker.jobs.to_string(), "--threads", &worker.threads.to_string()]);
        command.args(["--parent", &std::process::id().to_string()]);
        // In its own process group: this process passes on the user's signals.
        command.process_group(0).stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log);
        command.spawn().context("cannot start a worker")
    };
    workers.iter().enumerate().map(start).collect()
}

/// The file with what a worker prints; workers are numbered from 1.
pub fn log_file(run_dir: &Path, worker: usize) -> PathBuf {
    run_dir.join(format!("worker-{worker}.log"))
}

/// A worker that ended without having done its part: it could not begin, crashed, or was killed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EarlyEnd {
    /// The number of the worker, from 1.
    pub worker: usize,
    /// How its process ended.
    pub status: ExitStatus,
    /// The file with what it printed.
    pub log: PathBuf,
}

/// Whether a worker with this status has ended without having done its part.
fn is_early_end(status: ExitStatus) -> bool {
    // Failed jobs are in the summary of the run, and a stop is the user's.
    let stopped = [exit::CHECKPOINTED, exit::INTERRUPTED, exit::TERMINATED, exit::READER_GONE];
    let usual = [exit::OK, exit::FAILED, exit::NOTHING].into_iter().chain(stopped);
    !status.code().is_some_and(|code| usual.map(i32::from).any(|usual| usual == code))
}

/// Waits until all workers have ended. Each new stop request goes to all of them. `on_early_end` receives the number, from 1,
/// and the status of each worker that ends without having done its part.
pub fn wait(
    children: Vec<Child>,
    stop: &StopRequests,
    on_early_end: &mut dyn FnMut(usize, ExitStatus),
) -> anyhow::Result<()> {
    let mut living: Vec<(usize, Child)> = children.into_iter().enumerate().collect();
    let mut passed_on = 0;
    loop {
        for (at, mut child) in std::mem::take(&mut living) {
            match child.try_wait()? {
                Some(status) if is_early_end(status) => on_early_end(at + 1, status),
                Some(_) => {}
                None => living.push((at, child)),
            }
        }
        if living.is_empty() {
            return Ok(());
        }
        if passed_on < stop.count() {
            passed_on += 1;
            // Fails only if the worker has just ended.
            living.iter().for_each(|(_, child)| _ = kill_process(Pid::from_child(child), Signal::TERM));
        }
        std::thread::sleep(TICK);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workers_that_end_early_are_reported() {
        let scripts = ["exit 13", "exit 0", "kill -9 $$", "exit 10"];
        let start = |script| Command::new("sh").args(["-c", script]).spawn().unwrap();
        let mut early = Vec::new();
        let report = &mut |worker, _| early.push(worker);
        wait(scripts.into_iter().map(start).collect(), &StopRequests::default(), report).unwrap();
        early.sort_unstable();
        assert_eq!(early, [1, 3]);
    }
}
