//! What is known of artifacts before anything runs, and what a job makes of it: parameters that leave nothing open, and
//! the optional inputs that it really reads.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What is known of an artifact before it exists, by name, as `times: 12`; what is not in here is unknown. Engine and
/// stages agree on no names: a stage and its readers do.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Facts(BTreeMap<String, Value>);

impl Facts {
    /// The same facts and one more.
    pub fn with(mut self, name: &str, fact: impl Into<Value>) -> Self {
        self.0.insert(name.into(), fact.into());
        self
    }

    /// Whether something holds, where that is known.
    pub fn flag(&self, name: &str) -> Option<bool> {
        self.0.get(name)?.as_bool()
    }

    /// How many there are of something, where that is known.
    pub fn count(&self, name: &str) -> Option<u64> {
        self.0.get(name)?.as_u64()
    }

    /// A fact of any other shape, where it is known.
    pub fn value(&self, name: &str) -> Option<&Value> {
        self.0.get(name)
    }
}

/// What a job may know while the recipe is planned. Never what lies in a store: equal recipes and data give equal plans.
#[derive(Clone, Debug)]
pub struct PlanContext<'a> {
    /// The folder that sources are relative to; it may hold nothing yet.
    pub data_root: &'a Path,
    /// By port, the facts of every producer that the recipe wires to it.
    pub inputs: BTreeMap<String, Vec<Facts>>,
}

impl PlanContext<'_> {
    /// Whether the recipe wires anything to this port.
    pub fn is_wired(&self, port: &str) -> bool {
        self.inputs.get(port).is_some_and(|producers| !producers.is_empty())
    }

    /// The facts of the one producer on this port, if there is one.
    pub fn facts(&self, port: &str) -> Option<&Facts> {
        self.inputs.get(port)?.first()
    }
}

/// What a job makes of what is known: parameters that leave nothing open, and what it does not need.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolution<P> {
    /// What the job runs with, and what its key holds.
    pub params: P,
    /// Optional ports that are not read with these parameters: whatever the recipe wires to them is left out.
    pub unread: BTreeSet<&'static str>,
    /// By port of [`Arity::Choice`](crate::Arity::Choice), which of its producers is read; by default none.
    pub chosen: BTreeMap<&'static str, usize>,
    /// What was decided and why, for the user.
    pub decisions: Vec<Decision>,
}

/// Something that a job does or leaves out, and why. No part of a key: equal parameters may have been chosen for different
/// reasons.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Decision {
    /// As `flow`.
    pub effect: String,
    /// Whether the job does it.
    pub on: bool,
    /// As `nothing is wired to priors`.
    pub reason: String,
}

impl<P> Resolution<P> {
    /// The parameters as they are; every port is read.
    pub fn unchanged(params: P) -> Self {
        Self { params, unread: BTreeSet::new(), chosen: BTreeMap::new(), decisions: Vec::new() }
    }

    /// The same with other parameters.
    pub(crate) fn map<Q, E>(self, change: impl FnOnce(P) -> Result<Q, E>) -> Result<Resolution<Q>, E> {
        let Self { params, unread, chosen, decisions } = self;
        Ok(Resolution { params: change(params)?, unread, chosen, decisions })
    }
}
