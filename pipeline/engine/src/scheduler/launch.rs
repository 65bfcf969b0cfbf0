//! Launching: thread slots, and the thread that watches over one child.

use std::path::PathBuf;
use std::sync::mpsc::Sender;
use std::time::Instant;

use anyhow::Context;

use super::{Message, RunOptions, Scheduler, inputs};
use crate::job::{Ended, JobSpec, JobStatus, ProcessHandle, supervise};
use crate::store::{FailureRecord, Lookup, Provenance, Store, naming};
use crate::{ActionKey, DeviceClass, Failure, FailureKind, KeyComponents, Node, Progress, lock};

/// A job with a thread of its own.
pub(super) struct Running {
    pub(super) key: ActionKey,
    pub(super) handle: ProcessHandle,
    pub(super) threads: usize,
    pub(super) dir: PathBuf,
    pub(super) progress: Progress,
    /// None while it waits for another run's result.
    pub(super) process_started: Option<Instant>,
    /// How often it was told that its time is up.
    pub(super) time_warnings: usize,
}

impl Scheduler<'_> {
    /// Launches queued jobs in plan order while there are slots.
    pub(super) fn launch_what_fits(&mut self) -> anyhow::Result<()> {
        while let Some((&index, _)) = self.queue.first_key_value() {
            let threads = self.threads_of(index);
            let used: usize = self.running.values().map(|job| job.threads).sum();
            let fits = self.running.len() < self.options.jobs.max(1) && used + threads <= self.options.threads.max(1);
            if self.launching_has_ended() || !fits {
                break;
            }
            if let Some((index, components)) = self.queue.pop_first() {
                self.launch(index, *components, threads)?;
            }
        }
        Ok(())
    }

    /// Threads that a node gets: as many as it wants, at most all.
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
            inputs: inputs::input_specs(self.plan, node, &self.rests),
            sources,
            threads,
            device: self.device_of(node),
            device_of_run: self.plan.device,
            profile: self.options.profile,
            replace: self.options.force.contains(&index),
            log_filter: self.options.log_filter.clone(),
            dir: dir.clone(),
            parent_pid: std::process::id(),
        };
        let handle = ProcessHandle::default();
        let watch = Watch {
            index,
            spec,
            key: key.clone(),
            store: self.store.clone(),
            options: self.options.clone(),
            handle: handle.clone(),
            sender: self.sender.clone(),
        };
        // The kernel ties the child's life to this thread's, and the thread's to the scheduler's.
        let name = format!("job {}", node.name);
        std::thread::Builder::new().name(name).spawn(move || watch.run()).context("cannot start a thread")?;
        let progress = Progress::default();
        let job = Running { key, handle, threads, dir, progress, process_started: None, time_warnings: 0 };
        self.running.insert(index, job);
        Ok(())
    }
}

/// One job's thread.
struct Watch {
    index: usize,
    spec: JobSpec,
    key: ActionKey,
    store: Store,
    options: RunOptions,
    handle: ProcessHandle,
    sender: Sender<Message>,
}

impl Watch {
    fn run(self) {
        let clock = Instant::now();
        let message = match self.find_or_run() {
            Ok(Ok(found)) => Message::Found(self.index, found),
            Ok(Err(ended)) => Message::Ended(self.index, Ok(ended), clock.elapsed()),
            Err(error) => Message::Ended(self.index, Err(error), clock.elapsed()),
        };
        self.tell(message);
    }

    /// Takes the action's lock, then the result that another run made meanwhile, or else runs the child.
    fn find_or_run(&self) -> anyhow::Result<Result<Box<crate::store::ActionRecord>, Ended>> {
        let lock_file = self.store.lock_file(self.key.as_str());
        let lock = lock::open(&lock_file).map_err(naming(&lock_file)).context("cannot open a lock")?;
        if !lock::try_exclusive(&lock)? {
            self.tell(Message::Waiting(self.index));
            if !lock::wait_exclusive(&lock, || self.handle.told_to_stop())? {
                return Ok(Err(stopped_while_waiting()));
            }
        }
        if !self.spec.replace
            && let Lookup::Hit(record) = self.store.lookup(&self.key)
        {
            return Ok(Ok(record));
        }
        self.tell(Message::Started(self.index));
        let on_progress = |progress| self.tell(Message::Progress(self.index, progress));
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

    fn tell(&self, message: Message) {
        // The scheduler is gone only if it failed; nobody wants to know any more.
        let _ = self.sender.send(message);
    }
}

fn stopped_while_waiting() -> Ended {
    let failure = Failure::new(FailureKind::Interrupted, "stopped while waiting for another run's result");
    Ended { status: JobStatus::Failed(failure), peak_rss_bytes: None, log_tail: Vec::new() }
}
