//! From a recipe to its plan.

use std::collections::BTreeMap;
use std::path::{Component, Path};

use serde_json::Value;

use super::errors::{RecipeErrors, Report};
use super::expand::{Instance, instances};
use super::raw::{RawRecipe, Template};
use super::tree::{self, Table};
use super::{load, raw, wire};
use crate::fingerprint::{Code, UnusedSources};
use crate::key::plan_id;
use crate::plan::{Node, Origin, Plan, PlanInput, PlanSource};
use crate::registry::AnyStage;
use crate::{Arity, ParamProblem, Port, Registry};

/// Reads the recipe at `path`, lays `overrides` (`nodes.train.params.iterations=500`) over it, and resolves it against
/// the stages of `registry`: every job with its full parameters, producers and plan id. All errors come at once.
pub fn resolve(path: &Path, overrides: &[String], registry: &Registry) -> Result<Plan, RecipeErrors> {
    let mut report = Report::default();
    let Some(loaded) = load::load(path, overrides, &mut report) else {
        return report.finish(None);
    };
    let recipe = raw::read(loaded, &mut report);
    let order = wire::check(&recipe, registry, &mut report);
    let mut resolver = Resolver { recipe: &recipe, registry, report };
    let drafts: Vec<Vec<Draft>> = (0..recipe.templates.len()).map(|template| resolver.drafts(template)).collect();
    if recipe.templates.is_empty() {
        let place = super::places::Place::default();
        resolver.report.add(&place, "nodes", "the recipe has no nodes", Some("add [nodes.NAME] with a stage".into()));
    }
    match order {
        Some(order) if resolver.report.is_empty() => {
            let stem = path.file_stem().map_or("recipe".into(), |stem| stem.to_string_lossy().into_owned());
            let plan = link(&recipe, registry, &order, drafts, recipe.name.clone().unwrap_or(stem));
            resolver.report.finish(Some(plan))
        }
        _ => resolver.report.finish(None),
    }
}

/// A job whose producers are not known yet.
struct Draft {
    instance: Instance,
    params: Value,
    sources: Vec<PlanSource>,
    threads: usize,
    /// Files and folders of the stage's own crate.
    unused_sources: Vec<String>,
    origins: BTreeMap<String, Origin>,
}

struct Resolver<'a> {
    recipe: &'a RawRecipe,
    registry: &'a Registry,
    report: Report,
}

impl Resolver<'_> {
    /// The jobs of a template; those with problems are in the report instead.
    fn drafts(&mut self, template: usize) -> Vec<Draft> {
        let (name, template) = self.recipe.templates.get_index(template).expect("an index of the recipe");
        let instances = instances(self.recipe, name, template, &mut self.report);
        let Some(stage) = self.registry.get(&template.stage.name) else {
            return Vec::new();
        };
        instances.into_iter().filter_map(|instance| self.draft(name, template, stage, instance)).collect()
    }

    fn draft(&mut self, name: &str, template: &Template, stage: &dyn AnyStage, instance: Instance) -> Option<Draft> {
        let params = match stage.canonical_params(&tree::table_to_json(&instance.params)) {
            Ok(params) => params,
            Err(problems) => {
                problems.iter().for_each(|problem| self.add_problem(name, template, &instance.params, problem));
                return None;
            }
        };
        let (sources, threads, unused_sources) = known_of(stage, &params)
            .map_err(|error| self.report.add(&template.at, format!("nodes.{name}"), format!("{error:#}"), None))
            .ok()?;
        for source in &sources {
            let inside = source.path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
            if !inside || source.path.as_os_str().is_empty() {
                let message =
                    format!("source `{}` must lie under the data root: {}", source.name, source.path.display());
                let hint = Some("give a relative path without `..`, and the folder it is in by --data-root".into());
                self.report.add(&template.params_at, format!("nodes.{name}.params"), message, hint);
            }
        }
        let mut origins = BTreeMap::new();
        add_origins(&mut origins, "", &params, &|key| match tree::find(&instance.params, key) {
            Some((item, true)) => self.report.texts.origin(&item.key_at),
            _ => Origin::Default,
        });
        Some(Draft { instance, params, sources, threads, unused_sources, origins })
    }

    /// Reports a problem with a parameter where the recipe sets it, or at the parameters as a whole.
    fn add_problem(&mut self, node: &str, template: &Template, params: &Table, problem: &ParamProblem) {
        let place = match tree::find(params, &problem.key) {
            Some((item, true)) if !problem.message.starts_with("unknown key") => item.at,
            Some((item, _)) => item.key_at,
            None => template.params_at,
        };
        let dot = if problem.key.is_empty() { "" } else { "." };
        let key = format!("nodes.{node}.params{dot}{}", problem.key);
        // One line of the recipe may be wrong for hundreds of jobs, each in its own words.
        if !self.report.has(&place, &key) {
            self.report.add(&place, key, problem.message.clone(), problem.hint.clone());
        }
    }
}

