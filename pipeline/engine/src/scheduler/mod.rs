//! The scheduler: runs a plan's jobs as child processes, several at a time, and keeps going when one fails.
//!
//! One thread owns the state; each running job has a thread of its own that waits for the child and sends messages.
//! A node is looked at when all its producers are at rest: its action key is known then, so that an unchanged input
//! cuts the rerun off, however it came about.

mod inputs;
mod launch;
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
use crate::store::{ActionRecord, Lookup, naming};
use crate::{ActionKey, Failure, FailureKind, KeyComponents, Plan, Progress, Store};

pub use inputs::{Done, Readiness, Rest, Sources, readiness};
pub use summary::RunSummary;

use launch::Running;

/// How often the scheduler looks at clocks and stop requests while jobs run.
const TICK: Duration = Duration::from_millis(50);

/// How a plan is run; nothing here can change a result.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// The folder that sources are relative to.
    pub data_root: PathBuf,
    /// The nodes that are asked for; what they need is added.
    pub targets: BTreeSet<usize>,
    /// Nodes that run even if their results are there.
    pub force: BTreeSet<usize>,
    /// At most so many children at once.
    pub jobs: usize,
    /// Threads of all children together.
    pub threads: usize,
    /// The device of the jobs that compute on one, as [`JobContext::device`](crate::JobContext::device) tells it to them.
    pub device: String,
    /// Whether jobs measure closely what time goes into.
    pub profile: bool,
    /// Launch nothing more after so many failures.
    pub max_failures: Option<usize>,
    /// Stop a job that runs longer.
    pub timeout: Option<Duration>,
    /// Hash sources again, whatever the cache says.
    pub rehash: bool,
    /// Filter of the jobs' logs.
    pub log_filter: String,
    /// The program, with its first arguments, that runs the job whose specification is appended.
    pub command: Vec<OsString>,
    /// Requests to stop.
    pub stop: StopRequests,
    /// How often to say that the run is still there.
    pub heartbeat: Duration,
}

/// Runs the targets of `plan` and what they need, telling `watcher` what happens.
///
/// Failed jobs are part of the summary; an error means that the store or the machine failed the scheduler itself.
pub fn run(
    plan: &Plan,
    store: &Store,
    options: &RunOptions,
    watcher: &mut dyn FnMut(&Event),
) -> anyhow::Result<RunSummary> {
    let clock = Instant::now();
    let _in_use = store.enter()?;
    let selected = plan.with_ancestors(&options.targets);
    let (run, run_dir) = new_run(store)?;
    let plan_file = run_dir.join("plan.json");
    std::fs::write(&plan_file, serde_json::to_vec(plan)?)
        .map_err(naming(&plan_file))
        .context("cannot write the plan")?;
    let mut events = EventLog::create(&run_dir.join("events.jsonl"), watcher)?;
    events.emit(&Event::Planned { run: run.clone(), recipe: plan.recipe.clone(), jobs: selected.len() });
    let sources = Sources::digest(plan, &selected, &options.data_root, store, options.rehash)?;

    let mut scheduler = Scheduler::new(plan, store, options, run.clone(), selected, sources, events);
    scheduler.run()?;
    let mut summary = scheduler.finish(clock.elapsed().as_secs_f64());
    let path = run_dir.join("summary.json");
    if let Err(error) = std::fs::write(&path, serde_json::to_vec_pretty(&summary)?) {
        // The caller still learns what came of the jobs.
        summary.not_kept.get_or_insert(format!("cannot write the run's summary ({error}): {}", path.display()));
    }
    Ok(summary)
}

/// A new run's name (its start, sortable) and folder.
fn new_run(store: &Store) -> anyhow::Result<(String, PathBuf)> {
    let now = humantime::format_rfc3339_millis(SystemTime::now()).to_string();
    let name = format!("{}-{}", now.replace(['-', ':'], ""), std::process::id());
    let dir = store.run_dir(&name);
    std::fs::create_dir_all(&dir).map_err(naming(&dir)).context("cannot make the run's folder")?;
    Ok((name, dir))
}

