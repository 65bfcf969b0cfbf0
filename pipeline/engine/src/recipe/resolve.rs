//! From a recipe to its plan.

use std::collections::BTreeMap;
use std::path::{Component, Path};

use serde_json::Value;

use super::errors::{RecipeErrors, Report};
use super::expand::{Instance, has_too_many_jobs, instances};
use super::link::link;
use super::load::Overrides;
use super::raw::{RawRecipe, Template};
use super::tree::{self, Table};
use super::{load, raw, wire};
use crate::plan::{Origin, Plan, PlanSource};
use crate::registry::AnyStage;
use crate::{ParamProblem, Registry};

/// Reads the recipe at `path`, lays `overrides` (`nodes.train.params.iterations=500`) over it, and resolves it against
/// the stages of `registry`: every job with its full parameters, producers and plan id. All errors come at once, except
/// that nothing is decided about inputs while the recipe has other errors. Stages may look below `data_root`, so that
/// the data that is there decides what is simulated; the store decides nothing.
pub fn resolve(path: &Path, overrides: &[String], registry: &Registry, data_root: &Path) -> Result<Plan, RecipeErrors> {
    let overrides = Overrides { set: overrides.to_vec(), ..Overrides::default() };
    resolve_with(path, &overrides, registry, data_root)
}

/// The same with everything that a command line can change.
pub fn resolve_with(
    path: &Path,
    overrides: &Overrides,
    registry: &Registry,
    data_root: &Path,
) -> Result<Plan, RecipeErrors> {
    let mut report = Report::default();
    let Some(loaded) = load::load(path, overrides, &mut report) else {
        return report.finish(None);
    };
    let recipe = raw::read(loaded, &mut report);
    let order = wire::check(&recipe, registry, &mut report);
    if has_too_many_jobs(&recipe, &mut report) {
        return report.finish(None);
    }
    let mut resolver = Resolver { recipe: &recipe, registry, report };
    let drafts: Vec<Vec<Draft>> = (0..recipe.templates.len()).map(|template| resolver.drafts(template)).collect();
    if recipe.templates.is_empty() {
        let place = super::places::Place::default();
        resolver.report.add(&place, "nodes", "the recipe has no nodes", Some("add [nodes.NAME] with a stage".into()));
    }
    match order {
        Some(order) if resolver.report.is_empty() => {
            let name = recipe.name.clone().unwrap_or_else(|| name_of_file(path));
            let plan = link(&recipe, registry, data_root, &order, drafts, name, &mut resolver.report);
            resolver.report.finish(Some(plan))
        }
        _ => resolver.report.finish(None),
    }
}

/// The name of a recipe that states none: the file's stem, which is the name of a folder but for `..` in front.
fn name_of_file(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let name = stem.trim_start_matches(['.', '-']);
    if name.is_empty() { "recipe".into() } else { name.into() }
}

/// A job whose producers are not known yet.
pub(super) struct Draft {
    pub instance: Instance,
    pub params: Value,
    pub known: Known,
    pub origins: BTreeMap<String, Origin>,
}

/// What a stage says of a job with certain parameters.
pub(super) struct Known {
    pub sources: Vec<PlanSource>,
    pub threads: usize,
    /// Files and folders of the stage's own crate.
    pub unused_sources: Vec<String>,
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

    fn draft(
        &mut self,
        name: &str,
        template: &Template,
        stage: &dyn AnyStage,
        mut instance: Instance,
    ) -> Option<Draft> {
        let of_stage = self.recipe.of_stages.iter().filter(|(id, _)| id == stage.id());
        of_stage.for_each(|(_, params)| tree::merge(&mut instance.params, params.clone()));
        let params = match stage.canonical_params(&tree::table_to_json(&instance.params)) {
            Ok(params) => params,
            Err(problems) => {
                let mut add = |problem| add_problem(name, template, &instance.params, problem, &mut self.report);
                problems.iter().for_each(&mut add);
                return None;
            }
        };
        let known = known_of(stage, &params)
            .map_err(|error| self.report.add(&template.at, format!("nodes.{name}"), format!("{error:#}"), None))
            .ok()?;
        for source in &known.sources {
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
        Some(Draft { instance, params, known, origins })
    }
}

/// Reports a problem with a parameter where the recipe sets it, or at the parameters as a whole.
pub(super) fn add_problem(
    node: &str,
    template: &Template,
    params: &Table,
    problem: &ParamProblem,
    report: &mut Report,
) {
    let place = match tree::find(params, &problem.key) {
        Some((item, true)) if !problem.message.starts_with("unknown key") => item.at,
        Some((item, _)) => item.key_at,
        None => template.params_at,
    };
    let dot = if problem.key.is_empty() { "" } else { "." };
    let key = format!("nodes.{node}.params{dot}{}", problem.key);
    // One line of the recipe may be wrong for hundreds of jobs, each in its own words.
    if !report.has(&place, &key) {
        report.add(&place, key, problem.message.clone(), problem.hint.clone());
    }
}

/// What the stage says of a job with these parameters: its sources, its threads and what it does not use.
pub(super) fn known_of(stage: &dyn AnyStage, params: &Value) -> anyhow::Result<Known> {
    let source = |source: crate::Source| PlanSource { name: source.name.into(), path: source.path };
    Ok(Known {
        sources: stage.sources(params)?.into_iter().map(source).collect(),
        threads: stage.resources(params)?.threads,
        unused_sources: stage.unused_sources(params)?,
    })
}

/// Notes where each value comes from: tables are entered, everything else has one origin.
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
