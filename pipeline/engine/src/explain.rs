//! Why a job runs: the parts in which two keys differ, and which of many changes came first.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::Code;
use crate::key::{KeyComponents, KeyInput};
use crate::plan::Plan;

/// One difference between what a job was and what it is.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Change {
    /// The part of the job that differs.
    pub component: Component,
    /// The difference in words, as `params.iterations 300 → 500`.
    pub sentence: String,
}

/// The parts of a job that can be a reason to run it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Component {
    /// There is no result to reuse: it never ran, was lost, or is to run again by request.
    Record,
    Stage,
    Code,
    Params,
    Source,
    Output,
    Environment,
    /// What its producers made: the only change that another job can be the cause of.
    Input,
}

impl Change {
    pub fn new(component: Component, sentence: impl Into<String>) -> Self {
        Self { component, sentence: sentence.into() }
    }
}

/// Everything in which `new` differs from `old`; empty for equal keys.
pub fn diff(old: &KeyComponents, new: &KeyComponents) -> Vec<Change> {
    // Named one by one, so that no component is forgotten.
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

/// Walks two values in step; tables are entered, everything else is compared whole.
fn diff_values(key: &str, old: Option<&Value>, new: Option<&Value>, add: &mut impl FnMut(String)) {
    match (old, new) {
        (Some(Value::Object(old)), Some(Value::Object(new))) => {
            let names: BTreeSet<&String> = old.keys().chain(new.keys()).collect();
            let child = |map: &Map<String, Value>, name: &str| map.get(name).cloned();
            for name in names {
                diff_values(&format!("{key}.{name}"), child(old, name).as_ref(), child(new, name).as_ref(), add);
            }
        }
        (Some(old), Some(new)) if old != new => add(format!("{key} {} → {}", shown(old), shown(new))),
        (Some(old), None) => add(format!("{key} {} removed", shown(old))),
        (None, Some(new)) => add(format!("{key} {} added", shown(new))),
        _ => (),
    }
}

/// A value as the user would write it.
fn shown(value: &Value) -> String {
    match value.as_f64() {
        // A parameter of type f32 reaches us as f64 with digits that nobody wrote.
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
            // Several templates may hand over the same coordinates.
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
            (Some(_), None) => sentences.push(format!("{label}: gone")),
            _ => sentences.push(format!("{label}: new")),
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
        (None, Some(failure)) => sentences.push(format!("{label}: failed ({failure:?})")),
        (Some(_), None) => sentences.push(format!("{label}: no longer failed")),
        (Some(old), Some(new)) if old != new => sentences.push(format!("{label}: failure {old:?} → {new:?}")),
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

/// A first cause: jobs of one template that changed by themselves in the same way, and what follows from them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RootCause {
    /// Indices of the jobs, increasing.
    pub nodes: Vec<usize>,
    /// What changed, without the inputs that changed in consequence of another cause.
    pub changes: Vec<Change>,
    /// Further jobs that change only because of their inputs and come after one of these.
    pub consequences: usize,
}

/// The first causes among all changes of a plan (node index → its changes, as [`diff`] or the scheduler gives them).
///
/// A job is a first cause if something other than its inputs changed, or if its inputs changed although no job
/// above it did (somebody else's rerun of a stage that is not reproducible, a repaired store).
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
