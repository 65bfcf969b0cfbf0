//! Runs that several processes share: each takes ready jobs that no other process holds.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use super::{NodeOutcome, Scheduler};
use crate::event::{Event, NodeResult, Outcome};
use crate::store::{ActionRecord, FailureRecord, Lookup, Watch};
use crate::{ActionKey, Failure, FailureKind, KeyComponents, Progress, Store};

/// The shortest and the longest interval at which the jobs of other processes are polled.
const POLL: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];
/// Above this number of jobs, listing a folder costs less than a query per job.
const MANY: usize = 64;
/// The pause after a poll is this many times the poll's duration, within [`POLL`], so that many waiting jobs do not
/// overload a file server. A poll longer than the longest interval is followed by a pause as long as the poll.
const POLLS_PER_PAUSE: u32 = 20;

/// The part of one process in a run that several processes share.
#[derive(Clone, Debug)]
pub struct Share {
    /// The run's name. Its folder exists and has the plan.
    pub run: String,
    /// This process's name in the run, e.g. `worker-3`; it names the files of its events and of its summary. Empty for the
    /// process that reports to the user.
    pub name: String,
    /// Where in the order of jobs this process begins, from 0 to 1, so that workers do not contend for the same jobs.
    pub begin: f64,
    /// If present, this process launches no job while the crew works.
    pub following: Option<Crew>,
    /// The only jobs that this process may launch; none means all.
    pub only: Option<BTreeSet<usize>>,
    /// The failure of a job that no process works on and that this process may not launch. If none, the job stays
    /// parked and counts as not run at the end.
    pub missing: Option<Failure>,
    /// End after this time without a running job of this process, even if other processes still work.
    pub idle: Option<Duration>,
}

/// The other processes of a shared run, as the process that started them reports.
#[derive(Clone, Debug, Default)]
pub struct Crew(Arc<AtomicU8>);

impl Crew {
    // 0 while the crew works.
    const TAKE_OVER: u8 = 1;
    const LEAVE: u8 = 2;

    /// Reports that the crew has ended; the follower then launches the remaining jobs.
    pub fn take_over(&self) {
        self.0.store(Self::TAKE_OVER, Ordering::SeqCst);
    }

    /// Reports that the crew has ended; the follower then ends as well.
    pub fn leave(&self) {
        self.0.store(Self::LEAVE, Ordering::SeqCst);
    }

    /// Whether the crew has ended.
    pub fn has_ended(&self) -> bool {
        self.is(Self::TAKE_OVER) || self.is(Self::LEAVE)
    }

    fn is(&self, state: u8) -> bool {
        self.0.load(Ordering::SeqCst) == state
    }
}

/// A job that another process holds or may launch.
pub(super) struct Parked {
    components: Box<KeyComponents>,
    key: ActionKey,
    watch: Watch,
    /// Whether [`Event::Waiting`] or [`Event::Started`] has been emitted for the job.
    is_shown: bool,
    /// The progress of the process that held the job at the last poll; `None` if no process did.
    held: Option<Progress>,
}

/// The contents of the store, read with a few listings. With many jobs, a query per job would overload a file server:
/// 1,000 workers and 10⁵ jobs would send 10⁸ queries.
pub(super) struct Census {
    claimed: BTreeSet<String>,
    /// The keys with a record and with a failure; `None` if a query per job costs less.
    results: Option<[BTreeSet<String>; 2]>,
}

impl Census {
    /// Reads the store for `count` jobs.
    pub(super) fn read(store: &Store, count: usize) -> std::io::Result<Self> {
        // Claims first: a job without a claim now and without a result later has ended without one.
        let claimed = store.claimed()?;
        let listed = || Ok::<_, std::io::Error>([store.keys_in("records")?, store.keys_in("failures")?]);
        let results = (count > MANY).then(listed).transpose()?;
        Ok(Self { claimed, results })
    }

    /// Whether the store may have a result or a failure for the key.
    pub(super) fn may_have_ended(&self, key: &ActionKey) -> bool {
        self.results.as_ref().is_none_or(|sets| sets.iter().any(|keys| keys.contains(key.as_str())))
    }
}

/// The jobs that other processes hold, and the time of the next poll.
pub(super) struct Parking {
    jobs: BTreeMap<usize, Parked>,
    next_poll: Instant,
    /// The last time at which this process had a job.
    last_busy: Instant,
    /// Whether the last poll was after the end of the crew.
    is_last: bool,
}

