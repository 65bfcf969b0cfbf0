//! Plans: resolved recipes, with the full parameters and the producers of every job, before anything runs.

mod axes;
mod order;
mod select;
#[cfg(test)]
pub(crate) mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::PathBuf;

use petgraph::graph::{DiGraph, NodeIndex};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::fingerprint::{Code, UnusedSources};
use crate::{Coordinates, Decision, Measurements, Work};

pub use axes::IdleAxis;
pub use select::{NothingSelected, matches_pattern};

/// All jobs of a recipe, producers before consumers. Equal recipes give equal plans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The recipe's name.
    pub recipe: String,
    /// The jobs in topological order: the producers of a node have smaller indices than the node.
    pub nodes: Vec<Node>,
    /// The origin of each parameter value: node name → dotted key → origin.
    pub origins: BTreeMap<String, BTreeMap<String, Origin>>,
    /// Names of the jobs that are left out: no job needs them, or they would repeat another.
    pub left_out: Vec<String>,
    /// The device class of the jobs that compute on a device: the user's choice, not part of the recipe.
    pub device: DeviceClass,
    /// The options of the command line that change the recipe, which are not part of it.
    #[serde(default)]
    pub changes: Vec<String>,
}

/// A class of devices whose results count as equal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DeviceClass {
    /// The processor.
    #[default]
    Cpu,
    /// Any GPU.
    Gpu,
}

impl DeviceClass {
    /// The name in keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

/// A job of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// The template's name and the axis values in axis order, e.g. `train/lego/mcgs/0`; unique in a plan.
    pub name: String,
    /// The name of the recipe's node, which has one job per combination of axis values.
    pub template: String,
    /// The stage's id.
    pub stage: String,
    /// The axis values of the job.
    pub coordinates: Coordinates,
    /// The canonical parameters: as the stage's type serializes them, with all defaults.
    pub params: Value,
    /// One entry per port of the stage, in the stage's order.
    pub inputs: Vec<PlanInput>,
    /// The files and folders outside the store that the job reads.
    pub sources: Vec<PlanSource>,
    /// Number of worker threads that the job requests; 0 means all. Never part of a key.
    pub threads: usize,
    /// The expected work, if the stage knows it. Never part of a key.
    pub work: Option<Work>,
    /// Whether the job computes on the device that the user chooses.
    pub on_device: bool,
    /// The name and schema version of the job's artifact type.
    pub output: (String, u32),
    /// The sources of workspace crates that cannot influence the result.
    pub unused_sources: UnusedSources,
    /// The fingerprint of the code that can influence the result.
    pub code: Code,
    /// The effects that the job simulates or leaves out, with reasons. Never part of a key; the parameters are.
    pub decisions: Vec<Decision>,
    /// SHA-256, in hex, over all fields that can influence the result; known before anything runs.
    pub plan_id: String,
}

/// The producers on one port of a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlanInput {
    /// The port's name.
    pub port: String,
    /// The name and schema version of the artifact type that the port reads.
    pub artifact: (String, u32),
    /// Whether the port takes any number of producers, including failed ones.
    pub many: bool,
    /// The use of the producers' measurements.
    pub measurements: Measurements,
    /// Indices of the producers in the plan, in the order in which the stage sees them.
    pub producers: Vec<usize>,
}

/// A file or folder outside the store that a job reads.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlanSource {
    /// The stage's name for the source.
    pub name: String,
    /// The path relative to the data root.
    pub path: PathBuf,
    /// Whether the job also runs without it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub optional: bool,
}

/// The origin of a parameter value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The stage's own default.
    Default,
    /// A key of a node in a recipe file.
    File {
        /// The recipe file.
        file: PathBuf,
        /// The line number, from 1.
        line: usize,
    },
    /// A key of a `[[set]]` rule; rules are numbered from 1, base recipes first.
    Set {
        /// The number of the rule.
        number: usize,
        /// The recipe file.
        file: PathBuf,
        /// The line number, from 1.
        line: usize,
    },
    /// An override on the command line.
    CommandLine,
    /// The stage's resolution with the facts of the job's inputs.
    Resolved,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => write!(f, "default"),
            Self::File { file, line } => write!(f, "{}:{line}", file.display()),
            Self::Set { number, file, line } => {
                write!(f, "set #{number} {}:{line}", file.display())
            }
            Self::CommandLine => write!(f, "-s"),
            Self::Resolved => write!(f, "resolved"),
        }
    }
}

impl Node {
    /// The indices of all producers, each once, in increasing order.
    pub fn producers(&self) -> BTreeSet<usize> {
        self.inputs.iter().flat_map(|input| input.producers.iter().copied()).collect()
    }
}

impl Plan {
    /// The device class that a job of the plan computes on.
    pub fn device_of(&self, node: &Node) -> DeviceClass {
        if node.on_device { self.device } else { DeviceClass::Cpu }
    }

    /// The jobs as a graph. Node weights are indices into `nodes`; edges point from producer to consumer.
    pub fn graph(&self) -> DiGraph<usize, ()> {
        let mut graph = DiGraph::with_capacity(self.nodes.len(), self.nodes.len());
        for (index, node) in self.nodes.iter().enumerate() {
            let consumer = graph.add_node(index);
            for producer in node.producers() {
                graph.add_edge(NodeIndex::new(producer), consumer, ());
            }
        }
        graph
    }

    /// The index of the node called `name`.
    pub fn index_of(&self, name: &str) -> Option<usize> {
        self.nodes.iter().position(|node| node.name == name)
    }

    /// `nodes` and all of their direct and indirect producers.
    pub fn with_ancestors(&self, nodes: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = nodes.clone();
        // Producers come before their consumers, so one backward sweep visits every consumer first.
        for index in (0..self.nodes.len()).rev() {
            if found.contains(&index) {
                found.extend(self.nodes[index].producers());
            }
        }
        found
    }

    /// `nodes` and all of their direct and indirect consumers.
    pub fn with_descendants(&self, nodes: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = nodes.clone();
        for (index, node) in self.nodes.iter().enumerate() {
            if node.producers().iter().any(|producer| found.contains(producer)) {
                found.insert(index);
            }
        }
        found
    }
}
