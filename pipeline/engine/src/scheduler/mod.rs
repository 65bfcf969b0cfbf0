//! The scheduler: runs a plan's jobs as child processes, several at a time, and keeps going when one fails.
//!
//! One thread owns the state. Each running job has a thread that waits for the child and sends messages. A node (a planned
//! job) is dispatched when all its producers are finished. Its action key, the hash of its code, parameters and input
//! contents, is known then. If the store has a result for that key, the job does not run, even if its producers ran again.

mod inputs;
mod launch;
mod share;
mod stop;
mod summary;

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context;

use crate::event::{Counts, Event, EventLog, NodeResult, Outcome};
use crate::job::{Ended, JobStatus, StopRequests};
use crate::store::{ActionRecord, FailureRecord, Lookup};
use crate::{ActionKey, Failure, FailureKind, KeyComponents, Plan, Progress, Store};

pub use inputs::{Done, NodeOutcome, Readiness, Sources, readiness};
pub use share::{Crew, Share};
pub use summary::RunSummary;

use launch::Running;
use share::{Census, Parking};

/// The longest time between two checks of clocks and stop requests while jobs run.
const TICK: Duration = Duration::from_millis(50);

/// The options of a run. None of them is part of an action key, except through the digests of the sources below
/// `data_root`.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// The folder that sources are relative to.
    pub data_root: PathBuf,
    /// The requested nodes; their producers are added.
    pub targets: BTreeSet<usize>,
    /// Nodes that run even if the store has their results.
    pub force: BTreeSet<usize>,
    /// Results that were looked up, and found intact, just before the run; they are not looked up again.
    pub found: BTreeMap<usize, Box<ActionRecord>>,
    /// The maximum number of children at a time.
    pub jobs: usize,
    /// The maximum total number of threads of all children.
    pub threads: usize,
    /// The value of [`JobContext::device`](crate::JobContext::device) for jobs that compute on a device.
    pub device: String,
    /// Whether to profile the jobs.
    pub profile: bool,
    /// The share of its work, between 0 and 1, after which a node's job pauses: it saves a checkpoint and counts as
    /// interrupted, and a later run continues it. Only stages that read [`JobContext::pause_at`](crate::JobContext)
    /// pause.
    pub pause_at: BTreeMap<usize, f64>,
    /// Launch no more jobs after this many failures.
    pub max_failures: Option<usize>,
    /// Stop jobs that run longer than this.
    pub timeout: Option<Duration>,
    /// Hash sources again instead of using the cache.
    pub rehash: bool,
    /// The filter of the jobs' logs.
    pub log_filter: String,
    /// The program and its first arguments; the path of a job's specification is appended.
    pub command: Vec<OsString>,
    /// The user's stop requests.
    pub stop: StopRequests,
    /// The time between two heartbeat events.
    pub heartbeat: Duration,
    /// After this time without a heartbeat, another process may take over a job.
    pub lease: Duration,
    /// This process's part in a run that several processes share; none if it runs alone.
    pub share: Option<Share>,
}

/// The usual length of a lease. A dead process of the same machine is noticed at once; the lease covers frozen processes
/// and other machines.
pub const LEASE: Duration = Duration::from_secs(60);

/// Runs the targets of `plan` and their producers. `watcher` receives every event.
///
/// Failed jobs are part of the summary. An error means that the scheduler could not continue because of
/// the store or the machine.
pub fn run(
    plan: &Plan,
    store: &Store,
    options: &RunOptions,
    watcher: &mut dyn FnMut(&Event),
) -> anyhow::Result<RunSummary> {
    let clock = Instant::now();
    let _in_use = store.enter()?;
    let selected = plan.with_ancestors(&options.targets);
    let (run, events_file) = match &options.share {
        Some(share) if !share.name.is_empty() => (share.run.clone(), format!("events-{}.jsonl", share.name)),
        Some(share) => (share.run.clone(), EVENTS.into()),
        None => (begin(plan, store)?, EVENTS.into()),
    };
    let run_dir = store.run_dir(&run);
    let mut events = EventLog::create(&run_dir.join(&events_file), watcher)?;
    events.emit(&Event::Planned {
        run: run.clone(),
        recipe: plan.recipe.clone(),
        changes: plan.changes.clone(),
        device: plan.device,
        jobs: selected.len(),
    });
    let sources = Sources::digest(plan, &selected, &options.data_root, store, options.rehash)?;

    let mut scheduler = Scheduler::new(plan, store, options, run.clone(), selected, sources, events);
    scheduler.run()?;
    let mut summary = scheduler.finish(clock.elapsed().as_secs_f64());
    let path = run_dir.join(events_file.replace("events", "summary").replace(".jsonl", ".json"));
    if let Err(error) = fs_err::write(&path, serde_json::to_vec_pretty(&summary)?) {
        // The caller still gets the summary.
        summary.not_kept.get_or_insert(format!("cannot write the run's summary: {error}"));
    }
    Ok(summary)
}