/// What the stage says of a job with these parameters: its sources, its threads and what it does not use.
fn known_of(stage: &dyn AnyStage, params: &Value) -> anyhow::Result<(Vec<PlanSource>, usize, Vec<String>)> {
    let source = |source: crate::Source| PlanSource { name: source.name.into(), path: source.path };
    let sources = stage.sources(params)?.into_iter().map(source).collect();
    Ok((sources, stage.resources(params)?.threads, stage.unused_sources(params)?))
}

/// Notes where each value comes from: tables are entered, everything else has one origin.
fn add_origins(origins: &mut BTreeMap<String, Origin>, key: &str, value: &Value, origin: &impl Fn(&str) -> Origin) {
    match value.as_object() {
        Some(map) if !map.is_empty() => {
            let prefix = if key.is_empty() { String::new() } else { format!("{key}.") };
            map.iter().for_each(|(name, value)| add_origins(origins, &format!("{prefix}{name}"), value, origin));
        }
        _ if key.is_empty() => (),
        _ => {
            origins.insert(key.into(), origin(key));
        }
    }
}

/// Axis index and text of each value of a job.
type Values = Vec<(usize, String)>;

/// Joins the jobs, template by template in the given order, so that producers come first.
fn link(recipe: &RawRecipe, registry: &Registry, order: &[usize], mut drafts: Vec<Vec<Draft>>, name: String) -> Plan {
    let mut plan = Plan { recipe: name, nodes: Vec::new(), origins: BTreeMap::new() };
    // Template → the nodes made of it, each with the axis values that tell it from the others.
    let mut made: Vec<Vec<(usize, Values)>> = (0..drafts.len()).map(|_| Vec::new()).collect();
    // Fingerprints by stage and unused sources: many jobs share one.
    let mut codes: BTreeMap<(&str, UnusedSources), Code> = BTreeMap::new();
    for &index in order {
        let (template_name, template) = recipe.templates.get_index(index).expect("an index of the recipe");
        let stage = registry.get(&template.stage.name).expect("checked before");
        for draft in std::mem::take(&mut drafts[index]) {
            let values: Values =
                draft.instance.values.iter().map(|(axis, value)| (*axis, value.text.clone())).collect();
            let input = |port: &Port| plan_input(recipe, template, port, &values, &made);
            let inputs: Vec<PlanInput> = stage.ports().iter().map(input).collect();
            let unused_sources = unused_sources(stage, draft.unused_sources, &inputs, &plan.nodes);
            let code = codes.entry((stage.id(), unused_sources.clone()));
            let code = code.or_insert_with(|| registry.code(stage.id(), &unused_sources)).clone();
            let mut node = Node {
                name: draft.instance.name,
                template: template_name.clone(),
                stage: stage.id().into(),
                coordinates: draft.instance.coordinates,
                params: draft.params,
                inputs,
                sources: draft.sources,
                threads: draft.threads,
                output: (stage.output().0.into(), stage.output().1),
                unused_sources,
                code,
                plan_id: String::new(),
            };
            node.plan_id = plan_id(&node, &plan.nodes);
            made[index].push((plan.nodes.len(), values));
            plan.origins.insert(node.name.clone(), draft.origins);
            plan.nodes.push(node);
        }
    }
    plan
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
