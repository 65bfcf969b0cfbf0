//! The resolved recipe: every job with its parameters filled in and its producers known, before anything runs.

mod axes;
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
use crate::{Coordinates, Decision, Measurements};

pub use axes::IdleAxis;
pub use select::{NothingSelected, matches_pattern};

/// All jobs of a recipe, producers before consumers; equal recipes give equal plans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The recipe's name.
    pub recipe: String,
    /// The jobs in topological order: the producers of a node have smaller indices than the node.
    pub nodes: Vec<Node>,
    /// Where each parameter value comes from: node name → dotted key → origin.
    pub origins: BTreeMap<String, BTreeMap<String, Origin>>,
    /// Names of the jobs that the recipe has for others, none of which needs them.
    pub left_out: Vec<String>,
    /// What the jobs compute on that compute on a device: the user's choice, not the recipe's.
    pub device: DeviceClass,
}

/// A class of devices whose results are taken for the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DeviceClass {
    #[default]
    Cpu,
    Gpu,
}

impl DeviceClass {
    /// As keys name it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

/// One job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// The template's name and the axis values in axis order, as `train/lego/mcgs/0`; unique in its plan.
    pub name: String,
    /// The recipe's name for this family of jobs.
    pub template: String,
    /// The stage's id.
    pub stage: String,
    /// The axis values.
    pub coordinates: Coordinates,
    /// The parameters as the stage's own type writes them, with defaults filled in.
    pub params: Value,
    /// One entry per port that the stage declares, in its order.
    pub inputs: Vec<PlanInput>,
    /// The files and folders outside the store that the job reads.
    pub sources: Vec<PlanSource>,
    /// Worker threads wanted; 0 means all. Never part of a key.
    pub threads: usize,
    /// Whether the job computes on the device that the user chose.
    pub on_device: bool,
    /// Name and schema version of the artifact type that the job makes.
    pub output: (String, u32),
    /// The sources below the stage that cannot influence the result.
    pub unused_sources: UnusedSources,
    /// The fingerprint of the code that can influence the result.
    pub code: Code,
    /// What the job does and leaves out, and why. Never part of a key: the parameters say it without the reasons.
    pub decisions: Vec<Decision>,
    /// SHA-256 over everything above that can influence the result, in hex; known before anything runs.
    pub plan_id: String,
}

/// What one port of a node reads.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlanInput {
    /// The port's name.
    pub port: String,
    /// Name and schema version of the artifact type that is read.
    pub artifact: (String, u32),
    /// Whether the port takes any number of producers and failures as outcomes.
    pub many: bool,
    /// What the job does with the producers' measurements.
    pub measurements: Measurements,
    /// Indices of the producers in the plan, in the order in which the stage sees them.
    pub producers: Vec<usize>,
}

/// A file or folder outside the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlanSource {
    /// The name that the stage opens it by.
    pub name: String,
    /// Where it lies, relative to the data root.
    pub path: PathBuf,
}

/// Where a parameter value comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// The stage's own default.
    Default,
    /// A key of a node in a recipe file.
    File { file: PathBuf, line: usize },
    /// A key of the `number`-th `[[set]]` (from 1, base recipes first).
    Set { number: usize, file: PathBuf, line: usize },
    /// An override on the command line.
    CommandLine,
    /// What the stage made of the value, given what is known of its inputs.
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
    /// What a job of the plan computes on.
    pub fn device_of(&self, node: &Node) -> DeviceClass {
        if node.on_device { self.device } else { DeviceClass::Cpu }
    }

    /// The jobs as a graph: weights are indices into `nodes`, edges point from producer to consumer.
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

    /// `nodes` and everything that they need.
    pub fn with_ancestors(&self, nodes: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = nodes.clone();
        // Producers come before their consumers, so that one sweep from the back sees every consumer first.
        for index in (0..self.nodes.len()).rev() {
            if found.contains(&index) {
                found.extend(self.nodes[index].producers());
            }
        }
        found
    }

    /// `nodes` and everything that depends on them.
    pub fn with_descendants(&self, nodes: &BTreeSet<usize>) -> BTreeSet<usize> {
        let mut found = nodes.clone();
        for (index, node) in self.nodes.iter().enumerate() {
            if node.producers().iter().any(|producer| found.contains(producer)) {
                found.insert(index);
            }
        }
        found
    }

    /// The nodes that no other node reads.
    pub fn sinks(&self) -> BTreeSet<usize> {
        let read: BTreeSet<usize> = self.nodes.iter().flat_map(Node::producers).collect();
        (0..self.nodes.len()).filter(|index| !read.contains(index)).collect()
    }
}