/// The file of a run's events.
const EVENTS: &str = "events.jsonl";

/// Creates the folder of a new run, with its plan. Returns the run's name: start time and process id, sortable.
pub fn begin(plan: &Plan, store: &Store) -> anyhow::Result<String> {
    let now = humantime::format_rfc3339_millis(SystemTime::now()).to_string();
    let name = format!("{}-{}", now.replace(['-', ':'], ""), std::process::id());
    let dir = store.run_dir(&name);
    fs_err::create_dir_all(&dir).context("cannot create the run's folder")?;
    fs_err::write(dir.join("plan.json"), serde_json::to_vec(plan)?).context("cannot write the plan")?;
    Ok(name)
}

/// Messages from the threads of running jobs; each begins with the index of the node.
enum Message {
    /// The job's process has started.
    Started(usize),
    Progress(usize, Progress),
    /// Another process has made the result in the meantime.
    Found(usize, Box<ActionRecord>),
    /// The job has failed in another process of this run.
    FoundFailed(usize, Box<FailureRecord>),
    /// Another process has taken the job over.
    Lost(usize),
    /// The job's process has ended, after this time.
    Ended(usize, anyhow::Result<Ended>, Duration),
}

struct Scheduler<'a> {
    plan: &'a Plan,
    store: &'a Store,
    options: &'a RunOptions,
    run: String,
    sources: Sources,
    events: EventLog<'a>,
    selected: BTreeSet<usize>,
    /// The selected consumers of each node.
    consumers: Vec<Vec<usize>>,
    /// The number of unfinished producers of each node.
    unfinished_producers: Vec<usize>,
    /// Nodes whose producers are all finished and that are not dispatched yet.
    ready: BTreeSet<usize>,
    /// The order of each node: the jobs of one table cell (capture, training, renders, metrics) are adjacent.
    ranks: Vec<usize>,
    /// Rank → node that has to run. The lowest queued rank launches next; if it does not fit, later ones wait, so that
    /// narrower jobs of later rank never overtake it.
    queue: BTreeMap<usize, (usize, Box<KeyComponents>)>,
    running: BTreeMap<usize, Running>,
    /// Ready nodes that other processes hold or may launch.
    parking: Parking,
    /// The contents of the store when a shared run began.
    census: Option<Census>,
    /// The action keys of queued, parked and running jobs, each with the other nodes that wait for the same result.
    in_flight: BTreeMap<ActionKey, Vec<usize>>,
    outcomes: Vec<Option<NodeOutcome>>,
    results: BTreeMap<usize, NodeResult>,
    counts: Counts,
    stops_seen: usize,
    last_heartbeat: Instant,
    sender: Sender<Message>,
    receiver: Receiver<Message>,
}

impl<'a> Scheduler<'a> {
    fn new(
        plan: &'a Plan,
        store: &'a Store,
        options: &'a RunOptions,
        run: String,
        selected: BTreeSet<usize>,
        sources: Sources,
        events: EventLog<'a>,
    ) -> Self {
        let mut consumers = vec![Vec::new(); plan.nodes.len()];
        let mut unfinished_producers = vec![0; plan.nodes.len()];
        for &index in &selected {
            for producer in plan.nodes[index].producers() {
                consumers[producer].push(index);
                unfinished_producers[index] += 1;
            }
        }
        let ready = selected.iter().copied().filter(|&index| unfinished_producers[index] == 0).collect();
        let (sender, receiver) = channel();
        let begin = options.share.as_ref().map_or(0.0, |share| share.begin);
        Self {
            plan,
            store,
            options,
            run,
            sources,
            events,
            counts: Counts { total: selected.len(), ..Counts::default() },
            selected,
            consumers,
            unfinished_producers,
            ready,
            ranks: share::ranks_from(begin, plan.depth_first_ranks()),
            queue: BTreeMap::new(),
            running: BTreeMap::new(),
            parking: Parking::default(),
            census: None,
            in_flight: BTreeMap::new(),
            outcomes: vec![None; plan.nodes.len()],
            results: BTreeMap::new(),
            stops_seen: 0,
            last_heartbeat: Instant::now(),
            sender,
            receiver,
        }
    }

