//! What a run would do, without doing it: the state of every job, why it would run, and how long it took before.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use crate::explain::{Change, Component, diff};
use crate::graph::NodeState;
use crate::scheduler::{Done, Readiness, Rest, Sources, readiness};
use crate::store::{ActionRecord, FailureRecord, Lookup};
use crate::{ActionKey, DeviceClass, Failure, KeyComponents, Node, Plan, Store, lock};

/// What is known of a job without running anything.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum State {
    /// Its result is in the store.
    Cached {
        /// The record.
        record: Box<ActionRecord>,
    },
    /// It will run.
    WillRun {
        /// Why.
        changes: Vec<Change>,
        /// Its last failure with this very key.
        last_failure: Option<Box<FailureRecord>>,
        /// Whether some process works on it now.
        running: bool,
        /// Whether it was interrupted and left a checkpoint to continue from.
        has_checkpoint: bool,
    },
    /// Something above it will run. Without changes of its own it may be cut off, if that gives what it gave before.
    Pending {
        /// Its own changes, and what it waits for.
        changes: Vec<Change>,
        /// Whether equal inputs would spare it.
        may_be_cut_off: bool,
    },
    /// A source that it reads is not there.
    MissingData {
        /// Which.
        failure: Failure,
    },
    /// Something that it needs cannot be made.
    Blocked {
        /// Why not.
        failure: Failure,
        /// The job at the root.
        because_of: String,
    },
}

/// A job's state and how long it is expected to take.
#[derive(Clone, Debug, Serialize)]
pub struct Prediction {
    /// What is known of it.
    #[serde(flatten)]
    pub state: State,
    /// Wall time of earlier runs of the same job, or else the mean over its stage.
    pub expected_secs: Option<f64>,
}

impl Prediction {
    /// The differences that make it run; none if it will not.
    pub fn changes(&self) -> &[Change] {
        match &self.state {
            State::WillRun { changes, .. } | State::Pending { changes, .. } => changes,
            _ => &[],
        }
    }

    /// Whether a run would launch it (or might).
    pub fn may_run(&self) -> bool {
        matches!(self.state, State::WillRun { .. } | State::Pending { .. })
    }

    /// The state for a picture.
    pub fn node_state(&self) -> NodeState {
        match &self.state {
            State::Cached { .. } => NodeState::Cached,
            State::WillRun { running: true, .. } => NodeState::Running,
            State::WillRun { last_failure: Some(_), .. } => NodeState::Failed,
            State::WillRun { .. } | State::Pending { .. } => NodeState::Planned,
            State::MissingData { .. } | State::Blocked { .. } => NodeState::Blocked,
        }
    }
}

/// Predicts what a run of `nodes` (closed under producers) would do; `force` would run whatever the store has.
///
/// Reads the store and changes nothing in it.
pub fn predict(
    plan: &Plan,
    store: &Store,
    nodes: &BTreeSet<usize>,
    force: &BTreeSet<usize>,
    sources: &Sources,
) -> anyhow::Result<BTreeMap<usize, Prediction>> {
    let mut predictor = Predictor { plan, store, sources, force, history: None, rests: vec![None; plan.nodes.len()] };
    nodes.iter().map(|&index| Ok((index, predictor.predict(index)?))).collect()
}

struct Predictor<'a> {
    plan: &'a Plan,
    store: &'a Store,
    sources: &'a Sources,
    force: &'a BTreeSet<usize>,
    /// Read when the first job turns out to have to run: a plan that is all cached never needs it.
    history: Option<History>,
    rests: Vec<Option<Rest>>,
}

