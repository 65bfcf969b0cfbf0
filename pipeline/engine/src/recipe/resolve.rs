//! Resolves a recipe into a plan.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::draft::{Draft, Drafter};
use super::errors::{RecipeErrors, Report};
use super::expand::has_too_many_jobs;
use super::hints::KnownParams;
use super::link::link;
use super::load::Overrides;
use super::places::Place;
use super::tree::Item;
use super::{all, load, raw, wire};
use crate::Registry;
use crate::library::{Library, builtin_name};
use crate::plan::Plan;

/// Reads the recipe at `path` (a file, or `builtin:NAME`), applies `overrides` (e.g. `nodes.train.params.iterations=500`), and
/// resolves it with the stages of `registry`: every job with its full parameters, producers and plan id.
///
/// All errors are reported at once, except that inputs and unused axes are checked only if the recipe has no other errors. Stages may
/// read files below `data_root`, so the available data decides which effects a job simulates. The store decides
/// nothing.
pub fn resolve(path: &Path, overrides: &[String], registry: &Registry, data_root: &Path) -> Result<Plan, RecipeErrors> {
    let overrides = Overrides { set: overrides.to_vec(), ..Overrides::default() };
    resolve_with(path, &overrides, registry, data_root)
}

/// Resolves a recipe with all changes that a command line can make; see [`resolve`].
pub fn resolve_with(
    path: &Path,
    overrides: &Overrides,
    registry: &Registry,
    data_root: &Path,
) -> Result<Plan, RecipeErrors> {
    let mut report = Report::default();
    let library = Library(registry.recipes());
    let Some(mut loaded) = load::load(path, overrides, library, &mut report) else {
        return report.finish(None);
    };
    // Searches are handled by the program, which resolves the recipe once per trial.
    loaded.root.shift_remove("sweep");
    all::expand(&mut loaded, registry, &mut report);
    let known = KnownParams::of(&loaded.root, registry);
    let recipe = raw::read(loaded, &known, &mut report);
    let order = wire::check(&recipe, registry, &mut report);
    if has_too_many_jobs(&recipe, &mut report) {
        return report.finish(None);
    }
    let mut drafter = Drafter { recipe: &recipe, registry, report: &mut report };
    let drafts: Vec<Vec<Draft>> = (0..recipe.templates.len()).map(|template| drafter.drafts(template)).collect();
    // Another error may be the reason, e.g. an `extends` that is not an array.
    if recipe.templates.is_empty() && report.is_empty() {
        let hint = "add [nodes.NAME] with a stage";
        report.add(&Place::default(), "nodes", "the recipe has no nodes", Some(hint.into()));
    }
    // Another error may be the reason, e.g. a misspelt axis in `over`.
    if report.is_empty() {
        wire::refuse_unused_axes(&recipe, &mut report);
    }
    match order {
        Some(order) if report.is_empty() => {
            let name = recipe.name.clone().unwrap_or_else(|| name_of_file(path));
            let plan = link(&recipe, registry, data_root, &order, drafts, name, &mut report);
            report.finish(Some(plan))
        }
        _ => report.finish(None),
    }
}

/// Axis → every value that the recipe at `path`, or one that it extends, gives it: the values that conditions may name, even
/// if an override narrows the axis. Empty if a file cannot be read, which [`resolve`] reports.
pub fn axis_values(path: &Path, registry: &Registry) -> BTreeMap<String, BTreeSet<String>> {
    let mut report = Report::default();
    let loaded = load::load(path, &Overrides::default(), Library(registry.recipes()), &mut report);
    let Some(mut loaded) = loaded else { return BTreeMap::new() };
    all::expand(&mut loaded, registry, &mut report);
    loaded.axis_values
}

/// The name of the recipe at `path` with these changes. None if a file cannot be read, which [`resolve`] reports.
pub fn name(path: &Path, overrides: &Overrides, registry: &Registry) -> Option<String> {
    let loaded = load::load(path, overrides, Library(registry.recipes()), &mut Report::default())?;
    let own = loaded.root.get("name").and_then(Item::as_str).map(str::to_owned);
    Some(own.unwrap_or_else(|| name_of_file(path)))
}

/// The name of a recipe that states none: the file's stem without leading `.` and `-`, which a folder's name must not
/// have.
fn name_of_file(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let stem = builtin_name(path).unwrap_or(&stem);
    let name = stem.trim_start_matches(['.', '-']);
    if name.is_empty() { "recipe".into() } else { name.into() }
}
