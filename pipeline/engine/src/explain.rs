//! Explains why jobs run: the differences between two keys, and the root causes among many changes.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::Code;
use crate::key::{KeyComponents, KeyInput};
use crate::plan::Plan;

/// One difference between a job's earlier key and its current one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Change {
    /// The part of the key that differs.
    pub component: Component,
    /// The difference in words, e.g. `params.iterations 300 → 500`.
    pub sentence: String,
}

/// The parts of a job that can be the reason to run it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Component {
    /// The record: the job never ran, its result was lost, or it is forced to run.
    Record,
    /// The stage.
    Stage,
    /// The code of the stage.
    Code,
    /// The parameters.
    Params,
    /// The files of a source.
    Source,
    /// The type of the artifact.
    Output,
    /// The class of device.
    Environment,
    /// The artifacts of the producers: the only change that another job can cause.
    Input,
}

impl Change {
    /// A change of one component, described by a sentence.
    pub fn new(component: Component, sentence: impl Into<String>) -> Self {
        Self { component, sentence: sentence.into() }
    }
}

/// All differences between two keys; none for equal keys.
pub fn diff(old: &KeyComponents, new: &KeyComponents) -> Vec<Change> {
    // Destructured, so that a new component cannot be forgotten.
    let KeyComponents { stage, code, params, inputs, sources, output, environment } = new;
    let mut changes = Vec::new();
    let mut add = |component, sentence| changes.push(Change::new(component, sentence));
    if old.stage != *stage {
        add(Component::Stage, format!("stage {} → {stage}", old.stage));
    }
    diff_code(&old.code, code).into_iter().for_each(|sentence| add(Component::Code, sentence));
    diff_values("params", Some(&old.params), Some(params), &mut |sentence| add(Component::Params, sentence));
    for name in keys(&old.sources, sources) {
        if let Some(how) = how(old.sources.get(name), sources.get(name)) {
            add(Component::Source, format!("the files of `{name}` {how}"));
        }
    }
    if old.output != *output {
        let (old, new) = (&old.output, output);
        add(Component::Output, format!("output {} schema {} → {} schema {}", old.0, old.1, new.0, new.1));
    }
    if old.environment != *environment {
        add(Component::Environment, format!("environment {} → {environment}", old.environment));
    }
    for port in keys(&old.inputs, inputs) {
        let producers = |inputs: &BTreeMap<String, Vec<KeyInput>>| inputs.get(port).cloned().unwrap_or_default();
        let sentences = diff_inputs(port, &producers(&old.inputs), &producers(inputs));
        sentences.into_iter().for_each(|sentence| add(Component::Input, sentence));
    }
    changes
}

fn diff_code(old: &Code, new: &Code) -> Vec<String> {
    let sentence = |part: &&String| {
        let how = how(old.get(*part), new.get(*part))?;
        Some(match part.strip_suffix(" dependencies") {
            Some(name) => format!("code: external dependencies of {name} {how}"),
            None => format!("code: crate {part} {how}"),
        })
    };
    keys(old, new).iter().filter_map(sentence).collect()
}

/// Compares two values. Tables are compared key by key, all other values as a whole.
fn diff_values(key: &str, old: Option<&Value>, new: Option<&Value>, add: &mut impl FnMut(String)) {
    match (old, new) {
        (Some(Value::Object(old)), Some(Value::Object(new))) => {
            let names: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
            let child = |map: &Map<String, Value>, name: &str| map.get(name).cloned();
            for name in names {
                diff_values(&format!("{key}.{name}"), child(old, name).as_ref(), child(new, name).as_ref(), add);
            }
        }
        (Some(old), Some(new)) if old != new => add(format!("{key} {} → {}", display_value(old), display_value(new))),
        (Some(old), None) => add(format!("{key} {} removed", display_value(old))),
        (None, Some(new)) => add(format!("{key} {} added", display_value(new))),
        _ => (),
    }
}

/// A value as a user would write it.
fn display_value(value: &Value) -> String {
    match value.as_f64() {
        // As an f64, a parameter of type f32 would print more digits than the user wrote.
        Some(float) if value.is_f64() && f64::from(float as f32) == float => {
            format!("{:?}", float as f32)
        }
        _ => value.to_string(),
    }
}

