//! Predicts a run: the state of every job, the changes that make it run, and its expected time.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use serde::Serialize;

use crate::estimate::Estimate;
use crate::explain::{Change, Component, diff};
use crate::graph::NodeState;
use crate::history::History;
use crate::scheduler::{Done, NodeOutcome, Readiness, Sources, readiness};
use crate::store::{ActionRecord, FailureRecord, Lookup};
use crate::{ActionKey, Failure, KeyComponents, Plan, Store};

/// The predicted state of a job.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum State {
    /// The store has the result.
    Cached {
        /// The action record.
        record: Box<ActionRecord>,
    },
    /// The job will run.
    WillRun {
        /// The changes that make it run.
        changes: Vec<Change>,
        /// The last failure with the same key.
        last_failure: Option<Box<FailureRecord>>,
        /// Whether a process is running the job now.
        running: bool,
        /// Whether the job was interrupted and continues from a checkpoint.
        has_checkpoint: bool,
    },
    /// A direct or indirect producer will run. The job is cut off if it has no changes of its own and its inputs stay
    /// equal.
    Pending {
        /// The job's own changes, and the producers that it waits for.
        changes: Vec<Change>,
        /// Whether equal inputs would make the job unnecessary.
        may_be_cut_off: bool,
    },
    /// A source of the job is missing or unusable.
    MissingData {
        /// The failure that names the source.
        failure: Failure,
    },
    /// A direct or indirect producer cannot run.
    Blocked {
        /// The failure of that producer.
        failure: Failure,
        /// The name of that producer.
        because_of: String,
    },
}

/// The predicted state and time of a job.
#[derive(Clone, Debug, Serialize)]
pub struct Prediction {
    /// The state.
    #[serde(flatten)]
    pub state: State,
    /// The wall time of a cached job; for a job that may run, the time predicted from comparable jobs, in seconds. None if
    /// nothing comparable was measured.
    pub expected_secs: Option<f64>,
    /// The measurements behind the predicted time of a job that may run.
    pub estimate: Option<Estimate>,
}

impl Prediction {
    /// The changes that make the job run; empty if it will not run.
    pub fn changes(&self) -> &[Change] {
        match &self.state {
            State::WillRun { changes, .. } | State::Pending { changes, .. } => changes,
            _ => &[],
        }
    }

    /// The failure that names a missing source of the job, if one is missing.
    pub fn missing_data(&self) -> Option<&Failure> {
        match &self.state {
            State::MissingData { failure } if failure.kind == crate::FailureKind::MissingData => Some(failure),
            _ => None,
        }
    }

    /// The record of a job whose result the store has.
    pub fn cached(self) -> Option<Box<ActionRecord>> {
        match self.state {
            State::Cached { record } => Some(record),
            _ => None,
        }
    }

    /// Whether a run would or might launch the job.
    pub fn may_run(&self) -> bool {
        matches!(self.state, State::WillRun { .. } | State::Pending { .. })
    }

    /// The state in a drawing of the plan.
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

/// Predicts a run of `nodes`, which must include all of their producers. Nodes in `force` run even if the store has
/// their results.
///
/// Does not change the store.
pub fn predict(
    plan: &Plan,
    store: &Store,
    nodes: &BTreeSet<usize>,
    force: &BTreeSet<usize>,
    sources: &Sources,
) -> anyhow::Result<BTreeMap<usize, Prediction>> {
    let mut predictor =
        Predictor { plan, store, sources, force, history: None, outcomes: vec![None; plan.nodes.len()] };
    let mut predictions = BTreeMap::new();
    for run in independent_runs(plan, nodes) {
        let found: Vec<Found> = run.par_iter().map(|&index| predictor.find(index)).collect();
        for (index, found) in run.into_iter().zip(found) {
            predictions.insert(index, predictor.predict(index, found)?);
        }
    }
    Ok(predictions)
}

/// `nodes` in runs in which no node reads the result of another one, so that the store can be read for many nodes at a
/// time.
fn independent_runs(plan: &Plan, nodes: &BTreeSet<usize>) -> Vec<Vec<usize>> {
    let mut runs: Vec<Vec<usize>> = Vec::new();
    for &index in nodes {
        let producers = plan.nodes[index].producers();
        match runs.last_mut() {
            Some(run) if producers.iter().all(|&producer| producer < run[0]) => run.push(index),
            _ => runs.push(vec![index]),
        }
    }
    runs
}

/// The state of a job as far as it follows from its inputs and its record.
enum Found {
    Finished(NodeOutcome),
    Ready(Box<KeyComponents>, ActionKey, Lookup),
    Waiting,
}

struct Predictor<'a> {
    plan: &'a Plan,
    store: &'a Store,
    sources: &'a Sources,
    force: &'a BTreeSet<usize>,
    /// Read when the first job has to run: a completely cached plan does not need it.
    history: Option<History>,
    outcomes: Vec<Option<NodeOutcome>>,
}