/// What the threads of running jobs tell the scheduler.
enum Message {
    Waiting(usize),
    Started(usize),
    Progress(usize, Progress),
    /// Another run made the result meanwhile.
    Found(usize, Box<ActionRecord>),
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
    /// Selected consumers of each node.
    consumers: Vec<Vec<usize>>,
    /// Producers of each node that are not at rest.
    unfinished_producers: Vec<usize>,
    /// Nodes whose producers are all at rest and that nobody has looked at yet.
    fresh: BTreeSet<usize>,
    /// Nodes that have to run, first come first served in plan order: no job overtakes, so none starves.
    queue: BTreeMap<usize, Box<KeyComponents>>,
    running: BTreeMap<usize, Running>,
    /// Action keys in the queue or running, and the nodes that wait for the same result.
    in_flight: BTreeMap<ActionKey, Vec<usize>>,
    rests: Vec<Option<Rest>>,
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
        let fresh = selected.iter().copied().filter(|&index| unfinished_producers[index] == 0).collect();
        let (sender, receiver) = channel();
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
            fresh,
            queue: BTreeMap::new(),
            running: BTreeMap::new(),
            in_flight: BTreeMap::new(),
            rests: vec![None; plan.nodes.len()],
            results: BTreeMap::new(),
            stops_seen: 0,
            last_heartbeat: Instant::now(),
            sender,
            receiver,
        }
    }

    fn run(&mut self) -> anyhow::Result<()> {
        loop {
            while let Some(index) = self.fresh.pop_first() {
                self.look_at(index)?;
            }
            self.watch_stop_requests();
            self.launch_what_fits()?;
            if self.running.is_empty() {
                // Nothing runs and nothing fits: nothing is left, or launching has ended.
                return Ok(());
            }
            self.events.flush();
            match self.receiver.recv_timeout(TICK) {
                Ok(message) => self.receive(message)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => anyhow::bail!("the jobs' threads are gone"),
            }
            self.watch_time_limits();
            self.beat()?;
        }
    }

    /// Decides about a node whose producers are all at rest: without running, from the store, or into the queue.
    fn look_at(&mut self, index: usize) -> anyhow::Result<()> {
        let components = match readiness(self.plan, index, &self.rests, &self.sources) {
            Readiness::Waiting => return Ok(()),
            Readiness::AtRest(rest) => return self.settle(index, rest, None),
            Readiness::Ready(components) => components,
        };
        let key = ActionKey::new(&components);
        if let Some(waiting) = self.in_flight.get_mut(&key) {
            waiting.push(index);
            return Ok(());
        }
        if !self.options.force.contains(&index) {
            match self.store.lookup(&key) {
                Lookup::Hit(record) => return self.settle_from(index, &record),
                Lookup::Damaged { reason, paths } => {
                    let message = format!("{} runs again: {reason}", self.plan.nodes[index].name);
                    self.events.emit(&Event::Warning { message });
                    self.store.discard(&paths).context("cannot move damaged files to quarantine")?;
                }
                Lookup::Miss => {}
            }
        }
        self.in_flight.insert(key, Vec::new());
        self.queue.insert(index, components);
        Ok(())
    }

    fn receive(&mut self, message: Message) -> anyhow::Result<()> {
        let name = |index: usize| self.plan.nodes[index].name.clone();
        match message {
            Message::Waiting(index) => {
                self.events.emit(&Event::Waiting { node: name(index) });
                Ok(())
            }
            Message::Started(index) => {
                let Some(job) = self.running.get_mut(&index) else { return Ok(()) };
                job.process_started = Some(Instant::now());
                let (key, threads) = (job.key.to_string(), job.threads);
                {
                    self.events.emit(&Event::Started { node: name(index), key, threads });
                    Ok(())
                }
            }
            Message::Progress(index, progress) => {
                let Some(job) = self.running.get_mut(&index) else { return Ok(()) };
                job.progress = progress.clone();
                {
                    self.events.emit(&Event::Progress { node: name(index), progress });
                    Ok(())
                }
            }
            Message::Found(index, record) => {
                let Some(job) = self.running.remove(&index) else { return Ok(()) };
                let followers = self.in_flight.remove(&job.key).unwrap_or_default();
                [index].into_iter().chain(followers).try_for_each(|index| self.settle_from(index, &record))
            }
            Message::Ended(index, ended, wall) => self.receive_end(index, ended, wall),
        }
    }

    /// A child is gone: its node comes to rest, and every node that waited for the same result.
    fn receive_end(&mut self, index: usize, ended: anyhow::Result<Ended>, wall: Duration) -> anyhow::Result<()> {
        let Some(job) = self.running.remove(&index) else { return Ok(()) };
        let key = job.key.clone();
        let (rest, note) = match ended.map(|ended| ended.status) {
            Ok(JobStatus::Published { content, measurements, note }) => {
                (Rest::Done(Done { key: key.clone(), content, measurements }), note)
            }
            Ok(JobStatus::Failed(failure)) => (Rest::Failed { failure, key: Some(key.clone()) }, None),
            Err(error) => {
                let failure = Failure::new(FailureKind::World, format!("{error:#}"));
                (Rest::Failed { failure, key: Some(key.clone()) }, None)
            }
        };
        let followers = self.in_flight.remove(&key).unwrap_or_default();
        let mut result = NodeResult::new(outcome_of(&rest, Outcome::Executed));
        result.wall_secs = Some(wall.as_secs_f64());
        result.log_dir = Some(job.dir);
        result.note = note;
        self.settle(index, rest.clone(), Some(result))?;
        followers.into_iter().try_for_each(|follower| self.settle(follower, rest.clone(), None))
    }

    fn settle_from(&mut self, index: usize, record: &ActionRecord) -> anyhow::Result<()> {
        self.store.touch(record);
        let done = Done { key: record.key.clone(), content: record.content, measurements: record.measurements };
        self.settle(index, Rest::Done(done), None)
    }

    /// Brings a node to rest and tells its consumers. `result` says more if the job ran.
    fn settle(&mut self, index: usize, rest: Rest, result: Option<NodeResult>) -> anyhow::Result<()> {
        let mut result = result.unwrap_or_else(|| NodeResult::new(outcome_of(&rest, Outcome::Cached)));
        result.failure = rest.failure().cloned();
        match &rest {
            Rest::Done(done) => {
                result.key = Some(done.key.to_string());
                result.content = Some(done.content);
            }
            Rest::Failed { key, .. } => result.key = key.as_ref().map(ToString::to_string),
            Rest::Skipped { because_of, .. } => result.because_of = Some(because_of.clone()),
        }
        self.counts.add(result.outcome);
        self.rests[index] = Some(rest);
        let node = self.plan.nodes[index].name.clone();
        self.events.emit(&Event::Finished { node, result: result.clone() });
        self.results.insert(index, result);
        for &consumer in &self.consumers[index] {
            self.unfinished_producers[consumer] -= 1;
            if self.unfinished_producers[consumer] == 0 {
                self.fresh.insert(consumer);
            }
        }
        Ok(())
    }

    fn beat(&mut self) -> anyhow::Result<()> {
        if self.last_heartbeat.elapsed() < self.options.heartbeat {
            return Ok(());
        }
        self.last_heartbeat = Instant::now();
        let counts = Counts { running: self.running.len(), ..self.counts };
        let running =
            self.running.iter().map(|(&index, job)| (self.plan.nodes[index].name.clone(), job.progress.clone()));
        {
            self.events.emit(&Event::Heartbeat { counts, running: running.collect() });
            Ok(())
        }
    }

    /// Counts what never got its turn, and closes the books.
    fn finish(mut self, wall_secs: f64) -> RunSummary {
        for &index in &self.selected {
            if self.rests[index].is_none() {
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

    /// Names of the selected nodes that no selected node reads.
    fn selected_sinks(&self) -> Vec<String> {
        let sinks = self.selected.iter().filter(|&&index| self.consumers[index].is_empty());
        sinks.map(|&index| self.plan.nodes[index].name.clone()).collect()
    }
}

/// The outcome of a node at rest; `done` is the word for one that has its artifact.
fn outcome_of(rest: &Rest, done: Outcome) -> Outcome {
    match rest {
        Rest::Done(_) => done,
        Rest::Skipped { .. } => Outcome::Skipped,
        Rest::Failed { failure, .. } => match failure.kind {
            FailureKind::MissingData => Outcome::MissingData,
            FailureKind::Interrupted => Outcome::Interrupted,
            _ => Outcome::Failed,
        },
    }
}
