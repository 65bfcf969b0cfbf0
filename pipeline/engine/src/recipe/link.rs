//! From jobs to the graph: the producers of each, what it makes of what is known of them, and who is needed after that.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::Value;

use super::errors::Report;
use super::raw::{RawRecipe, Template};
use super::resolve::{Draft, add_origins, add_problem, known_of};
use crate::fingerprint::{Code, UnusedSources};
use crate::key::plan_id;
use crate::plan::{Node, Origin, Plan, PlanInput};
use crate::registry::AnyStage;
use crate::{Arity, Facts, PlanContext, Port, Registry, Resolution};

/// Axis index and text of each value of a job.
type Values = Vec<(usize, String)>;

/// Joins the jobs, template by template in the given order, so that producers come first.
pub(super) fn link(
    recipe: &RawRecipe,
    registry: &Registry,
    data_root: &Path,
    order: &[usize],
    mut drafts: Vec<Vec<Draft>>,
    name: String,
    report: &mut Report,
) -> Plan {
    let mut linker = Linker {
        recipe,
        registry,
        data_root,
        plan: Plan {
            recipe: name,
            nodes: Vec::new(),
            origins: BTreeMap::new(),
            left_out: Vec::new(),
            device: Default::default(),
        },
        made: vec![Vec::new(); drafts.len()],
        facts: Vec::new(),
        wired: Vec::new(),
        codes: BTreeMap::new(),
        report,
    };
    for &index in order {
        std::mem::take(&mut drafts[index]).into_iter().for_each(|draft| linker.add(index, draft));
    }
    linker.finish()
}

struct Linker<'a> {
    recipe: &'a RawRecipe,
    registry: &'a Registry,
    data_root: &'a Path,
    plan: Plan,
    /// Template → the nodes made of it, each with the axis values that tell it from the others.
    made: Vec<Vec<(usize, Values)>>,
    /// What is known of each node's artifact.
    facts: Vec<Facts>,
    /// The producers that the recipe wires to each node, read or not.
    wired: Vec<BTreeSet<usize>>,
    /// Fingerprints by stage and unused sources: many jobs share one.
    codes: BTreeMap<(&'a str, UnusedSources), Code>,
    report: &'a mut Report,
}

impl<'a> Linker<'a> {
    /// Makes a node of a job; its producers are nodes already.
    fn add(&mut self, index: usize, mut draft: Draft) {
        let recipe = self.recipe;
        let (template_name, template) = recipe.templates.get_index(index).expect("an index of the recipe");
        let stage = self.registry.get(&template.stage.name).expect("checked before");
        let values: Values = draft.instance.values.iter().map(|(axis, value)| (*axis, value.text.clone())).collect();
        let ports = stage.ports();
        let mut inputs: Vec<PlanInput> =
            ports.iter().map(|port| plan_input(recipe, template, port, &values, &self.made)).collect();
        self.wired.push(inputs.iter().flat_map(|input| input.producers.iter().copied()).collect());
        self.refuse_gaps(template_name, template, &ports, &inputs);

        // What the stage makes of what is known of its producers decides which of them it reads.
        let context = self.context(&inputs);
        let resolution = self.resolve(stage, template_name, template, &mut draft, &context);
        for (input, port) in inputs.iter_mut().zip(&ports) {
            let chosen = resolution.chosen.get(port.name).and_then(|&chosen| input.producers.get(chosen)).copied();
            match port.arity {
                Arity::Optional if resolution.unread.contains(port.name) => input.producers.clear(),
                Arity::Choice => input.producers = chosen.into_iter().collect(),
                Arity::One | Arity::Optional | Arity::Many => (),
            }
        }
        let facts = stage.facts(&resolution.params, &context);
        self.facts.push(facts.expect("the stage wrote these parameters itself"));

        let unused_sources = unused_sources(stage, draft.known.unused_sources, &inputs, &self.plan.nodes);
        let code = self.codes.entry((stage.id(), unused_sources.clone()));
        let code = code.or_insert_with(|| self.registry.code(stage.id(), &unused_sources)).clone();
        let mut node = Node {
            name: draft.instance.name,
            template: template_name.clone(),
            stage: stage.id().into(),
            coordinates: draft.instance.coordinates,
            params: resolution.params,
            inputs,
            sources: draft.known.sources,
            threads: draft.known.threads,
            on_device: stage.on_device(),
            output: (stage.output().0.into(), stage.output().1),
            unused_sources,
            code,
            decisions: resolution.decisions,
            plan_id: String::new(),
        };
        node.plan_id = plan_id(&node, &self.plan.nodes);
        self.made[index].push((self.plan.nodes.len(), values));
        self.plan.origins.insert(node.name.clone(), draft.origins);
        self.plan.nodes.push(node);
    }