impl Default for Parking {
    fn default() -> Self {
        let now = Instant::now();
        Self { jobs: Default::default(), next_poll: now, last_busy: now, is_last: false }
    }
}

impl Parking {
    pub(super) fn is_empty(&self) -> bool {
        self.jobs.is_empty()
    }

    /// The jobs that other processes ran at the last poll, with their progress.
    pub(super) fn held(&self) -> impl Iterator<Item = (usize, &Progress)> {
        self.jobs.iter().filter_map(|(&index, parked)| Some((index, parked.held.as_ref()?)))
    }
}

/// The failure of a job in another process of a shared run. Failures of the machine do not count: another machine may do
/// better, and each process tries a job once.
pub(super) fn failure_in(share: &Share, store: &Store, key: &ActionKey) -> Option<FailureRecord> {
    let failed = store.failure(key)?;
    (failed.provenance.run == share.run && failed.failure.kind != FailureKind::World).then_some(failed)
}

/// The ranks of nodes for a process that begins at this place in the order, from 0 to 1, and wraps around.
pub(super) fn ranks_from(begin: f64, ranks: Vec<usize>) -> Vec<usize> {
    let count = ranks.len().max(1);
    let first = (begin * count as f64) as usize % count;
    ranks.into_iter().map(|rank| (rank + count - first) % count).collect()
}

