//! Links jobs to their producers, resolves their parameters from the producers' facts, and prunes jobs that nothing
//! reads.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::Value;

use super::draft::{Draft, add_origins, add_problem, derive};
use super::errors::Report;
use super::raw::{RawRecipe, Template};
use crate::fingerprint::{Code, UnusedSources};
use crate::key::plan_id;
use crate::plan::{Node, Origin, Plan, PlanInput};
use crate::registry::AnyStage;
use crate::{Arity, Facts, PlanContext, Port, Registry, Resolution};

/// Axis index and text of each value of a job.
type Values = Vec<(usize, String)>;

/// Links the jobs, template by template in the given order, which has producers first.
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
            changes: Vec::new(),
        },
        linked: vec![Vec::new(); drafts.len()],
        left_out: vec![Vec::new(); drafts.len()],
        facts: Vec::new(),
        wired: Vec::new(),
        unused: Vec::new(),
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
    /// Template → its nodes, each with its axis values.
    linked: Vec<Vec<(usize, Values)>>,
    /// Template → the axis values of its jobs that are left out, e.g. because they would repeat others.
    left_out: Vec<Vec<Values>>,
    /// The facts of each node's artifact.
    facts: Vec<Facts>,
    /// The producers that the recipe wires to each job, including jobs that are left out and producers that the job
    /// does not read.
    wired: Vec<BTreeSet<usize>>,
    /// The sources that each node's stage declares as unused by the node and its readers.
    unused: Vec<UnusedSources>,
    /// Fingerprints by stage and unused sources, because many jobs share one.
    codes: BTreeMap<(&'a str, UnusedSources), Code>,
    report: &'a mut Report,
}

impl<'a> Linker<'a> {
    /// Adds the node of a job whose producers already have nodes.
    fn add(&mut self, index: usize, mut draft: Draft) {
        let recipe = self.recipe;
        let (template_name, template) = recipe.templates.get_index(index).expect("an index of the recipe");
        let stage = self.registry.get(&template.stage.name).expect("checked before");
        let values: Values = draft.instance.values.iter().map(|(axis, value)| (*axis, value.text.clone())).collect();
        let ports = stage.ports();
        let mut inputs: Vec<PlanInput> =
            ports.iter().map(|port| plan_input(recipe, template, port, &values, &self.linked)).collect();
        self.wired.push(inputs.iter().flat_map(|input| input.producers.iter().copied()).collect());
        let is_wanted = recipe.has_values(&template.only_with);
        if !is_wanted || self.reads_left_out(template, &ports, &inputs, &values) {
            return self.leave_out(index, draft.instance.name, values);
        }
        self.refuse_gaps(template_name, template, &ports, &inputs);

        // The facts of the producers decide which of them the stage reads.
        let context = self.context(&inputs);
        let resolution = self.resolve(stage, template_name, template, &mut draft, &context);
        if resolution.repeats.is_some() {
            return self.leave_out(index, draft.instance.name, values);
        }
        for (input, port) in inputs.iter_mut().zip(&ports) {
            let chosen = resolution.chosen.get(port.name).and_then(|&chosen| input.producers.get(chosen)).copied();
            match port.arity {
                Arity::Optional if resolution.unread.contains(port.name) => input.producers.clear(),
                Arity::Choice => input.producers = chosen.into_iter().collect(),
                Arity::One | Arity::Optional | Arity::Many => (),
            }
        }
        let work = stage.work(&resolution.params, &self.context(&inputs));
        let facts = stage.facts(&resolution.params, &context);
        self.facts.push(facts.expect("the stage wrote these parameters itself"));

        let unused_sources = unused_sources(&draft.derived.unused_sources, &inputs, &self.plan.nodes, &self.unused);
        self.unused.push(draft.derived.unused_sources);
        let code = self.codes.entry((stage.id(), unused_sources.clone()));
        let code = code.or_insert_with(|| self.registry.code(stage.id(), &unused_sources)).clone();
        let mut node = Node {
            name: draft.instance.name,
            template: template_name.clone(),
            stage: stage.id().into(),
            coordinates: draft.instance.coordinates,
            params: resolution.params,
            inputs,
            sources: draft.derived.sources,
            threads: draft.derived.threads,
            work: work.expect("the stage wrote these parameters itself"),
            on_device: stage.on_device(),
            output: (stage.output().0.into(), stage.output().1),
            unused_sources,
            code,
            decisions: resolution.decisions,
            plan_id: String::new(),
        };
        node.plan_id = plan_id(&node, &self.plan.nodes);
        self.linked[index].push((self.plan.nodes.len(), values));
        self.plan.origins.insert(node.name.clone(), draft.origins);
        self.plan.nodes.push(node);
    }

    /// Leaves a job out of the plan.
    fn leave_out(&mut self, index: usize, name: String, values: Values) {
        self.left_out[index].push(values);
        self.plan.left_out.push(name);
    }

