//! Drafts: the jobs of a recipe with canonical parameters, before they are linked to their producers.

use std::collections::BTreeMap;
use std::path::Component;

use rayon::prelude::*;
use serde_json::Value;

use super::errors::Report;
use super::expand::{Instance, axis_in, instances};
use super::places::{Place, Texts};
use super::raw::{AxisValue, RawRecipe, Template};
use super::tree::{self, Item, Table};
use crate::fingerprint::UnusedSources;
use crate::plan::{Origin, PlanSource};
use crate::registry::AnyStage;
use crate::{ParamProblem, Registry};

/// A job without producers: its parameters, and what its stage derives from them.
pub(super) struct Draft {
    /// The job as the recipe states it.
    pub(super) instance: Instance,
    /// The canonical parameters.
    pub(super) params: Value,
    /// What the stage derives from the parameters.
    pub(super) derived: Derived,
    /// The origin of each parameter.
    pub(super) origins: BTreeMap<String, Origin>,
}

/// What a stage derives from the parameters of a job.
pub(super) struct Derived {
    /// The files and folders that the job reads.
    pub(super) sources: Vec<PlanSource>,
    /// Worker threads; 0 means all.
    pub(super) threads: usize,
    /// Sources that the job does not use.
    pub(super) unused_sources: UnusedSources,
}

/// Turns templates into drafts.
pub(super) struct Drafter<'a> {
    /// The recipe.
    pub(super) recipe: &'a RawRecipe,
    /// The stages.
    pub(super) registry: &'a Registry,
    /// Receives the errors.
    pub(super) report: &'a mut Report,
}

impl Drafter<'_> {
    /// The jobs of the template with this index. Jobs with errors are reported and left out.
    pub(super) fn drafts(&mut self, template: usize) -> Vec<Draft> {
        let (name, template) = self.recipe.templates.get_index(template).expect("an index of the recipe");
        // Without the jobs that it is `like`, a node would have spurious errors at lines of another node.
        if self.report.concerns(&format!("nodes.{name}.like")) {
            return Vec::new();
        }
        let instances = instances(self.recipe, name, template, self.report);
        let Some(stage) = self.registry.get(&template.stage.name) else {
            return Vec::new();
        };
        let (recipe, texts) = (self.recipe, &self.report.texts);
        let completed = |instance| {
            let instance = with_params_of_stage(recipe, texts, stage, instance);
            let params = stage.canonical_params(&tree::table_to_json(&instance.params));
            (instance, params)
        };
        let completed: Vec<_> = instances.into_par_iter().map(completed).collect();
        let draft = |(instance, params)| self.draft((name, template), stage, instance, params);
        completed.into_iter().filter_map(draft).collect()
    }

    fn draft(
        &mut self,
        (name, template): (&str, &Template),
        stage: &dyn AnyStage,
        instance: Instance,
        params: Result<Value, Vec<ParamProblem>>,
    ) -> Option<Draft> {
        let params = match params {
            Ok(params) => params,
            Err(problems) if is_for_others(self.recipe, (name, template), &instance.params, &problems) => return None,
            Err(problems) => {
                let mut add =
                    |problem| add_problem(self.recipe, (name, template), &instance.params, problem, self.report);
                problems.iter().for_each(&mut add);
                return None;
            }
        };
        let derived = derive(stage, &params)
            .map_err(|error| self.report.add(&template.at, format!("nodes.{name}"), format!("{error:#}"), None))
            .ok()?;
        for source in &derived.sources {
            let inside = source.path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
            if !inside || source.path.as_os_str().is_empty() {
                let message =
                    format!("source `{}` must lie under the data root: {}", source.name, source.path.display());
                let hint = Some(
                    "write a relative path without `..`; --data-root sets the folder that it is relative to".into(),
                );
                self.report.add(&template.params_at, format!("nodes.{name}.params"), message, hint);
            }
        }
        let mut origins = BTreeMap::new();
        add_origins(&mut origins, "", &params, &|key| match tree::find(&instance.params, key) {
            Some((item, true)) => self.report.texts.origin(&item.key_at),
            _ => Origin::Default,
        });
        Some(Draft { instance, params, derived, origins })
    }
}

/// The job with the parameters that the recipe gives to all jobs of its stage.
fn with_params_of_stage(recipe: &RawRecipe, texts: &Texts, stage: &dyn AnyStage, mut instance: Instance) -> Instance {
    for given in recipe.of_stages.iter().filter(|given| given.stage == stage.id()) {
        let is_own = |key: &String| instance.params.get(key).is_some_and(|item| !texts.is_in_base(&item.key_at));
        let mut params = given.params.clone();
        params.retain(|key, _| !(given.yields && is_own(key)));
        tree::merge(&mut instance.params, params);
    }
    instance
}