fn diff_inputs(port: &str, old: &[KeyInput], new: &[KeyInput]) -> Vec<String> {
    let by_coordinates = |inputs: &[KeyInput]| -> BTreeMap<String, KeyInput> {
        let name = |(index, input): (usize, &KeyInput)| {
            let values: Vec<String> = input.coordinates.iter().map(|(axis, value)| format!("{axis}={value}")).collect();
            // Producers of several templates may have equal coordinates.
            let twins = inputs[..index].iter().filter(|other| other.coordinates == input.coordinates).count();
            (format!("{}{}", values.join(" "), " again".repeat(twins)), input.clone())
        };
        inputs.iter().enumerate().map(name).collect()
    };
    let (old_named, new_named) = (by_coordinates(old), by_coordinates(new));
    let mut sentences = Vec::new();
    for name in keys(&old_named, &new_named) {
        let label = if name.is_empty() { format!("input {port}") } else { format!("input {port} ({name})") };
        match (old_named.get(name), new_named.get(name)) {
            (Some(old), Some(new)) => sentences.extend(diff_input(&label, old, new)),
            (Some(_), None) => sentences.push(format!("{label}: removed")),
            _ => sentences.push(format!("{label}: added")),
        }
    }
    if sentences.is_empty() && old != new {
        sentences.push(format!("input {port}: order changed"));
    }
    sentences
}

fn diff_input(label: &str, old: &KeyInput, new: &KeyInput) -> Vec<String> {
    let KeyInput { coordinates: _, content, measurements, failure } = new;
    let mut sentences = Vec::new();
    match (&old.failure, failure) {
        (None, Some(failure)) => sentences.push(format!("{label}: failed ({})", failure.words())),
        (Some(_), None) => sentences.push(format!("{label}: no longer failed")),
        (Some(old), Some(new)) if old != new => {
            sentences.push(format!("{label}: failure {} → {}", old.words(), new.words()))
        }
        _ if old.content != *content => sentences.push(format!("{label}: content changed")),
        _ => (),
    }
    if old.measurements != *measurements {
        sentences.push(format!("{label}: measurements changed"));
    }
    sentences
}

fn how<T: PartialEq>(old: Option<&T>, new: Option<&T>) -> Option<&'static str> {
    match (old, new) {
        (Some(old), Some(new)) => (old != new).then_some("changed"),
        (Some(_), None) => Some("removed"),
        (None, Some(_)) => Some("added"),
        (None, None) => None,
    }
}

fn keys<'a, T>(old: &'a BTreeMap<String, T>, new: &'a BTreeMap<String, T>) -> BTreeSet<&'a String> {
    old.keys().chain(new.keys()).collect()
}

/// A root cause: jobs of one template with the same changes of their own, and the number of jobs that follow from them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RootCause {
    /// The indices of the jobs, increasing.
    pub nodes: Vec<usize>,
    /// The changes; without those of inputs if a producer changed as well.
    pub changes: Vec<Change>,
    /// The number of downstream jobs whose inputs are their only change.
    pub consequences: usize,
}

/// The root causes among all changes of a plan. `changes` maps the index of a node to its changes.
///
/// A job is a root cause if anything other than its inputs changed, or if its inputs changed although none of its
/// producers did (e.g. another run recomputed a stage that is not reproducible, or the store was repaired).
pub fn root_causes(plan: &Plan, changes: &BTreeMap<usize, Vec<Change>>) -> Vec<RootCause> {
    let is_changed = |node: &usize| changes.get(node).is_some_and(|changes| !changes.is_empty());
    let mut causes: BTreeMap<(&str, Vec<Change>), BTreeSet<usize>> = BTreeMap::new();
    let mut consequences = BTreeSet::new();
    for (&index, all) in changes.iter().filter(|(index, _)| is_changed(index) && **index < plan.nodes.len()) {
        let node = &plan.nodes[index];
        let is_below = node.producers().iter().any(is_changed);
        let own = all.iter().filter(|change| !is_below || change.component != Component::Input).cloned();
        let own: Vec<Change> = own.collect();
        if own.is_empty() {
            consequences.insert(index);
        } else {
            causes.entry((&node.template, own)).or_default().insert(index);
        }
    }
    let count = |nodes: &BTreeSet<usize>| plan.with_descendants(nodes).intersection(&consequences).count();
    let mut roots: Vec<RootCause> = causes
        .into_iter()
        .map(|((_, changes), nodes)| RootCause {
            consequences: count(&nodes),
            nodes: nodes.into_iter().collect(),
            changes,
        })
        .collect();
    roots.sort_by_key(|root| root.nodes[0]);
    roots
}
