//! The action key: what a job's result depends on, once its inputs exist.

#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::fingerprint::Code;
use crate::plan::{DeviceClass, Node, PlanInput, PlanSource};
use crate::{Coordinates, FailureKind, Measurements, canonical};

/// The name of a result before it exists: equal keys mean equal results. Lower-case hex, 64 characters.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ActionKey(String);

/// Everything that a job's result may depend on; stored whole, so that two runs can be compared part by part.
///
/// Not in here, since no result depends on them: names of nodes and recipes, paths, threads, hosts, limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyComponents {
    /// The stage's id.
    pub stage: String,
    /// The fingerprint of its code.
    pub code: Code,
    /// The canonical parameters.
    pub params: Value,
    /// What each port reads, in the order in which the stage sees it.
    pub inputs: BTreeMap<String, Vec<KeyInput>>,
    /// The digest of each source by name.
    pub sources: BTreeMap<String, String>,
    /// Name and schema version of the artifact type that the job makes.
    pub output: (String, u32),
    /// The class of device that computes, as `"cpu"` or `"gpu"`.
    pub environment: String,
}

/// One producer on a port.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyInput {
    /// The producer's axis values; empty on a port that takes one producer, where the stage cannot tell them apart.
    pub coordinates: Coordinates,
    /// The digest of its artifact; none if it failed.
    pub content: Option<String>,
    /// The digest of its measurements; none unless the port reads them.
    pub measurements: Option<String>,
    /// Why there is no artifact.
    pub failure: Option<FailureKind>,
}

impl KeyComponents {
    /// The components of `node`'s key.
    ///
    /// `inputs` holds, per port, one entry per producer in the plan's order with all that is known of it; what the
    /// stage does not get to see is dropped here: coordinates on a port for one, measurements on a port without them.
    pub fn of(
        node: &Node,
        mut inputs: BTreeMap<String, Vec<KeyInput>>,
        sources: BTreeMap<String, String>,
        device: DeviceClass,
    ) -> Self {
        for port in &node.inputs {
            for input in inputs.entry(port.port.clone()).or_default() {
                if !port.many {
                    input.coordinates.clear();
                }
                if port.measurements != Measurements::Read {
                    input.measurements = None;
                }
            }
        }
        Self {
            stage: node.stage.clone(),
            code: node.code.clone(),
            params: node.params.clone(),
            inputs,
            sources,
            output: node.output.clone(),
            environment: device.as_str().into(),
        }
    }
}

impl ActionKey {
    /// SHA-256 over the canonical bytes of the components.
    pub fn new(components: &KeyComponents) -> Self {
        // Named one by one, so that a new component cannot be left out of the key by accident.
        let KeyComponents { stage, code, params, inputs, sources, output, environment } = components;
        let inputs: BTreeMap<&String, Vec<Value>> =
            inputs.iter().map(|(port, producers)| (port, producers.iter().map(input_value).collect())).collect();
        Self(canonical::sha256_hex(
            "pipeline/action/1",
            &json!({
                "stage": stage, "code": code, "params": params, "inputs": inputs, "sources": sources,
                "output": output, "environment": environment,
            }),
        ))
    }

    /// The key in hex.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for ActionKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

fn input_value(input: &KeyInput) -> Value {
    let KeyInput { coordinates, content, measurements, failure } = input;
    json!({ "coordinates": coordinates, "content": content, "measurements": measurements, "failure": failure })
}

/// The plan id of `node` (whose own `plan_id` is ignored): SHA-256 over what the recipe says of it and of everything
/// above it. `producers` are the nodes of the plan so far.
pub fn plan_id(node: &Node, producers: &[Node]) -> String {
    let Node {
        name: _,
        template: _,
        stage,
        coordinates: _,
        params,
        inputs,
        sources,
        threads: _,
        on_device: _,
        output,
        unused_sources: _,
        code,
        decisions: _,
        plan_id: _,
    } = node;
    let inputs: BTreeMap<&String, Value> =
        inputs.iter().map(|input| (&input.port, plan_input_value(input, producers))).collect();
    let sources: BTreeMap<&String, String> =
        sources.iter().map(|PlanSource { name, path }| (name, path.to_string_lossy().replace('\\', "/"))).collect();
    canonical::sha256_hex(
        "pipeline/plan/1",
        &json!({ "stage": stage, "code": code, "params": params, "inputs": inputs, "sources": sources, "output": output }),
    )
}

fn plan_input_value(input: &PlanInput, nodes: &[Node]) -> Value {
    let PlanInput { port: _, artifact, many, measurements, producers } = input;
    let producer = |&index: &usize| {
        let coordinates = many.then_some(&nodes[index].coordinates);
        json!({ "coordinates": coordinates, "plan_id": nodes[index].plan_id })
    };
    json!({
        "artifact": artifact, "measurements": *measurements == Measurements::Read,
        "producers": producers.iter().map(producer).collect::<Vec<Value>>(),
    })
}