impl Predictor<'_> {
    fn find(&self, index: usize) -> Found {
        match readiness(self.plan, index, &self.outcomes, self.sources) {
            Readiness::Finished(outcome) => Found::Finished(outcome),
            Readiness::Ready(components) => {
                let key = ActionKey::new(&components);
                let found = self.store.lookup(&key);
                Found::Ready(components, key, found)
            }
            Readiness::Waiting => Found::Waiting,
        }
    }

    fn predict(&mut self, index: usize, found: Found) -> anyhow::Result<Prediction> {
        let state = match found {
            Found::Finished(outcome) => {
                self.outcomes[index] = Some(outcome.clone());
                blocked_state(outcome)
            }
            Found::Ready(components, key, found) => self.ready(index, &components, key, found)?,
            Found::Waiting => self.waiting(index)?,
        };
        let node = &self.plan.nodes[index];
        let (expected_secs, estimate) = match &state {
            State::Cached { record } => (Some(record.provenance.wall_secs), None),
            State::WillRun { .. } | State::Pending { .. } => {
                let plan = self.plan;
                let estimate = self.history()?.estimator().estimate(plan, node);
                (estimate.map(|estimate| estimate.secs), estimate)
            }
            _ => (None, None),
        };
        Ok(Prediction { state, expected_secs, estimate })
    }

    fn ready(
        &mut self,
        index: usize,
        components: &KeyComponents,
        key: ActionKey,
        found: Lookup,
    ) -> anyhow::Result<State> {
        let found = match found {
            _ if self.force.contains(&index) => vec![Change::new(Component::Record, "forced")],
            Lookup::Hit(record) => {
                let (content, measurements) = (record.content, record.measurements);
                self.outcomes[index] = Some(NodeOutcome::Done(Done { key, content, measurements }));
                return Ok(State::Cached { record });
            }
            Lookup::Damaged { reason, .. } => vec![Change::new(Component::Record, reason)],
            Lookup::Miss => Vec::new(),
        };
        let last_failure = self.store.failure(&key).map(Box::new);
        let node = &self.plan.nodes[index];
        let running = self.store.holder(&key).is_some();
        let has_checkpoint = !running && self.store.has_checkpoint(&key);
        let changes = match (found.is_empty(), self.history()?.earlier(node)) {
            (false, _) => found,
            (true, _) if has_checkpoint => {
                vec![Change::new(Component::Record, "interrupted, continues from a checkpoint")]
            }
            (true, None) => vec![Change::new(Component::Record, "never ran")],
            (true, Some(previous)) if previous.key == key => {
                vec![Change::new(Component::Record, "its record was removed")]
            }
            (true, Some(previous)) => diff(&previous.components, components),
        };
        Ok(State::WillRun { changes, last_failure, running, has_checkpoint })
    }

    /// The state of a job with unknown inputs: its key is compared as if the inputs stayed equal.
    fn waiting(&mut self, index: usize) -> anyhow::Result<State> {
        let (plan, sources) = (self.plan, self.sources);
        let node = &plan.nodes[index];
        let Some(previous) = self.history()?.earlier(node) else {
            let changes = vec![Change::new(Component::Record, "never ran")];
            return Ok(State::Pending { changes, may_be_cut_off: false });
        };
        let digests = sources.digests(node).unwrap_or_default();
        let assumed = KeyComponents::of(node, previous.components.inputs.clone(), digests, plan.device_of(node));
        let mut changes = diff(&previous.components, &assumed);
        let may_be_cut_off = changes.is_empty() && !self.force.contains(&index);
        let pending = |&producer: &usize| self.outcomes[producer].is_none();
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
            self.history = Some(History::read(self.store, self.plan)?);
        }
        Ok(self.history.get_or_insert_default())
    }
}

/// The state of a node that is finished before the store is consulted.
fn blocked_state(outcome: NodeOutcome) -> State {
    match outcome {
        NodeOutcome::Failed { failure, .. } => State::MissingData { failure },
        NodeOutcome::Skipped { failure, because_of } => State::Blocked { failure, because_of },
        // `readiness` finishes a node only for lack of data or of a producer's artifact.
        NodeOutcome::Done(done) => State::Blocked {
            failure: Failure::new(crate::FailureKind::Crashed, format!("unexpected result {}", done.key)),
            because_of: String::new(),
        },
    }
}