    fn run(&mut self) -> anyhow::Result<()> {
        if self.options.share.is_some() {
            // A result that appears later is found when its job is claimed.
            self.census = Some(Census::read(self.store, self.selected.len())?);
        }
        loop {
            while let Some(index) = self.ready.pop_first() {
                self.dispatch(index)?;
            }
            self.handle_stop_requests();
            self.poll_parked()?;
            if !self.ready.is_empty() {
                continue;
            }
            self.launch_jobs()?;
            let waits = !self.parking.is_empty() && !self.has_stopped_launching() && !self.has_stopped_waiting();
            if self.running.is_empty() && !waits {
                // No job runs and none can be launched: all are finished, or launching has stopped.
                return Ok(());
            }
            self.events.flush();
            match self.receiver.recv_timeout(TICK) {
                Ok(message) => self.receive(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the jobs' threads are gone"),
            }
            self.enforce_time_limit();
            self.emit_heartbeat();
        }
    }

    /// Handles a node whose producers are all finished: finishes it without running, takes the result from the store,
    /// or queues its job.
    fn dispatch(&mut self, index: usize) -> anyhow::Result<()> {
        let components = match readiness(self.plan, index, &self.outcomes, &self.sources) {
            Readiness::Waiting => return Ok(()),
            Readiness::Finished(outcome) => {
                self.finish_node(index, outcome, None);
                return Ok(());
            }
            Readiness::Ready(components) => components,
        };
        let key = ActionKey::new(&components);
        if let Some(waiting) = self.in_flight.get_mut(&key) {
            waiting.push(index);
            return Ok(());
        }
        if self.take_result(index, &key)? {
            return Ok(());
        }
        let failed = self.failure_in_crew(&key);
        self.in_flight.insert(key, Vec::new());
        match failed {
            Some(failed) => self.finish_failed(index, failed),
            None if self.may_launch(index) => _ = self.queue.insert(self.ranks[index], (index, components)),
            None => self.park(index, components),
        }
        Ok(())
    }

    /// Finishes a node if the store has its result. Moves a damaged result to quarantine.
    fn take_result(&mut self, index: usize, key: &ActionKey) -> anyhow::Result<bool> {
        if !self.census.as_ref().is_none_or(|census| census.may_have_ended(key)) {
            return Ok(false);
        }
        let found = self.options.found.get(&index).filter(|record| record.key == *key).cloned();
        match found.map_or_else(|| self.store.lookup(key), Lookup::Hit) {
            Lookup::Hit(record) if !self.is_outdated(index, &record) => {
                self.finish_from_record(index, &record);
                return Ok(true);
            }
            Lookup::Damaged { reason, paths } => {
                let message = format!("{} runs again: {reason}", self.plan.nodes[index].name);
                self.events.emit(&Event::Warning { message });
                self.store.discard(&paths).context("cannot move damaged files to quarantine")?;
            }
            Lookup::Hit(_) | Lookup::Miss => {}
        }
        Ok(false)
    }

    fn receive(&mut self, message: Message) {
        let name = |index: usize| self.plan.nodes[index].name.clone();
        match message {
            Message::Started(index) => {
                let Some(job) = self.running.get_mut(&index) else { return };
                job.process_started = Some(Instant::now());
                let (key, threads) = (job.key.to_string(), job.threads);
                self.events.emit(&Event::Started { node: name(index), key, threads });
            }
            Message::Progress(index, progress) => {
                let Some(job) = self.running.get_mut(&index) else { return };
                job.progress = progress.clone();
                self.events.emit(&Event::Progress { node: name(index), progress });
            }
            Message::Found(index, record) => {
                self.running.remove(&index);
                self.finish_in_flight(index, &record);
            }
            Message::FoundFailed(index, failed) => {
                self.running.remove(&index);
                self.finish_failed(index, *failed);
            }
            Message::Lost(index) => {
                let Some(job) = self.running.remove(&index) else { return };
                let message =
                    format!("another process took over {}: this one sent no heartbeat for too long", name(index));
                self.events.emit(&Event::Warning { message });
                self.park(index, job.components);
            }
            Message::Ended(index, ended, wall) => self.receive_end(index, ended, wall),
        }
    }

    /// Finishes the node of an ended child, and all nodes that waited for the same result.
    fn receive_end(&mut self, index: usize, ended: anyhow::Result<Ended>, wall: Duration) {
        let Some(job) = self.running.remove(&index) else { return };
        let key = job.key.clone();
        let (outcome, note) = match ended.map(|ended| ended.status) {
            Ok(JobStatus::Published { content, measurements, note }) => {
                (NodeOutcome::Done(Done { key: key.clone(), content, measurements }), note)
            }
            Ok(JobStatus::Failed(failure)) => (NodeOutcome::Failed { failure, key: Some(key.clone()) }, None),
            Err(error) => {
                let failure = Failure::new(FailureKind::World, format!("{error:#}"));
                (NodeOutcome::Failed { failure, key: Some(key.clone()) }, None)
            }
        };
        let mut result = NodeResult::new(summarize(&outcome, Outcome::Executed));
        result.wall_secs = Some(wall.as_secs_f64());
        result.log_dir = Some(job.dir);
        result.note = note;
        self.finish_node(index, outcome.clone(), Some(result));
        for follower in self.in_flight.remove(&key).unwrap_or_default() {
            self.finish_node(follower, outcome.clone(), None);
        }
    }

    fn finish_from_record(&mut self, index: usize, record: &ActionRecord) {
        self.store.touch(record);
        let done = Done { key: record.key.clone(), content: record.content, measurements: record.measurements };
        self.finish_node(index, NodeOutcome::Done(done), self.result_of_crew(record));
    }

    /// Records the outcome of a node and releases its consumers. `result` has the details of a job that ran.
    fn finish_node(&mut self, index: usize, outcome: NodeOutcome, result: Option<NodeResult>) {
        let mut result = result.unwrap_or_else(|| NodeResult::new(summarize(&outcome, Outcome::Cached)));
        result.failure = outcome.failure().cloned();
        match &outcome {
            NodeOutcome::Done(done) => {
                result.key = Some(done.key.to_string());
                result.content = Some(done.content);
            }
            NodeOutcome::Failed { key, .. } => result.key = key.as_ref().map(ToString::to_string),
            NodeOutcome::Skipped { because_of, .. } => result.because_of = Some(because_of.clone()),
        }
        self.counts.add(result.outcome);
        self.outcomes[index] = Some(outcome);
        let node = self.plan.nodes[index].name.clone();
        self.events.emit(&Event::Finished { node, result: result.clone() });
        self.results.insert(index, result);
        for &consumer in &self.consumers[index] {
            self.unfinished_producers[consumer] -= 1;
            if self.unfinished_producers[consumer] == 0 {
                self.ready.insert(consumer);
            }
        }
    }

    fn emit_heartbeat(&mut self) {
        if self.last_heartbeat.elapsed() < self.options.heartbeat {
            return;
        }
        self.last_heartbeat = Instant::now();
        let own = self.running.iter().map(|(&index, job)| (index, &job.progress));
        let named = |(index, progress): (usize, &Progress)| (self.plan.nodes[index].name.clone(), progress.clone());
        // Each worker would repeat the names of all others.
        let follows = self.options.share.as_ref().is_some_and(|share| share.following.is_some());
        let held = self.parking.held().filter(|_| follows);
        let running: Vec<_> = own.chain(held).map(named).collect();
        let counts = Counts { running: running.len(), ..self.counts };
        self.events.emit(&Event::Heartbeat { counts, running });
    }

    /// Counts the nodes without an outcome (never dispatched or never launched), and summarizes the run.
    fn finish(mut self, wall_secs: f64) -> RunSummary {
        for &index in &self.selected {
            if self.outcomes[index].is_none() {
                self.counts.add(Outcome::NotRun);
                self.results.insert(index, NodeResult::new(Outcome::NotRun));
            }
        }
        self.events.emit(&Event::RunFinished { counts: self.counts, wall_secs });
        self.events.flush();
        let named = self.results.iter().map(|(&index, result)| (self.plan.nodes[index].name.clone(), result.clone()));
        RunSummary {
            run: self.run.clone(),
            recipe: self.plan.recipe.clone(),
            counts: self.counts,
            wall_secs,
            stopped_by: self.stopped_by(),
            sinks: self.selected_sinks(),
            not_kept: self.events.fault(),
            results: named.collect(),
        }
    }

    /// The names of the selected nodes without selected consumers.
    fn selected_sinks(&self) -> Vec<String> {
        let sinks = self.selected.iter().filter(|&&index| self.consumers[index].is_empty());
        sinks.map(|&index| self.plan.nodes[index].name.clone()).collect()
    }
}

/// The kind of outcome; `done` distinguishes executed from cached nodes.
fn summarize(outcome: &NodeOutcome, done: Outcome) -> Outcome {
    match outcome {
        NodeOutcome::Done(_) => done,
        NodeOutcome::Skipped { .. } => Outcome::Skipped,
        NodeOutcome::Failed { failure, .. } => match failure.kind {
            FailureKind::MissingData => Outcome::MissingData,
            FailureKind::Interrupted => Outcome::Interrupted,
            _ => Outcome::Failed,
        },
    }
}
