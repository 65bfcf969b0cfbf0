//! Derives the key components of a job from its finished producers and digested sources.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::digest::{SourceDigests, SourceError};
use crate::job::{InputSpec, SourceSpec};
use crate::{
    ActionKey, Digest, Failure, FailureKind, KeyComponents, KeyInput, Measurements, Node, Plan, PlanInput, PlanSource,
    Store,
};

/// The outcome of a finished node, as its consumers see it.
#[derive(Clone, Debug)]
pub enum NodeOutcome {
    /// The store has the node's artifact.
    Done(Done),
    /// The node's job failed.
    Failed {
        /// The failure.
        failure: Failure,
        /// The action key, if all inputs were known.
        key: Option<ActionKey>,
    },
    /// The node was skipped because a direct or indirect producer failed.
    Skipped {
        /// The failure of that producer.
        failure: Failure,
        /// The name of that producer.
        because_of: String,
    },
}

/// The result of a job.
#[derive(Clone, Debug)]
pub struct Done {
    /// The action key.
    pub key: ActionKey,
    /// The digest of the artifact.
    pub content: Digest,
    /// The digest of the measurements.
    pub measurements: Digest,
}

impl NodeOutcome {
    /// The failure, if the node has no artifact.
    pub fn failure(&self) -> Option<&Failure> {
        match self {
            Self::Done(_) => None,
            Self::Failed { failure, .. } | Self::Skipped { failure, .. } => Some(failure),
        }
    }

    fn key_input(&self, producer: &Node) -> KeyInput {
        let coordinates = producer.coordinates.clone();
        match self {
            Self::Done(done) => KeyInput {
                coordinates,
                content: Some(done.content.to_string()),
                measurements: Some(done.measurements.to_string()),
                failure: None,
            },
            Self::Failed { failure, .. } | Self::Skipped { failure, .. } => {
                KeyInput { coordinates, content: None, measurements: None, failure: Some(failure.kind) }
            }
        }
    }

    fn input_spec(&self, producer: &Node, use_of_measurements: Measurements) -> InputSpec {
        let (artifact, key, measurements) = match self {
            Self::Done(done) => (Ok(done.content), Some(&done.key), Some(done.measurements)),
            Self::Failed { failure, key } => (Err(failure.clone()), key.as_ref(), None),
            Self::Skipped { failure, .. } => (Err(failure.clone()), None, None),
        };
        InputSpec {
            producer: producer.name.clone(),
            coordinates: producer.coordinates.clone(),
            artifact,
            measurements: measurements.filter(|_| use_of_measurements != Measurements::Unread),
            action_key: key.map(ToString::to_string).unwrap_or_default(),
        }
    }
}

/// The digests of all sources of the selected nodes, by path relative to the data root.
#[derive(Default)]
pub struct Sources(BTreeMap<PathBuf, Result<SourceState, SourceFailure>>);

struct SourceState {
    digest: Digest,
    spec: SourceSpec,
}

struct SourceFailure {
    failure: Failure,
    /// Whether nothing is at the source's path.
    is_absent: bool,
}

impl Sources {
    /// Digests every source of `nodes`, each once, in parallel, through the store's cache.
    pub fn digest(
        plan: &Plan,
        nodes: &BTreeSet<usize>,
        data_root: &Path,
        store: &Store,
        rehash: bool,
    ) -> anyhow::Result<Self> {
        let paths: BTreeSet<&PathBuf> =
            nodes.iter().flat_map(|&index| plan.nodes[index].sources.iter().map(|source| &source.path)).collect();
        if paths.is_empty() {
            return Ok(Self::default());
        }
        let digests = SourceDigests::load(&store.stat_cache_file(), rehash);
        let states = paths.iter().map(|path| ((*path).clone(), source_state(&digests, data_root, path))).collect();
        if let Some(cache) = digests.changed_cache()? {
            // Without the cache the next run hashes again, which only costs time.
            let _ = store.exists().then(|| store.write_over(&store.stat_cache_file(), &cache));
        }
        Ok(Self(states))
    }

    fn of<'a>(&'a self, node: &'a Node) -> Result<BTreeMap<&'a str, &'a SourceState>, Failure> {
        let state = |source: &'a PlanSource| match self.0.get(&source.path) {
            Some(Ok(state)) => Ok(Some((source.name.as_str(), state))),
            Some(Err(SourceFailure { is_absent: true, .. })) if source.optional => Ok(None),
            Some(Err(SourceFailure { failure, .. })) => Err(failure.clone()),
            None => Err(Failure::new(FailureKind::World, "a source was not digested").at(&source.path)),
        };
        node.sources.iter().filter_map(|source| state(source).transpose()).collect()
    }

    /// The digests of the sources of `node` by name.
    pub fn digests(&self, node: &Node) -> Result<BTreeMap<String, String>, Failure> {
        let states = self.of(node)?.into_iter();
        Ok(states.map(|(name, state)| (name.to_owned(), state.digest.to_string())).collect())
    }

    /// The sources of `node` for its job's specification, by name.
    pub(super) fn specs(&self, node: &Node) -> Result<BTreeMap<String, SourceSpec>, Failure> {
        Ok(self.of(node)?.into_iter().map(|(name, state)| (name.to_owned(), state.spec.clone())).collect())
    }
}

