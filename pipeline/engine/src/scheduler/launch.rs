//! Launches jobs: thread slots, and the thread that supervises one child.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;

use super::share::failure_in;
use super::{Message, RunOptions, Scheduler, inputs};
use crate::job::{Ended, JobSpec, JobStatus, ProcessHandle, Stop, supervise};
use crate::store::{Claim, FailureRecord, Lookup, Provenance, Store};
use crate::{ActionKey, DeviceClass, Failure, FailureKind, KeyComponents, Node, Progress};

/// The time until the first beat of a claim, which names the child's process.
const FIRST_BEAT: Duration = Duration::from_millis(100);

/// A launched job, which has a supervising thread.
pub(super) struct Running {
    /// The action key.
    pub(super) key: ActionKey,
    /// The components of the key, in case another process takes over the job.
    pub(super) components: Box<KeyComponents>,
    /// The handle that stops the child.
    pub(super) handle: ProcessHandle,
    /// The number of threads that the job may use.
    pub(super) threads: usize,
    /// The folder for logs and status.
    pub(super) dir: PathBuf,
    /// The last reported progress.
    pub(super) progress: Progress,
    /// The start of the process.
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
            let Some((_, (index, components))) = self.queue.pop_first() else { break };
            let key = ActionKey::new(&components);
            match self.store.try_claim(&key, &self.run, threads).context("cannot claim a job")? {
                Some(claim) => self.launch(index, components, threads, claim)?,
                None => self.park(index, components),
            }
        }
        Ok(())
    }

    /// The number of threads for a node: as many as it requests, at most those of the run.
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

    fn launch(
        &mut self,
        index: usize,
        components: Box<KeyComponents>,
        threads: usize,
        claim: Claim,
    ) -> anyhow::Result<()> {
        let node = &self.plan.nodes[index];
        let sources = self.sources.specs(node)?;
        let dir = new_dir(&self.store.run_dir(&self.run).join("jobs").join(&node.name))?;
        let key = ActionKey::new(&components);
        let spec = JobSpec {
            store: self.store.root().to_owned(),
            run: self.run.clone(),
            recipe: self.plan.recipe.clone(),
            node: node.name.clone(),
            plan_id: node.plan_id.clone(),
            coordinates: node.coordinates.clone(),
            components: (*components).clone(),
            unused_sources: node.unused_sources.clone(),
            inputs: inputs::input_specs(self.plan, node, &self.outcomes),
            sources,
            threads,
            work: node.work.clone(),
            device: self.device_of(node),
            device_of_run: self.plan.device,
            profile: self.options.profile,
            pause_at: self.options.pause_at.get(&index).copied(),
            replace: self.options.force.contains(&index),
            log_filter: self.options.log_filter.clone(),
            dir: dir.clone(),
            parent_pid: std::process::id(),
        };
        let handle = ProcessHandle::default();
        let supervisor = Supervisor {
            index,
            claim: Mutex::new(claim),
            progress: Mutex::default(),
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
        let job = Running { key, components, handle, threads, dir, progress, process_started: None, time_warnings: 0 };
        self.running.insert(index, job);
        Ok(())
    }
}

/// Creates the folder of a job's attempt. A job that another process of the run has tried gets a separate folder, so that
/// the logs of all attempts are kept.
fn new_dir(path: &Path) -> anyhow::Result<PathBuf> {
    fs_err::create_dir_all(path.parent().unwrap_or(path)).context("cannot create the job's folder")?;
    for attempt in 1.. {
        let dir = if attempt == 1 { path.to_owned() } else { path.with_added_extension(attempt.to_string()) };
        match fs_err::create_dir(&dir) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error).context("cannot create the job's folder"),
            Ok(()) => return Ok(dir),
        }
    }
    unreachable!("some attempt has no folder yet")
}