impl Predictor<'_> {
    fn predict(&mut self, index: usize) -> anyhow::Result<Prediction> {
        let state = match readiness(self.plan, index, &self.rests, self.sources) {
            Readiness::AtRest(rest) => {
                self.rests[index] = Some(rest.clone());
                at_rest(rest)
            }
            Readiness::Ready(components) => self.ready(index, &components)?,
            Readiness::Waiting => self.waiting(index)?,
        };
        let node = &self.plan.nodes[index];
        let expected_secs = match &state {
            State::Cached { record } => Some(record.provenance.wall_secs),
            State::WillRun { .. } | State::Pending { .. } => self.history()?.expected_secs(node),
            _ => None,
        };
        Ok(Prediction { state, expected_secs })
    }

    fn ready(&mut self, index: usize, components: &KeyComponents) -> anyhow::Result<State> {
        let key = ActionKey::new(components);
        let found = match self.store.lookup(&key) {
            _ if self.force.contains(&index) => vec![Change::new(Component::Record, "forced")],
            Lookup::Hit(record) => {
                let (content, measurements) = (record.content, record.measurements);
                self.rests[index] = Some(Rest::Done(Done { key, content, measurements }));
                return Ok(State::Cached { record });
            }
            Lookup::Damaged { reason, .. } => vec![Change::new(Component::Record, reason)],
            Lookup::Miss => Vec::new(),
        };
        let last_failure = self.store.failure(&key).map(Box::new);
        let node = &self.plan.nodes[index];
        let recipe = &self.plan.recipe;
        let running = self.is_running(&key);
        let has_checkpoint = !running && self.store.has_checkpoint(&key);
        let changes = match (found.is_empty(), self.history()?.newest(recipe, node, None)) {
            (false, _) => found,
            (true, _) if has_checkpoint => {
                vec![Change::new(Component::Record, "interrupted, continues from a checkpoint")]
            }
            (true, None) => vec![Change::new(Component::Record, "never ran")],
            (true, Some(previous)) if previous.key == key => {
                vec![Change::new(Component::Record, "its record is gone")]
            }
            (true, Some(previous)) => diff(&previous.components, components),
        };
        Ok(State::WillRun { changes, last_failure, running, has_checkpoint })
    }

    /// A job whose inputs are not known: what is known of it is compared, as if its inputs stayed the same.
    fn waiting(&mut self, index: usize) -> anyhow::Result<State> {
        let (plan, sources) = (self.plan, self.sources);
        let node = &plan.nodes[index];
        let Some(previous) = self.history()?.newest(&plan.recipe, node, None) else {
            let changes = vec![Change::new(Component::Record, "never ran")];
            return Ok(State::Pending { changes, may_be_cut_off: false });
        };
        let digests = sources.digests(node).unwrap_or_default();
        let supposed = KeyComponents::of(node, previous.components.inputs.clone(), digests, plan.device_of(node));
        let mut changes = diff(&previous.components, &supposed);
        let may_be_cut_off = changes.is_empty() && !self.force.contains(&index);
        let pending = |&producer: &usize| self.rests[producer].is_none();
        let waits_for: Vec<&str> =
            node.producers().iter().copied().filter(|p| pending(p)).map(|p| plan.nodes[p].name.as_str()).collect();
        let more = if waits_for.len() > 1 { format!(" and {} more", waits_for.len() - 1) } else { String::new() };
        if let Some(first) = waits_for.first() {
            changes.push(Change::new(Component::Input, format!("reads {first}{more}")));
        }
        Ok(State::Pending { changes, may_be_cut_off })
    }

    fn history(&mut self) -> anyhow::Result<&History> {
        if self.history.is_none() {
            self.history = Some(History::read(self.store)?);
        }
        Ok(self.history.get_or_insert_default())
    }

    /// Whether some process holds the action's lock.
    fn is_running(&self, key: &ActionKey) -> bool {
        let file = std::fs::File::open(self.store.lock_file(key.as_str()));
        file.is_ok_and(|file| lock::try_exclusive(&file).is_ok_and(|free| !free))
    }
}

fn at_rest(rest: Rest) -> State {
    match rest {
        Rest::Failed { failure, .. } => State::MissingData { failure },
        Rest::Skipped { failure, because_of } => State::Blocked { failure, because_of },
        // A node comes to rest before it is looked up only for want of something.
        Rest::Done(done) => State::Blocked {
            failure: Failure::new(crate::FailureKind::Crashed, format!("unexpected result {}", done.key)),
            because_of: String::new(),
        },
    }
}

/// What earlier runs recorded.
#[derive(Default)]
pub struct History {
    /// From oldest to newest.
    records: Vec<ActionRecord>,
}

impl History {
    /// Reads all records of the store.
    pub fn read(store: &Store) -> anyhow::Result<Self> {
        let mut records = store.records()?;
        records.sort_by(|a, b| a.provenance.started_at_secs.total_cmp(&b.provenance.started_at_secs));
        Ok(Self { records })
    }

    /// The newest record of the same job: same name and stage in the same recipe, in a run on that class of devices if
    /// one is named.
    pub fn newest(&self, recipe: &str, node: &Node, device: Option<DeviceClass>) -> Option<&ActionRecord> {
        let is_same = |record: &&ActionRecord| {
            let made = &record.provenance;
            let is_job = made.recipe == recipe && made.node == node.name && record.components.stage == node.stage;
            is_job && device.is_none_or(|device| made.device == device)
        };
        self.records.iter().rev().find(is_same)
    }

    /// Seconds that the job took last time, or the mean over all jobs of its stage.
    fn expected_secs(&self, node: &Node) -> Option<f64> {
        let of_stage = self.records.iter().filter(|record| record.components.stage == node.stage);
        let secs = |record: &ActionRecord| record.provenance.wall_secs;
        if let Some(last) = of_stage.clone().rfind(|record| record.provenance.node == node.name) {
            return Some(secs(last));
        }
        let count = of_stage.clone().count();
        (count > 0).then(|| of_stage.map(secs).sum::<f64>() / count as f64)
    }
}