fn source_state(digests: &SourceDigests, data_root: &Path, path: &Path) -> Result<SourceState, SourceFailure> {
    // The user's root may be relative, and the job may run in another folder.
    let present = |failure: Failure| SourceFailure { failure, is_absent: false };
    let absolute = std::path::absolute(data_root.join(path))
        .map_err(|error| present(Failure::new(FailureKind::World, error.to_string()).at(path)))?;
    let typed = |error: SourceError| match error {
        SourceError::Missing(path) => Failure::new(FailureKind::MissingData, "the data is missing")
            .hint("add it, or choose another folder with --data-root")
            .at(path),
        SourceError::Unreadable(path, error) => {
            Failure::new(FailureKind::World, format!("cannot read the data ({error})")).at(path)
        }
        SourceError::Link(path) => {
            let problem = "a link in the data leads nowhere or in a circle";
            Failure::new(FailureKind::BadInput, problem).hint("remove the link or correct its target").at(path)
        }
        SourceError::Name(path) => Failure::new(FailureKind::BadInput, "a file's name is not UTF-8").at(path),
    };
    let failure = |error: SourceError| SourceFailure {
        is_absent: matches!(&error, SourceError::Missing(path) if *path == absolute),
        failure: typed(error),
    };
    // Taken before hashing, so that a change at any later time is detected after the job.
    let stat = SourceDigests::stat_digest(&absolute).map_err(failure)?;
    let digest = digests.digest(&absolute).map_err(failure)?;
    Ok(SourceState { digest, spec: SourceSpec { path: absolute, stat } })
}

/// Whether a node's job can run.
pub enum Readiness {
    /// A producer is not finished.
    Waiting,
    /// The node is finished without running, because data or a producer's artifact is missing.
    Finished(NodeOutcome),
    /// Everything that the result depends on is known.
    Ready(Box<KeyComponents>),
}

/// Whether the job of node `index` can run, given the outcomes of the nodes so far.
///
/// A port for many accepts producers without an artifact and passes their failures to the job, unless one was
/// interrupted: the job would have to run again when that producer continues.
pub fn readiness(plan: &Plan, index: usize, outcomes: &[Option<NodeOutcome>], sources: &Sources) -> Readiness {
    let node = &plan.nodes[index];
    let digests = match sources.digests(node) {
        Ok(digests) => digests,
        Err(failure) => return Readiness::Finished(NodeOutcome::Failed { failure, key: None }),
    };
    if let Some(outcome) = node.inputs.iter().find_map(|port| blocked_by(plan, port, outcomes)) {
        return Readiness::Finished(outcome);
    }
    let mut inputs = BTreeMap::new();
    for port in &node.inputs {
        let key_input = |&producer: &usize| Some(outcomes[producer].as_ref()?.key_input(&plan.nodes[producer]));
        let Some(producers) = port.producers.iter().map(key_input).collect() else { return Readiness::Waiting };
        inputs.insert(port.port.clone(), producers);
    }
    Readiness::Ready(Box::new(KeyComponents::of(node, inputs, digests, plan.device_of(node))))
}

/// The outcome of a job that cannot run because of a producer on this port, if there is such a producer.
fn blocked_by(plan: &Plan, port: &PlanInput, outcomes: &[Option<NodeOutcome>]) -> Option<NodeOutcome> {
    let failure = |producer: usize| outcomes[producer].as_ref().and_then(NodeOutcome::failure);
    let blocks = |&producer: &usize| match failure(producer) {
        None => false,
        Some(failure) => !port.many || failure.kind == FailureKind::Interrupted,
    };
    let producer = port.producers.iter().copied().find(blocks)?;
    Some(match outcomes[producer].clone()? {
        NodeOutcome::Failed { failure, .. } => {
            NodeOutcome::Skipped { failure, because_of: plan.nodes[producer].name.clone() }
        }
        skipped => skipped,
    })
}

/// The finished producers of `node` for its job's specification, by port.
pub(super) fn input_specs(
    plan: &Plan,
    node: &Node,
    outcomes: &[Option<NodeOutcome>],
) -> BTreeMap<String, Vec<InputSpec>> {
    let specs = |port: &PlanInput| {
        let spec =
            |&producer: &usize| Some(outcomes[producer].as_ref()?.input_spec(&plan.nodes[producer], port.measurements));
        port.producers.iter().filter_map(spec).collect()
    };
    node.inputs.iter().map(|port| (port.port.clone(), specs(port))).collect()
}