/// The thread that supervises one job.
struct Supervisor {
    index: usize,
    claim: Mutex<Claim>,
    progress: Mutex<Progress>,
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
            Ok(message) => message.unwrap_or_else(|ended| Message::Ended(self.index, Ok(ended), clock.elapsed())),
            Err(error) => Message::Ended(self.index, Err(error), clock.elapsed()),
        };
        let Self { claim, sender, .. } = self;
        // Released first: a process that learns of the end may read the claim.
        drop(claim);
        // Fails only if the scheduler itself failed; then no thread needs the message.
        let _ = sender.send(message);
    }

    /// Returns the result of another process if there is one by now, otherwise runs the child.
    fn find_or_run(&self) -> anyhow::Result<Result<Message, Ended>> {
        if let Some(message) = self.found() {
            return Ok(Ok(message));
        }
        self.send(Message::Started(self.index));
        let (ended, is_lost) = self.supervise()?;
        let JobStatus::Failed(failure) = &ended.status else { return Ok(Err(ended)) };
        // Another process may have published the result and removed the checkpoints that this one was writing to.
        if let Some(message) = self.found() {
            return Ok(Ok(message));
        }
        if is_lost {
            return Ok(Ok(Message::Lost(self.index)));
        }
        if failure.kind != FailureKind::Interrupted {
            self.record_failure(failure, &ended)?;
        }
        Ok(Err(ended))
    }

    /// The result or failure of the job in another process.
    fn found(&self) -> Option<Message> {
        if let Lookup::Hit(record) = self.store.lookup(&self.key)
            && (!self.spec.replace || record.provenance.run == self.spec.run)
        {
            return Some(Message::Found(self.index, record));
        }
        let failed = failure_in(self.options.share.as_ref()?, &self.store, &self.key)?;
        Some(Message::FoundFailed(self.index, Box::new(failed)))
    }

    /// Runs the child while another thread keeps the claim alive. Returns how it ended, and whether the claim was lost.
    fn supervise(&self) -> anyhow::Result<(Ended, bool)> {
        let on_progress = |progress: Progress| {
            *self.progress.lock().unwrap_or_else(PoisonError::into_inner) = progress.clone();
            self.send(Message::Progress(self.index, progress));
        };
        std::thread::scope(|scope| {
            let (ended_sender, ended_receiver) = channel::<()>();
            let beats = scope.spawn(move || {
                let wait = |time| ended_receiver.recv_timeout(time) == Err(RecvTimeoutError::Timeout);
                self.keep_claim(wait)
            });
            let ended = supervise(&self.options.command, &self.spec, &self.handle, &on_progress);
            drop(ended_sender);
            let is_lost = beats.join().unwrap_or(false);
            Ok((ended?, is_lost))
        })
    }

    /// Writes beats until the job has ended or the claim is lost. If it is lost, kills the child, because the job and
    /// its progress now belong to the new holder. `wait` waits for a time and returns whether the job still runs.
    /// Returns whether the claim was lost.
    fn keep_claim(&self, wait: impl Fn(Duration) -> bool) -> bool {
        let mut time = FIRST_BEAT.min(self.options.lease);
        while wait(time) {
            let progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner).clone();
            let mut claim = self.claim.lock().unwrap_or_else(PoisonError::into_inner);
            // While the store cannot be reached, no other process can take the claim either.
            if !claim.beat(self.handle.pid(), &progress).unwrap_or(true) {
                self.handle.stop(Stop::Kill);
                return true;
            }
            time = Claim::interval(self.options.lease);
        }
        false
    }

    fn record_failure(&self, failure: &Failure, ended: &Ended) -> anyhow::Result<()> {
        let provenance = Provenance {
            recipe: self.spec.recipe.clone(),
            node: self.spec.node.clone(),
            plan_id: self.spec.plan_id.clone(),
            run: self.spec.run.clone(),
            device: self.spec.device_of_run,
            host: crate::process::host_name(),
            threads: self.spec.threads,
            peak_rss_bytes: ended.peak_rss_bytes,
            ..Provenance::default()
        };
        let components = self.spec.components.clone();
        let (log_tail, log_dir) = (ended.log_tail.clone(), self.spec.dir.clone());
        self.store.put_failure(&FailureRecord::new(components, provenance, failure.clone(), log_tail, log_dir))
    }

    fn send(&self, message: Message) {
        // Fails only if the scheduler itself failed; then no thread needs the message.
        let _ = self.sender.send(message);
    }
}