/// Whether the job is left out without an error: the template inherits all parameters with problems by `like` from a
/// job that does not exist, because its axis lacks the value. They are meant for the existing values, e.g. an effect of
/// another method.
fn is_for_others(
    recipe: &RawRecipe,
    (name, template): (&str, &Template),
    params: &Table,
    problems: &[ParamProblem],
) -> bool {
    let Some(like) = &template.like else { return false };
    let is_inherited = |problem: &ParamProblem| {
        let item = tree::find(params, &problem.key).map(|(item, _)| item);
        item.is_some_and(|item| inherited_from(recipe, (name, template), &problem.key, item).is_some())
    };
    let is_absent =
        |(axis, fixed): &(usize, AxisValue)| recipe.axes[*axis].values.iter().all(|value| value.text != fixed.text);
    like.values.iter().any(is_absent) && problems.iter().all(is_inherited)
}

/// Reports a problem with a parameter at the key that sets it, or at `params` if no key does. A key that the node
/// inherits is named as the user typed it, i.e. below the node that it is `like`.
pub(super) fn add_problem(
    recipe: &RawRecipe,
    (name, template): (&str, &Template),
    params: &Table,
    problem: &ParamProblem,
    report: &mut Report,
) {
    let found = tree::find(params, &problem.key);
    let place = match found {
        Some((item, true)) if !problem.message.starts_with("unknown key") => item.at,
        Some((item, _)) => item.key_at,
        None => template.params_at,
    };
    let typed_in = found.and_then(|(item, _)| inherited_from(recipe, (name, template), &problem.key, item));
    let dot = if problem.key.is_empty() { "" } else { "." };
    let key = format!("nodes.{}.params{dot}{}", typed_in.unwrap_or(name), problem.key);
    // One line of the recipe may be wrong for hundreds of jobs, with a different message for each.
    if !report.has(&place, &key) {
        let hints: Vec<String> = problem.hint.iter().cloned().chain(axis_hint(recipe, &place, report)).collect();
        report.add(&place, key, problem.message.clone(), (!hints.is_empty()).then(|| hints.join("; ")));
    }
}

/// The line of the axis that gives the value at `place`, if the value is a placeholder.
fn axis_hint(recipe: &RawRecipe, place: &Place, report: &Report) -> Option<String> {
    let text = report.texts.get(place.text).text.get(place.start..place.end)?;
    let (name, axis) = recipe.axes.get_key_value(axis_in(text).filter(|_| text.starts_with(['"', '\'']))?)?;
    Some(format!("the value comes from axis `{name}` at {}", report.texts.line_name(&axis.at, place)))
}

/// The node that the template is `like`, if that node's parameters or rules have the item and its own do not.
fn inherited_from<'a>(
    recipe: &'a RawRecipe,
    (name, template): (&str, &Template),
    key: &str,
    item: &Item,
) -> Option<&'a str> {
    let (model, model_template) = recipe.templates.get_key_value(&template.like.as_ref()?.node.name)?;
    let has = |table: &Table| tree::find(table, key).is_some_and(|(own, _)| own.key_at.is_same_text(&item.key_at));
    let rules_of = |node: &str| {
        let of_node = recipe.rules.iter().flat_map(|rule| &rule.params).filter(|(other, _)| other == node);
        of_node.map(|(_, params)| params).any(has)
    };
    let is_own = has(&template.params) || rules_of(name);
    (!is_own && (has(&model_template.params) || rules_of(model))).then_some(model)
}

/// What the stage derives from canonical parameters.
pub(super) fn derive(stage: &dyn AnyStage, params: &Value) -> anyhow::Result<Derived> {
    let source =
        |crate::Source { name, path, optional }: crate::Source| PlanSource { name: name.into(), path, optional };
    Ok(Derived {
        sources: stage.sources(params)?.into_iter().map(source).collect(),
        threads: stage.resources(params)?.threads,
        unused_sources: stage.unused_sources(params)?,
    })
}

/// Records the origin of each value. Tables are entered; any other value has one origin.
pub(super) fn add_origins(
    origins: &mut BTreeMap<String, Origin>,
    key: &str,
    value: &Value,
    origin: &impl Fn(&str) -> Origin,
) {
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
