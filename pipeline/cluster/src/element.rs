//! The work of a batch job: computes its cell, takes part as a pilot, or closes the wave.

use std::collections::BTreeSet;
use std::time::Duration;

use engine::event::{Event, Outcome};
use engine::job::StopRequests;
use engine::scheduler::{Crew, RunOptions, RunSummary, Share, run};
use engine::{Failure, FailureKind, exit};
use fs_err as fs;

use crate::attendance::Attendance;
use crate::crew::follower;
use crate::slurm;
use crate::wave::ClusterRun;
use crate::{Process, RunFile};

/// How long a job that has requeued itself waits to be killed.
const REQUEUE_WAIT: Duration = Duration::from_secs(60);
/// The file whose presence says that the run was cancelled.
const CANCELLED: &str = "cancelled";
/// The file whose presence marks the end of the run.
const ENDED: &str = "ended";

/// The role of a batch job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Computes the cell of an array's element.
    Cell {
        /// The index of the batch.
        batch: usize,
        /// The number of the element.
        number: u32,
    },
    /// Takes any ready jobs.
    Pilot {
        /// The number of the pilot, from 1.
        part: usize,
        /// The number of pilots.
        of: usize,
        /// The time without a free job after which it ends.
        idle: Option<Duration>,
    },
    /// Collects the results, or resubmits the cells without a result.
    Report,
}

impl ClusterRun<'_> {
    /// Does the work of a batch job of the wave with this number. Returns the exit code.
    pub fn work(
        &self,
        (file, process): (&RunFile, &Process),
        number: usize,
        role: Role,
        watcher: &mut dyn FnMut(&Event),
    ) -> anyhow::Result<u8> {
        if self.is_cancelled() {
            return Ok(exit::NOTHING);
        }
        let (name, targets, share) = match role {
            Role::Report => return self.close(file, process, number, watcher),
            Role::Cell { batch, number: element } => {
                let wave = self.wave(number)?;
                let found = wave.batches.get(batch).and_then(|batch| batch.elements.get(&element));
                let cell = found.and_then(|cell| wave.cells.cells.get(*cell));
                let cell = cell.ok_or_else(|| anyhow::anyhow!("wave {number} has no element {batch}/{element}"))?;
                let name = format!("w{number}-{batch}-{element}");
                // Jobs that other processes hold are left to them: waiting would waste the allocation.
                let idle = Some(2 * file.lease);
                (name.clone(), cell.nodes.clone(), Share { idle, ..self.share(&name) })
            }
            Role::Pilot { part, of, idle } => {
                let name = format!("w{number}-pilot-{part}");
                let begin = (part - 1) as f64 / of as f64;
                (name.clone(), file.targets.clone(), Share { begin, idle, ..self.share(&name) })
            }
        };
        let options = RunOptions { targets, ..file.options(process, share) };
        let summary = self.attended(number, &name, || run(self.plan, self.store, &options, watcher))?;
        Ok(self.end_of_element(&summary, process))
    }

    /// Does the work of the element `name` of a wave, and records that it began and ended: later waves avoid a node on
    /// which elements begin but do not end.
    pub fn attended<T>(
        &self,
        number: usize,
        name: &str,
        work: impl FnOnce() -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        let attendance = Attendance::begin(&self.folder(), number, name)?;
        let done = work();
        attendance.end()?;
        done
    }

    fn share(&self, name: &str) -> Share {
        Share { name: name.into(), following: None, ..follower(&self.run, &Crew::default()) }
    }

    /// The exit code of an element. An element whose allocation ends before its work is requeued.
    fn end_of_element(&self, summary: &RunSummary, process: &Process) -> u8 {
        let is_unfinished = summary.counts.interrupted + summary.counts.not_run > 0;
        if summary.stopped_by.as_deref() != Some("USR1") || !is_unfinished || self.is_cancelled() {
            return summary.exit_code(false);
        }
        requeue(&process.stop)
    }

    /// Records the end of the run, with its exit code.
    pub fn end(&self, code: u8) -> anyhow::Result<()> {
        Ok(fs::write(self.folder().join(ENDED), format!("{code}\n"))?)
    }

    /// Closes a wave: if cells ended without a result, submits them again; otherwise, or after the last attempt, runs the
    /// jobs that collect results. Returns the exit code of the run, or [`exit::OK`] after submitting again.
    pub fn close(
        &self,
        file: &RunFile,
        process: &Process,
        number: usize,
        watcher: &mut dyn FnMut(&Event),
    ) -> anyhow::Result<u8> {
        let missing = self.missing(file, process)?;
        let collecting = self.cells(&missing).collecting;
        let has_missing_cells = missing.iter().any(|index| !collecting.contains(index));
        if has_missing_cells && number < self.site.cluster.attempts && !self.is_cancelled() {
            self.submit(number + 1, &missing)?;
            return Ok(exit::OK);
        }
        let message = format!("its batch job ended without a result; it was submitted {number} times");
        let share = Share {
            only: Some(collecting),
            missing: Some(Failure::new(FailureKind::Crashed, message).hint("see the logs of the batch jobs")),
            ..self.share(&format!("w{number}-report"))
        };
        let summary = run(self.plan, self.store, &file.options(process, share), watcher)?;
        if summary.stopped_by.is_some() {
            return Ok(self.end_of_element(&summary, process));
        }
        let code = summary.exit_code(false);
        self.end(code)?;
        Ok(code)
    }

    /// The jobs of the run that have neither a result nor a failure.
    fn missing(&self, file: &RunFile, process: &Process) -> anyhow::Result<BTreeSet<usize>> {
        let crew = Crew::default();
        crew.leave();
        let options = file.options(process, Share { name: "census".into(), ..follower(&self.run, &crew) });
        let summary = run(self.plan, self.store, &options, &mut |_| ())?;
        let not_run = |index: &usize| {
            let result = summary.results.get(&self.plan.nodes[*index].name);
            result.is_some_and(|result| matches!(result.outcome, Outcome::NotRun | Outcome::Interrupted))
        };
        Ok((0..self.plan.nodes.len()).filter(not_run).collect())
    }

    /// Cancels all batch jobs of the run, except running ones of [damaged waves](Self::damaged_waves); nothing is submitted
    /// again. Returns the number of cancelled jobs.
    pub fn cancel(&self) -> anyhow::Result<usize> {
        fs::write(self.folder().join(CANCELLED), "")?;
        let jobs = self.jobs()?;
        if !jobs.is_empty() {
            slurm::cancel(&jobs)?;
        }
        self.end(exit::TERMINATED)?;
        Ok(jobs.len())
    }

    /// Whether the user cancelled the run.
    pub fn is_cancelled(&self) -> bool {
        self.folder().join(CANCELLED).exists()
    }

    /// Whether the run has ended.
    pub fn has_ended(&self) -> bool {
        self.folder().join(ENDED).exists()
    }
}

/// Requeues the batch job of this process, and waits to be killed. Returns the exit code. If Slurm refuses, the last
/// job of the wave resubmits the remaining work.
pub fn requeue(stop: &StopRequests) -> u8 {
    if slurm::requeue_own().is_ok() {
        let (requests, tick) = (stop.count(), Duration::from_millis(200));
        let mut waited = Duration::ZERO;
        while stop.count() == requests && waited < REQUEUE_WAIT {
            std::thread::sleep(tick);
            waited += tick;
        }
    }
    exit::CHECKPOINTED
}
