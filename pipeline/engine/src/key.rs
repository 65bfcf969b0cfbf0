//! Action keys: hashes of everything that a job's result depends on, known as soon as its inputs exist.

#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::fingerprint::Code;
use crate::plan::{DeviceClass, Node, PlanInput, PlanSource};
use crate::{Coordinates, Digest, FailureKind, Measurements, canonical};

/// The name of a result before it exists. Equal keys mean equal results. 64 characters of lower-case hex.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ActionKey(String);

/// Everything that a job's result may depend on. Records store it unhashed, so that two runs can be compared.
///
/// Names of nodes and recipes, paths, threads, hosts and limits are left out, because no result depends on them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyComponents {
    /// The stage's id.
    pub stage: String,
    /// The fingerprint of the stage's code.
    pub code: Code,
    /// The canonical parameters.
    pub params: Value,
    /// The producers on each port, in the order in which the stage sees them.
    pub inputs: BTreeMap<String, Vec<KeyInput>>,
    /// The digest of each source, by the source's name.
    pub sources: BTreeMap<String, String>,
    /// The name and schema version of the job's artifact type.
    pub output: (String, u32),
    /// The class of device that the job computes on: `"cpu"` or `"gpu"`.
    pub environment: String,
}

/// One producer on a port, as far as the consumer's result may depend on it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyInput {
    /// The producer's axis values; empty on a port for one producer, where they make no difference.
    pub coordinates: Coordinates,
    /// The digest of the artifact; none if the producer failed.
    pub content: Option<String>,
    /// The digest of the measurements; none unless the port reads them.
    pub measurements: Option<String>,
    /// The kind of failure of a producer without an artifact.
    pub failure: Option<FailureKind>,
}

impl KeyComponents {
    /// The components of `node`'s key.
    ///
    /// `inputs` holds one complete entry per producer for each port, in the plan's order. Values that the stage does
    /// not see are removed here: coordinates on a port for one, measurements on a port that does not read them.
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
    /// A name under which a process can claim work that is not a job, e.g. a trial of a search. It differs from the
    /// keys of all jobs.
    pub fn of_work(name: &str) -> Self {
        Self(Digest::of(format!("work: {name}").as_bytes()).to_string())
    }

    /// The key of a job: SHA-256 over the canonical bytes of its components.
    pub fn new(components: &KeyComponents) -> Self {
        // Destructured, so that a new component cannot be left out of the key by accident.
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

/// The plan id of `node`, whose field `plan_id` is ignored: SHA-256 over everything in the plan that can influence its
/// result, including its direct and indirect producers. `producers` are the plan's nodes up to this one.
pub(crate) fn plan_id(node: &Node, producers: &[Node]) -> String {
    let Node {
        name: _,
        template: _,
        stage,
        coordinates: _,
        params,
        inputs,
        sources,
        threads: _,
        work: _,
        on_device: _,
        output,
        unused_sources: _,
        code,
        decisions: _,
        plan_id: _,
    } = node;
    let inputs: BTreeMap<&String, Value> =
        inputs.iter().map(|input| (&input.port, plan_input_value(input, producers))).collect();
    // Whether a source may be missing follows from the parameters.
    let source = |PlanSource { name, path, optional: _ }: &'_ PlanSource| {
        (name.clone(), path.to_string_lossy().replace('\\', "/"))
    };
    let sources: BTreeMap<String, String> = sources.iter().map(source).collect();
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