    /// A producer that is there for some values only leaves those who need it for others without.
    fn refuse_gaps(&mut self, name: &str, template: &Template, ports: &[Port], inputs: &[PlanInput]) {
        for (port, _) in
            ports.iter().zip(inputs).filter(|(port, input)| port.arity == Arity::One && input.producers.is_empty())
        {
            let Some(wire) = template.inputs.iter().find(|wire| wire.port.name == port.name) else { continue };
            let message = format!("no producer on port `{}` for some of the node's jobs", port.name);
            let hint = Some("give this node the same `only` as its producer".into());
            self.report.add(&wire.port.at, format!("nodes.{name}.inputs.{}", port.name), message, hint);
        }
    }

    /// What is known of the producers on each port.
    fn context(&self, inputs: &[PlanInput]) -> PlanContext<'a> {
        let facts = |input: &PlanInput| input.producers.iter().map(|&index| self.facts[index].clone()).collect();
        let inputs = inputs.iter().map(|input| (input.port.clone(), facts(input))).collect();
        PlanContext { data_root: self.data_root, inputs }
    }

    /// The job's resolved parameters, with what the stage says of them in the draft; problems go to the report.
    fn resolve(
        &mut self,
        stage: &dyn AnyStage,
        name: &str,
        template: &Template,
        draft: &mut Draft,
        context: &PlanContext<'_>,
    ) -> Resolution<Value> {
        let resolution = stage.resolve(&draft.params, context).unwrap_or_else(|problems| {
            let mut add = |problem| add_problem(name, template, &draft.instance.params, problem, self.report);
            problems.iter().for_each(&mut add);
            Resolution::unchanged(draft.params.clone())
        });
        if resolution.params != draft.params {
            note_resolved(&mut draft.origins, &draft.params, &resolution.params);
            match known_of(stage, &resolution.params) {
                Ok(known) => draft.known = known,
                Err(error) => self.report.add(&template.at, format!("nodes.{name}"), format!("{error:#}"), None),
            }
        }
        resolution
    }

    /// The plan without the nodes that the recipe has for others, none of which reads them.
    fn finish(self) -> Plan {
        let Self { mut plan, wired, .. } = self;
        let has_readers: BTreeSet<usize> = wired.into_iter().flatten().collect();
        let mut needed: BTreeSet<usize> = (0..plan.nodes.len()).filter(|index| !has_readers.contains(index)).collect();
        needed = plan.with_ancestors(&needed);
        let mut new_index = BTreeMap::new();
        for (index, mut node) in std::mem::take(&mut plan.nodes).into_iter().enumerate() {
            if !needed.contains(&index) {
                plan.origins.remove(&node.name);
                plan.left_out.push(node.name);
                continue;
            }
            let producers = node.inputs.iter_mut().flat_map(|input| &mut input.producers);
            producers.for_each(|producer| *producer = new_index[&*producer]);
            new_index.insert(index, plan.nodes.len());
            plan.nodes.push(node);
        }
        plan
    }
}

/// The origin of every value that a resolution changed or made.
fn note_resolved(origins: &mut BTreeMap<String, Origin>, before: &Value, after: &Value) {
    let value_at = |value: &Value, key: &str| {
        key.split('.').try_fold(value, |value, part| value.get(part)).cloned().unwrap_or(Value::Null)
    };
    let old = std::mem::take(origins);
    add_origins(origins, "", after, &|key| match old.get(key) {
        Some(origin) if value_at(before, key) == value_at(after, key) => origin.clone(),
        _ => Origin::Resolved,
    });
}

/// What a job does not use: files of its own crate, and of the crates of the producers whose one artifact it reads (what
/// made the artifact did not use them, so that whoever plays it back does not either).
fn unused_sources(stage: &dyn AnyStage, own: Vec<String>, inputs: &[PlanInput], nodes: &[Node]) -> UnusedSources {
    let mut unused = UnusedSources::new();
    for input in inputs.iter().filter(|input| !input.many) {
        for producer in input.producers.iter().map(|&index| &nodes[index]) {
            let theirs = producer.unused_sources.get(&producer.stage).cloned().unwrap_or_default();
            // Two producers of one stage use what either uses.
            unused
                .entry(producer.stage.clone())
                .and_modify(|both| both.retain(|path| theirs.contains(path)))
                .or_insert(theirs);
        }
    }
    unused.insert(stage.id().into(), own);
    unused
}

/// The producers on one port: of each template wired to it, the nodes that agree on all shared axes.
fn plan_input(
    recipe: &RawRecipe,
    template: &Template,
    port: &Port,
    values: &[(usize, String)],
    made: &[Vec<(usize, Values)>],
) -> PlanInput {
    let agrees = |other: &[(usize, String)]| {
        other.iter().all(|(axis, text)| values.iter().all(|(own, own_text)| own != axis || own_text == text))
    };
    let wires = template.inputs.iter().filter(|wire| wire.port.name == port.name).flat_map(|wire| &wire.from);
    let templates = wires.filter_map(|from| recipe.templates.get_index_of(&from.name));
    let producers = templates.flat_map(|index| &made[index]).filter(|(_, other)| agrees(other)).map(|(node, _)| *node);
    PlanInput {
        port: port.name.into(),
        artifact: (port.artifact.0.into(), port.artifact.1),
        many: port.arity == Arity::Many,
        measurements: port.measurements,
        producers: producers.collect(),
    }
}