impl Scheduler<'_> {
    /// Whether this process may launch a job now.
    pub(super) fn may_launch(&self, index: usize) -> bool {
        let Some(share) = &self.options.share else { return true };
        let follows = share.following.as_ref().is_some_and(|crew| !crew.is(Crew::TAKE_OVER));
        !follows && share.only.as_ref().is_none_or(|only| only.contains(&index))
    }

    /// Parks a job that another process holds or may launch.
    pub(super) fn park(&mut self, index: usize, components: Box<KeyComponents>) {
        let key = ActionKey::new(&components);
        let is_followed = !self.may_launch(index);
        if !is_followed {
            self.events.emit(&Event::Waiting { node: self.plan.nodes[index].name.clone() });
        }
        let parked = Parked { components, key, watch: Watch::default(), is_shown: !is_followed, held: None };
        self.parking.jobs.insert(index, parked);
    }

    /// Whether this process stops waiting for the parked jobs: the crew has left, or this process was idle for too
    /// long.
    pub(super) fn has_stopped_waiting(&self) -> bool {
        let Some(share) = &self.options.share else { return false };
        let is_idle = share.idle.is_some_and(|idle| self.parking.last_busy.elapsed() > idle);
        is_idle || self.parking.is_last
    }

    /// Polls the parked jobs: finishes those with a result, and queues those that no process holds any more.
    pub(super) fn poll_parked(&mut self) -> anyhow::Result<()> {
        if !self.running.is_empty() {
            self.parking.last_busy = Instant::now();
        }
        let crew = self.options.share.as_ref().and_then(|share| share.following.as_ref());
        self.parking.is_last = crew.is_some_and(|crew| crew.is(Crew::LEAVE));
        if self.parking.jobs.is_empty() || (Instant::now() < self.parking.next_poll && !self.parking.is_last) {
            return Ok(());
        }
        let clock = Instant::now();
        let census = Census::read(self.store, self.parking.jobs.len())?;
        let indices: Vec<usize> = self.parking.jobs.keys().copied().collect();
        for index in indices {
            self.poll_job(index, &census)?;
        }
        let pause = (clock.elapsed() * POLLS_PER_PAUSE).clamp(POLL[0], POLL[1].max(clock.elapsed()));
        self.parking.next_poll = Instant::now() + pause;
        Ok(())
    }

    fn poll_job(&mut self, index: usize, census: &Census) -> anyhow::Result<()> {
        let Some(mut parked) = self.parking.jobs.remove(&index) else { return Ok(()) };
        parked.held = None;
        let is_held = census.claimed.contains(parked.key.as_str()) && !self.frees(index, &mut parked)?;
        // Also for a held job: a process that was killed after it published a result leaves its claim behind.
        if census.may_have_ended(&parked.key) && self.finish_parked(index, &parked.key) {
            return Ok(());
        }
        if is_held {
            self.parking.jobs.insert(index, parked);
            return Ok(());
        }
        if self.may_launch(index) {
            self.queue.insert(self.ranks[index], (index, parked.components));
        } else {
            self.keep_or_give_up(index, parked);
        }
        Ok(())
    }

    /// Shows a claimed job as running, and breaks its claim if that has expired and this process may launch the job or give it
    /// up. Returns whether the claim is broken.
    fn frees(&mut self, index: usize, parked: &mut Parked) -> anyhow::Result<bool> {
        self.show_progress(index, parked);
        let gives_up = self.options.share.as_ref().is_some_and(|share| share.missing.is_some());
        let decides = self.may_launch(index) || gives_up;
        Ok(decides && self.store.break_expired_claim(&parked.key, &mut parked.watch, self.options.lease)?)
    }

    /// Finishes a parked job if the store has its result, or its failure in this run. Returns whether it did.
    fn finish_parked(&mut self, index: usize, key: &ActionKey) -> bool {
        if let Lookup::Hit(record) = self.store.lookup(key)
            && !self.is_outdated(index, &record)
        {
            self.finish_in_flight(index, &record);
            return true;
        }
        let failed = self.failure_in_crew(key);
        let has_failed = failed.is_some();
        failed.into_iter().for_each(|failed| self.finish_failed(index, failed));
        has_failed
    }

    /// Handles a job that this process may not launch and that has no result.
    fn keep_or_give_up(&mut self, index: usize, parked: Parked) {
        let missing = self.options.share.as_ref().and_then(|share| share.missing.clone());
        let Some(failure) = missing else {
            self.parking.jobs.insert(index, parked);
            return;
        };
        let record =
            FailureRecord::new(*parked.components, self.provenance(index), failure, Vec::new(), Default::default());
        // Without the record, other processes of the run do not learn why the job has no result.
        let _ = self.store.put_failure(&record);
        self.finish_failed(index, record);
    }

    /// Shows a job of another process as running.
    fn show_progress(&mut self, index: usize, parked: &mut Parked) {
        let holder = self.store.holder(&parked.key);
        parked.held = holder.as_ref().map(|holder| holder.progress.clone());
        let Some(holder) = holder else { return };
        let node = self.plan.nodes[index].name.clone();
        if !parked.is_shown {
            parked.is_shown = true;
            let key = parked.key.to_string();
            self.events.emit(&Event::Started { node: node.clone(), key, threads: holder.threads });
        }
        if holder.progress != Progress::default() {
            self.events.emit(&Event::Progress { node, progress: holder.progress });
        }
    }

    /// The failure of a job in another process of this run.
    pub(super) fn failure_in_crew(&self, key: &ActionKey) -> Option<FailureRecord> {
        failure_in(self.options.share.as_ref()?, self.store, key)
    }

    /// Finishes a node that failed in another process, and the nodes that waited for the same result.
    pub(super) fn finish_failed(&mut self, index: usize, failed: FailureRecord) {
        let outcome = NodeOutcome::Failed { failure: failed.failure, key: Some(failed.key.clone()) };
        let mut result = NodeResult::new(Outcome::Failed);
        result.wall_secs = Some(failed.provenance.wall_secs);
        result.log_dir = Some(failed.log_dir).filter(|dir| dir.is_absolute());
        self.finish_node(index, outcome.clone(), Some(result));
        for follower in self.in_flight.remove(&failed.key).unwrap_or_default() {
            self.finish_node(follower, outcome.clone(), None);
        }
    }

    /// Finishes a queued, parked or running node, and the nodes that waited for the same result.
    pub(super) fn finish_in_flight(&mut self, index: usize, record: &ActionRecord) {
        self.finish_from_record(index, record);
        for follower in self.in_flight.remove(&record.key).unwrap_or_default() {
            self.finish_from_record(follower, record);
        }
    }

    /// Whether a forced job has to run although the store has this record: one of this run is its own result.
    pub(super) fn is_outdated(&self, index: usize, record: &ActionRecord) -> bool {
        self.options.force.contains(&index) && record.provenance.run != self.run
    }

    /// The result of a node whose record another process of this run has made.
    pub(super) fn result_of_crew(&self, record: &ActionRecord) -> Option<NodeResult> {
        let made = &record.provenance;
        let is_of_crew = self.options.share.is_some() && made.run == self.run;
        is_of_crew.then(|| NodeResult { wall_secs: Some(made.wall_secs), ..NodeResult::new(Outcome::Executed) })
    }

    fn provenance(&self, index: usize) -> crate::store::Provenance {
        let node = &self.plan.nodes[index];
        crate::store::Provenance {
            recipe: self.plan.recipe.clone(),
            node: node.name.clone(),
            plan_id: node.plan_id.clone(),
            run: self.run.clone(),
            device: self.plan.device,
            host: crate::process::host_name(),
            ..Default::default()
        }
    }
}
