//! Draws a plan as Graphviz DOT or Mermaid, coloured by state.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

use crate::plan::Plan;

/// The state of a job in a drawing. A box for several jobs has the last of their states in this order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NodeState {
    /// The store was not consulted.
    #[default]
    Unknown,
    /// The store has the result.
    Cached,
    /// The job will run.
    Planned,
    /// The job is running.
    Running,
    /// Data is missing, or a producer cannot have a result.
    Blocked,
    /// The last run failed.
    Failed,
}

impl NodeState {
    /// All states, in order.
    pub const ALL: [Self; 6] = [Self::Unknown, Self::Cached, Self::Planned, Self::Running, Self::Blocked, Self::Failed];

    /// The state's name, which JSON uses as well.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Cached => "cached",
            Self::Planned => "planned",
            Self::Running => "running",
            Self::Blocked => "blocked",
            Self::Failed => "failed",
        }
    }

    /// A fill colour on which black text is readable.
    fn colour(self) -> &'static str {
        match self {
            Self::Unknown => "#ffffff",
            Self::Cached => "#c8e6c9",
            Self::Planned => "#fff9c4",
            Self::Running => "#bbdefb",
            Self::Blocked => "#e0e0e0",
            Self::Failed => "#ffcdd2",
        }
    }
}

/// The plan in Graphviz's language. Nodes without an entry in `states` are unknown. `collapse` draws one box per
/// template.
pub fn dot(plan: &Plan, states: &BTreeMap<usize, NodeState>, collapse: bool) -> String {
    let drawing = Drawing::new(plan, states, collapse);
    let mut text = format!("digraph {} {{\n", quoted(&plan.recipe));
    text += "  rankdir=LR;\n  node [shape=box, style=\"rounded,filled\", fontname=\"sans-serif\"];\n";
    for (index, (label, state)) in drawing.boxes.iter().enumerate() {
        let (label, colour) = (quoted(&label.join("\n")).replace('\n', "\\n"), state.colour());
        text += &format!("  n{index} [label={label}, fillcolor=\"{colour}\"];\n");
    }
    for (from, to) in &drawing.edges {
        text += &format!("  n{from} -> n{to};\n");
    }
    text + "}\n"
}

/// The plan in Mermaid's language, which GitHub renders. The arguments are those of [`dot`].
pub fn mermaid(plan: &Plan, states: &BTreeMap<usize, NodeState>, collapse: bool) -> String {
    let drawing = Drawing::new(plan, states, collapse);
    let mut text = String::from("flowchart LR\n");
    for (index, (label, state)) in drawing.boxes.iter().enumerate() {
        let label = label.join("<br/>").replace('"', "#quot;");
        text += &format!("  n{index}[\"{label}\"]:::{}\n", state.name());
    }
    for (from, to) in &drawing.edges {
        text += &format!("  n{from} --> n{to}\n");
    }
    let used: BTreeSet<NodeState> = drawing.boxes.iter().map(|(_, state)| *state).collect();
    for state in used {
        text += &format!("  classDef {} fill:{},stroke:#555,color:#000\n", state.name(), state.colour());
    }
    text
}

/// A drawing, independent of the language.
struct Drawing {
    /// The lines of text and the state of each box.
    boxes: Vec<(Vec<String>, NodeState)>,
    /// Pairs of box indices: producer, consumer.
    edges: BTreeSet<(usize, usize)>,
}

impl Drawing {
    fn new(plan: &Plan, states: &BTreeMap<usize, NodeState>, collapse: bool) -> Self {
        // The nodes of each box: one node, or all nodes of a template.
        let mut members: IndexMap<&str, Vec<usize>> = IndexMap::new();
        for (index, node) in plan.nodes.iter().enumerate() {
            members.entry(if collapse { &node.template } else { &node.name }).or_default().push(index);
        }
        let mut box_of = vec![0; plan.nodes.len()];
        for (drawn, nodes) in members.values().enumerate() {
            nodes.iter().for_each(|&index| box_of[index] = drawn);
        }
        let draw = |nodes: &Vec<usize>| {
            let state = |index: &usize| states.get(index).copied().unwrap_or_default();
            let states: Vec<NodeState> = nodes.iter().map(state).collect();
            let worst = states.iter().copied().max().unwrap_or_default();
            let label = if collapse { template_label(plan, nodes, &states) } else { node_label(plan, nodes[0]) };
            (label, worst)
        };
        let boxes = members.values().map(draw).collect();
        let edge = |(consumer, node): (usize, &crate::Node)| {
            node.producers().into_iter().map(|producer| (box_of[producer], box_of[consumer])).collect::<Vec<_>>()
        };
        Self { boxes, edges: plan.nodes.iter().enumerate().flat_map(edge).collect() }
    }
}

/// The name and the stage of a node.
fn node_label(plan: &Plan, index: usize) -> Vec<String> {
    vec![plan.nodes[index].name.clone(), plan.nodes[index].stage.clone()]
}

/// The template, the number of its jobs, its stage, and the number of jobs in each known state.
fn template_label(plan: &Plan, nodes: &[usize], states: &[NodeState]) -> Vec<String> {
    let node = &plan.nodes[nodes[0]];
    let count = |state: NodeState| (state, states.iter().filter(|other| **other == state).count());
    let known = NodeState::ALL.into_iter().filter(|state| *state != NodeState::Unknown).map(count);
    let counts: Vec<String> =
        known.filter(|(_, count)| *count > 0).map(|(state, count)| format!("{count} {}", state.name())).collect();
    let mut lines = vec![format!("{} × {}", node.template, nodes.len()), node.stage.clone()];
    lines.extend((!counts.is_empty()).then(|| counts.join(", ")));
    lines
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}