    /// Whether the job's producer on a port for one is left out.
    fn reads_left_out(&self, template: &Template, ports: &[Port], inputs: &[PlanInput], values: &Values) -> bool {
        let lacks_one = |(port, input): &(&Port, &PlanInput)| port.arity == Arity::One && input.producers.is_empty();
        let is_left_out = |port: &Port| {
            let wires = template.inputs.iter().filter(|wire| wire.port.name == port.name).flat_map(|wire| &wire.from);
            let from = wires.filter_map(|from| self.recipe.templates.get_index_of(&from.name));
            from.flat_map(|index| &self.left_out[index]).any(|other| agree(values, other))
        };
        ports.iter().zip(inputs).filter(lacks_one).any(|(port, _)| is_left_out(port))
    }

    /// Refuses nodes without a producer on a port for one: `only` may give the producer fewer axis values than the
    /// node.
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

    /// The facts of the producers on each port.
    fn context(&self, inputs: &[PlanInput]) -> PlanContext<'a> {
        let facts = |input: &PlanInput| input.producers.iter().map(|&index| self.facts[index].clone()).collect();
        let inputs = inputs.iter().map(|input| (input.port.clone(), facts(input))).collect();
        PlanContext { data_root: self.data_root, inputs }
    }

    /// Resolves the job's parameters and updates the draft's derived values. Problems go to the report.
    fn resolve(
        &mut self,
        stage: &dyn AnyStage,
        name: &str,
        template: &Template,
        draft: &mut Draft,
        context: &PlanContext<'_>,
    ) -> Resolution<Value> {
        let resolution = stage.resolve(&draft.params, context).unwrap_or_else(|problems| {
            let mut add =
                |problem| add_problem(self.recipe, (name, template), &draft.instance.params, problem, self.report);
            problems.iter().for_each(&mut add);
            Resolution::unchanged(draft.params.clone())
        });
        if resolution.params != draft.params {
            note_resolved(&mut draft.origins, &draft.params, &resolution.params);
            match derive(stage, &resolution.params) {
                Ok(derived) => draft.derived = derived,
                Err(error) => self.report.add(&template.at, format!("nodes.{name}"), format!("{error:#}"), None),
            }
        }
        resolution
    }

    /// The plan without the nodes that the recipe wires to jobs but that no remaining job reads.
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

/// Updates the origins of values that a resolution changed or added.
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

/// The sources that a job does not use: those that its own stage declares (`own`) and, for crates that `own` does not
/// name, those that the producers on ports for one artifact declare. The readers of an artifact may run the code that
/// made it, and so use at most the sources that its producer uses.
fn unused_sources(
    own: &UnusedSources,
    inputs: &[PlanInput],
    nodes: &[Node],
    declared: &[UnusedSources],
) -> UnusedSources {
    let read = inputs.iter().filter(|input| !input.many).flat_map(|input| input.producers.iter().copied());
    let read: BTreeSet<usize> = read.collect();
    let mut unused = own.clone();
    let crates: BTreeSet<&String> = read.iter().flat_map(|&producer| declared[producer].keys()).collect();
    for name in crates.into_iter().filter(|name| !own.contains_key(*name)) {
        // Every producer that runs code of the crate must leave a path unused.
        let users = read.iter().filter(|&&producer| nodes[producer].code.contains_key(name));
        let mut paths = users.map(|&producer| declared[producer].get(name).cloned().unwrap_or_default());
        let first = paths.next().unwrap_or_default();
        let common =
            paths.fold(first, |common, other| common.into_iter().filter(|path| other.contains(path)).collect());
        unused.insert(name.clone(), common);
    }
    unused
}

/// Whether two jobs have equal values on all axes that both have.
fn agree(values: &[(usize, String)], others: &[(usize, String)]) -> bool {
    others.iter().all(|(axis, text)| values.iter().all(|(own, own_text)| own != axis || own_text == text))
}

/// The producers on one port: of each template wired to it, the nodes that agree on all shared axes.
fn plan_input(
    recipe: &RawRecipe,
    template: &Template,
    port: &Port,
    values: &[(usize, String)],
    linked: &[Vec<(usize, Values)>],
) -> PlanInput {
    let wires = template.inputs.iter().filter(|wire| wire.port.name == port.name).flat_map(|wire| &wire.from);
    let templates = wires.filter_map(|from| recipe.templates.get_index_of(&from.name));
    let producers =
        templates.flat_map(|index| &linked[index]).filter(|(_, other)| agree(values, other)).map(|(node, _)| *node);
    PlanInput {
        port: port.name.into(),
        artifact: (port.artifact.0.into(), port.artifact.1),
        many: port.arity == Arity::Many,
        measurements: port.measurements,
        producers: producers.collect(),
    }
}
