//! Launches jobs: thread slots, and the thread that supervises one child.

use std::path::PathBuf;
use std::sync::mpsc::Sender;
use std::time::Instant;

use anyhow::Context;

use super::{Message, RunOptions, Scheduler, inputs};
use crate::job::{Ended, JobSpec, JobStatus, ProcessHandle, supervise};
use crate::store::{ActionRecord, FailureRecord, Lookup, Provenance, Store};
use crate::{ActionKey, DeviceClass, Failure, FailureKind, KeyComponents, Node, Progress, lock};

/// A launched job, which has a supervising thread.
pub(super) struct Running {
    /// The action key.
    pub(super) key: ActionKey,
    /// The handle that stops the child.
    pub(super) handle: ProcessHandle,
    /// The number of threads that the job may use.
    pub(super) threads: usize,
    /// The folder for logs and status.
    pub(super) dir: PathBuf,
    /// The last reported progress.
    pub(super) progress: Progress,
    /// The start of the process; none while the job waits for another run's result.
    pub(super) process_started: Option<Instant>,
    /// The number of stop requests sent because of the time limit.
    pub(super) time_warnings: usize,
}

impl Scheduler<'_> {
    /// Launches queued jobs in the order of their ranks while slots are free.
    pub(super) fn launch_jobs(&mut self) -> anyhow::Result<()> {
        while let Some((_, &(index, _))) = self.queue.first_key_value() {
            let threads = self.threads_of(index);
            let used: usize = self.running.values().map(|job| job.threads).sum();
            let fits = self.running.len() < self.options.jobs.max(1) && used + threads <= self.options.threads.max(1);
            if self.has_stopped_launching() || !fits {
                break;
            }
            if let Some((_, (index, components))) = self.queue.pop_first() {
                self.launch(index, *components, threads)?;
            }
        }
        Ok(())
    }

    /// The number of threads for a node: as many as it wants, at most all of the run.
    fn threads_of(&self, index: usize) -> usize {
        let all = self.options.threads.max(1);
        match self.plan.nodes[index].threads {
            0 => all,
            wanted => wanted.min(all),
        }
    }

    fn device_of(&self, node: &Node) -> String {
        match self.plan.device_of(node) {
            DeviceClass::Cpu => DeviceClass::Cpu.as_str().into(),
            DeviceClass::Gpu => self.options.device.clone(),
        }
    }

    fn launch(&mut self, index: usize, components: KeyComponents, threads: usize) -> anyhow::Result<()> {
        let node = &self.plan.nodes[index];
        let sources = self.sources.specs(node)?;
        let dir = self.store.run_dir(&self.run).join("jobs").join(&node.name);
        let key = ActionKey::new(&components);
        let spec = JobSpec {
            store: self.store.root().to_owned(),
            run: self.run.clone(),
            recipe: self.plan.recipe.clone(),
            node: node.name.clone(),
            plan_id: node.plan_id.clone(),
            coordinates: node.coordinates.clone(),
            components,
            unused_sources: node.unused_sources.clone(),
            inputs: inputs::input_specs(self.plan, node, &self.outcomes),
            sources,
            threads,
            work: node.work.clone(),
            device: self.device_of(node),
            device_of_run: self.plan.device,
            profile: self.options.profile,
            replace: self.options.force.contains(&index),
            log_filter: self.options.log_filter.clone(),
            dir: dir.clone(),
            parent_pid: std::process::id(),
        };
        let handle = ProcessHandle::default();
        let supervisor = Supervisor {
            index,
            spec,
            key: key.clone(),
            store: self.store.clone(),
            options: self.options.clone(),
            handle: handle.clone(),
            sender: self.sender.clone(),
        };
        // The kernel ends the child with this thread, and this thread with the scheduler.
        let name = format!("job {}", node.name);
        std::thread::Builder::new().name(name).spawn(move || supervisor.run()).context("cannot start a thread")?;
        let progress = Progress::default();
        let job = Running { key, handle, threads, dir, progress, process_started: None, time_warnings: 0 };
        self.running.insert(index, job);
        Ok(())
    }
}

/// The thread that supervises one job.
struct Supervisor {
    index: usize,
    spec: JobSpec,
    key: ActionKey,
    store: Store,
    options: RunOptions,
    handle: ProcessHandle,
    sender: Sender<Message>,
}

impl Supervisor {
    fn run(self) {
        let clock = Instant::now();
        let message = match self.find_or_run() {
            Ok(Ok(record)) => Message::Found(self.index, record),
            Ok(Err(ended)) => Message::Ended(self.index, Ok(ended), clock.elapsed()),
            Err(error) => Message::Ended(self.index, Err(error), clock.elapsed()),
        };
        self.send(message);
    }

    /// Takes the action's lock. Then returns the result of another run if there is one by now, otherwise runs the
    /// child.
    fn find_or_run(&self) -> anyhow::Result<Result<Box<ActionRecord>, Ended>> {
        let lock = lock::open(&self.store.lock_file(self.key.as_str())).context("cannot open a lock")?;
        if !lock::try_exclusive(&lock)? {
            self.send(Message::Waiting(self.index));
            if !lock::wait_exclusive(&lock, || self.handle.stop_requested())? {
                return Ok(Err(stopped_while_waiting()));
            }
        }
        if !self.spec.replace
            && let Lookup::Hit(record) = self.store.lookup(&self.key)
        {
            return Ok(Ok(record));
        }
        self.send(Message::Started(self.index));
        let on_progress = |progress| self.send(Message::Progress(self.index, progress));
        let ended = supervise(&self.options.command, &self.spec, &lock, &self.handle, &on_progress)?;
        if let JobStatus::Failed(failure) = &ended.status
            && failure.kind != FailureKind::Interrupted
        {
            self.record_failure(failure, &ended)?;
        }
        Ok(Err(ended))
    }

    fn record_failure(&self, failure: &Failure, ended: &Ended) -> anyhow::Result<()> {
        let provenance = Provenance {
            recipe: self.spec.recipe.clone(),
            node: self.spec.node.clone(),
            plan_id: self.spec.plan_id.clone(),
            run: self.spec.run.clone(),
            device: self.spec.device_of_run,
            threads: self.spec.threads,
            peak_rss_bytes: ended.peak_rss_bytes,
            ..Provenance::default()
        };
        let components = self.spec.components.clone();
        self.store.put_failure(&FailureRecord::new(components, provenance, failure.clone(), ended.log_tail.clone()))
    }

    fn send(&self, message: Message) {
        // Fails only if the scheduler itself failed; then no thread needs the message.
        let _ = self.sender.send(message);
    }
}

fn stopped_while_waiting() -> Ended {
    let failure = Failure::new(FailureKind::Interrupted, "stopped while waiting for another run's result");
    Ended { status: JobStatus::Failed(failure), peak_rss_bytes: None, log_tail: Vec::new() }
}
