//! Static facts of artifacts, known before anything runs, and the resolution of a job from them: parameters without
//! open choices, and the optional inputs that the job reads.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The static facts of an artifact: what is certain about it before it exists, by name, e.g. `times: 12`. A missing
/// fact is unknown. The names are a convention between a stage and its readers; the engine does not interpret them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Facts(BTreeMap<String, Value>);

impl Facts {
    /// Adds a fact.
    pub fn with(mut self, name: &str, fact: impl Into<Value>) -> Self {
        self.0.insert(name.into(), fact.into());
        self
    }

    /// A fact that is true or false, if it is known.
    pub fn flag(&self, name: &str) -> Option<bool> {
        self.0.get(name)?.as_bool()
    }

    /// A fact that is a count, if it is known.
    pub fn count(&self, name: &str) -> Option<u64> {
        self.0.get(name)?.as_u64()
    }

    /// A fact of any other type, if it is known.
    pub fn value(&self, name: &str) -> Option<&Value> {
        self.0.get(name)
    }
}

/// The information that resolves a job while the recipe is planned. It never includes the store, so equal recipes and
/// data give equal plans.
#[derive(Clone, Debug)]
pub struct PlanContext<'a> {
    /// The folder that sources are relative to; it may still be empty.
    pub data_root: &'a Path,
    /// The facts of the producers on each port: for [`Stage::work`](crate::Stage::work) only of those that the job
    /// reads, otherwise of all that the recipe wires to it.
    pub inputs: BTreeMap<String, Vec<Facts>>,
}

impl PlanContext<'_> {
    /// Whether the recipe wires anything to this port.
    pub fn is_wired(&self, port: &str) -> bool {
        self.inputs.get(port).is_some_and(|producers| !producers.is_empty())
    }

    /// The facts of the first producer on this port, if there is one.
    pub fn facts(&self, port: &str) -> Option<&Facts> {
        self.inputs.get(port)?.first()
    }
}

/// The resolution of a job: parameters without open choices, and the inputs that it reads.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolution<P> {
    /// The parameters that the job runs with and that are part of its key.
    pub params: P,
    /// Optional ports that the job does not read; their producers are dropped.
    pub unread: BTreeSet<&'static str>,
    /// Port of [`Arity::Choice`](crate::Arity::Choice) → index of the producer that the job reads. A missing port reads
    /// none.
    pub chosen: BTreeMap<&'static str, usize>,
    /// The decisions with their reasons, for the user.
    pub decisions: Vec<Decision>,
    /// Set if the job would repeat another one, with the reason, e.g. because it leaves out an effect that is off. The
    /// plan then leaves out the job and those that read its artifact.
    pub repeats: Option<String>,
}

/// The decision to simulate or leave out an effect, with its reason. Not part of a key, because equal parameters may be
/// chosen for different reasons.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Decision {
    /// The effect, e.g. `flow`.
    pub effect: String,
    /// Whether the job simulates it.
    pub on: bool,
    /// The reason, e.g. `nothing is wired to priors`.
    pub reason: String,
}

impl<P> Resolution<P> {
    /// A resolution that keeps the parameters and reads every optional port.
    pub fn unchanged(params: P) -> Self {
        Self { params, unread: BTreeSet::new(), chosen: BTreeMap::new(), decisions: Vec::new(), repeats: None }
    }

    /// Replaces the parameters.
    pub(crate) fn map<Q, E>(self, change: impl FnOnce(P) -> Result<Q, E>) -> Result<Resolution<Q>, E> {
        let Self { params, unread, chosen, decisions, repeats } = self;
        Ok(Resolution { params: change(params)?, unread, chosen, decisions, repeats })
    }
}
