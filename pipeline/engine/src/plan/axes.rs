//! Idle axes: axes whose values make no difference.

use std::collections::BTreeSet;
use std::fmt;

use super::{Node, Plan};

/// An axis whose values all give the same job: seeds, for example, would agree to the last digit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdleAxis {
    /// The axis's name.
    pub axis: String,
    /// The names of two equal jobs that differ only in the value of this axis.
    pub jobs: [String; 2],
}

impl fmt::Display for IdleAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { axis, jobs: [one, other] } = self;
        write!(f, "axis `{axis}` changes nothing: {one} and {other} are the same job")
    }
}

impl Plan {
    /// The axes that change no parameter and no input of some node that is expanded over them, each with the first such
    /// node.
    pub fn idle_axes(&self) -> Vec<IdleAxis> {
        let mut idle = Vec::<IdleAxis>::new();
        let mut seen = BTreeSet::new();
        for first in self.nodes.iter().filter(|node| seen.insert(&node.template)) {
            let nodes: Vec<&Node> = self.nodes.iter().filter(|node| node.template == first.template).collect();
            for axis in first.coordinates.keys() {
                let pair = idle_pair(&nodes, axis).filter(|_| idle.iter().all(|known| known.axis != *axis));
                idle.extend(pair.map(|jobs| IdleAxis { axis: axis.clone(), jobs }));
            }
        }
        idle
    }
}

/// Two nodes that differ only in the axis, if the nodes of every such pair are the same job.
fn idle_pair(nodes: &[&Node], axis: &str) -> Option<[String; 2]> {
    let differ_in_axis = |a: &Node, b: &Node| {
        a.coordinates.iter().all(|(name, value)| (b.coordinates.get(name) == Some(value)) != (name == axis))
    };
    let mut first = None;
    for (at, a) in nodes.iter().enumerate() {
        for b in nodes[at + 1..].iter().filter(|b| differ_in_axis(a, b)) {
            if a.plan_id != b.plan_id {
                return None;
            }
            first.get_or_insert_with(|| [a.name.clone(), b.name.clone()]);
        }
    }
    first
}
