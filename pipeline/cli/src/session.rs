//! A resolved recipe with its store: the starting point of most verbs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use cluster::RunFile;
use engine::explain::{Change, Component};
use engine::history::History;
use engine::recipe::{Overrides, RecipeErrors, StageOverride};
use engine::scheduler::Sources;
use engine::status::{Prediction, State, predict};
use engine::store::{ActionRecord, Provenance};
use engine::{DeviceClass, Digest, Failure, FailureKind, Node, Plan, Store, builtin_name};

use crate::args::{RecipeArgs, SelectionArgs};
use crate::device::ChosenDevice;
use crate::error::CliError;
use crate::named_methods;
use crate::output::{note, quoted};
use crate::stages::stages;

/// The stage that `--replicates`, `--budget` and `--profile` apply to.
pub(crate) const TRAINING: &str = "training";
/// The stage that renders views.
const RENDERING: &str = "rendering";
/// The stage that makes reports.
pub(crate) const REPORT: &str = "table-generation";
/// The axis that `--replicates` sets.
pub(crate) const SEED: &str = "seed";
/// The advice for a job without a result.
const RUN_FIRST: &str = "run the recipe first, or name the store of its runs with --store";
/// The beginning of the change that distinguishes the trials of a search from runs with the same options.
const OF_TRIAL: &str = "renders of";

/// A resolved recipe, its store, and the selected jobs.
pub(crate) struct Session {
    pub(crate) plan: Plan,
    pub(crate) store: Store,
    pub(crate) data_root: PathBuf,
    pub(crate) device: ChosenDevice,
    /// Indices of the selected jobs.
    pub(crate) targets: BTreeSet<usize>,
    /// Indices of jobs to run even if their results exist.
    pub(crate) force: BTreeSet<usize>,
    /// Whether all source files are hashed again.
    pub(crate) rehash: bool,
}

impl Session {
    /// Resolves the recipe and opens the store, creating it if needed. All jobs are selected.
    pub(crate) fn open(store: &Path, recipe: &RecipeArgs) -> Result<Self, CliError> {
        Self::with(|| Store::open(store), recipe)
    }

    /// Resolves the recipe for verbs that only read. A missing store is not created and reads as empty.
    pub(crate) fn read_only(store: &Path, recipe: &RecipeArgs) -> Result<Self, CliError> {
        Self::with(|| Store::open_read_only(store), recipe)
    }

    fn with(store: impl FnOnce() -> anyhow::Result<Store>, recipe: &RecipeArgs) -> Result<Self, CliError> {
        let device = ChosenDevice::choose(&recipe.with.device)?;
        let plan = resolve(recipe, device.class())?;
        for idle in plan.idle_axes() {
            note(&format!("warning: {idle}; use it in a parameter (\"{{{}}}\") or remove it", idle.axis));
        }
        let targets = (0..plan.nodes.len()).collect();
        let data_root = recipe.with.data.root.clone();
        Ok(Self { plan, store: store()?, data_root, device, targets, force: BTreeSet::new(), rehash: false })
    }

    /// The session of a shared run, on this device.
    pub(crate) fn of_run(store: Store, file: &RunFile, plan: Plan, device: ChosenDevice) -> Self {
        Self {
            plan,
            store,
            data_root: file.data_root.clone(),
            device,
            targets: file.targets.clone(),
            force: file.force.clone(),
            rehash: false,
        }
    }

    /// Replaces the selection.
    pub(crate) fn select(mut self, selection: &SelectionArgs) -> Result<Self, CliError> {
        self.targets = self.plan.select(&selection.only)?;
        if !selection.force.is_empty() {
            self.force = self.plan.select(&selection.force)?;
        }
        self.rehash = selection.rehash;
        Ok(self)
    }

    /// Predicts a run of the selected jobs, by node index.
    pub(crate) fn predict(&self) -> Result<BTreeMap<usize, Prediction>, CliError> {
        self.predict_for(&self.targets)
    }

    /// Predicts a run of `targets`, by node index.
    pub(crate) fn predict_for(&self, targets: &BTreeSet<usize>) -> Result<BTreeMap<usize, Prediction>, CliError> {
        let nodes = self.plan.with_ancestors(targets);
        let sources = Sources::digest(&self.plan, &nodes, &self.data_root, &self.store, self.rehash)?;
        Ok(predict(&self.plan, &self.store, &nodes, &self.force, &sources)?)
    }

    /// Checks the device if one of the predicted jobs may compute on it.
    pub(crate) fn check_device(&self, predictions: &BTreeMap<usize, Prediction>) -> Result<(), CliError> {
        let may_compute =
            |(&index, prediction): (&usize, &Prediction)| self.plan.nodes[index].on_device && prediction.may_run();
        if predictions.iter().any(may_compute) { self.device.check() } else { Ok(()) }
    }

    /// The index of the job with this name, or of the only job that `name` matches as a pattern.
    pub(crate) fn node(&self, name: &str) -> Result<usize, CliError> {
        if let Some(index) = self.plan.index_of(name) {
            return Ok(index);
        }
        let found = self.plan.select(&[name.to_owned()])?;
        match found.iter().collect::<Vec<_>>()[..] {
            [&only] => Ok(only),
            _ => {
                let names: Vec<&str> = found.iter().map(|&index| self.plan.nodes[index].name.as_str()).collect();
                Err(CliError::nothing(
                    format!("{} jobs match `{name}`", found.len()),
                    format!("choose one: {}", names.join(", ")),
                ))
            }
        }
    }

    /// The indices of the jobs that make reports.
    pub(crate) fn reports(&self) -> Vec<usize> {
        let nodes = self.plan.nodes.iter().enumerate();
        nodes.filter(|(_, node)| node.stage == REPORT).map(|(index, _)| index).collect()
    }

    /// The indices of the jobs that make reports; a recipe without reports is an error.
    pub(crate) fn required_reports(&self) -> Result<Vec<usize>, CliError> {
        let reports = self.reports();
        if reports.is_empty() {
            return Err(CliError::nothing("the recipe has no table", "add a node with stage = \"table-generation\""));
        }
        Ok(reports)
    }

    /// The record of one job's current result. If there is none, falls back to the job's last result, with a warning.
    /// Damaged results and those of other recipes, of other options and of other devices are never used.
    pub(crate) fn record(&self, index: usize) -> Result<ActionRecord, CliError> {
        let prediction = match self.predict_for(&BTreeSet::from([index]))?.remove(&index) {
            Some(Prediction { state: State::Cached { record }, .. }) => return Ok(*record),
            prediction => prediction,
        };
        let reason = prediction.as_ref().map(|prediction| describe(prediction).1).unwrap_or_default();
        let node = &self.plan.nodes[index];
        let history = History::read(&self.store, &self.plan)?;
        let Some(last) = history.last(node) else {
            let changes = prediction.as_ref().map_or(&[][..], Prediction::changes);
            return Err(self.without_result(node, &history, &reason, changes));
        };
        refuse_other_recipe(node, last)?;
        self.require_intact(&format!("the result of {}", node.name), &last.content)?;
        let Provenance { run, .. } = &last.provenance;
        note(&format!(
            "warning: {} is out of date ({reason}); `pipeline explain` shows the causes; using its last result, made by \
             run {run}",
            node.name
        ));
        Ok(last.clone())
    }

    /// The error for a job without a result: its runs may have other options, another device or another store.
    fn without_result(&self, node: &Node, history: &History, reason: &str, changes: &[Change]) -> CliError {
        let (plan, root) = (&self.plan, self.store.root().display());
        let job = format!("{} of recipe {}", node.name, plan.recipe);
        if !self.store.exists() {
            return CliError::nothing(format!("{job} has no result: there is no store at {root}"), RUN_FIRST);
        }
        let is_trial = |changes: &[String]| changes.iter().any(|change| change.starts_with(OF_TRIAL));
        let other = history.other_runs(node).find(|(changes, _)| !is_trial(changes));
        let Some((options, device)) = other else {
            return CliError::nothing(format!("{job} has no result in {root} ({reason})"), RUN_FIRST);
        };
        let on = if device == plan.device { Vec::new() } else { vec!["--device", device.as_str()] };
        let lacking = if options == plan.changes { "on this device" } else { "with these options" };
        let options: Vec<String> = options.iter().map(String::as_str).chain(on).map(quoted).collect();
        let options = if options.is_empty() { "no options".into() } else { options.join(" ") };
        // E.g. a damaged file of the result with these options.
        let lost: String = changes
            .iter()
            .filter(|change| change.component == Component::Record)
            .map(|change| format!(" ({})", change.sentence))
            .collect();
        let hint =
            format!("the last run with a result had {options}: pass the same options, or run the recipe with yours");
        CliError::nothing(format!("{job} has no result {lacking}{lost}"), hint)
    }

    /// Fails if a file of an artifact in the store is missing or corrupt. `what` names the artifact in the error.
    pub(crate) fn require_intact(&self, what: &str, content: &Digest) -> Result<(), CliError> {
        match self.store.fault(content) {
            Some(fault) => Err(CliError::Damaged(format!("{what} is damaged: {fault}"))),
            None => Ok(()),
        }
    }
}

/// Refuses a report that another recipe file with the same name made.
fn refuse_other_recipe(node: &Node, last: &ActionRecord) -> Result<(), CliError> {
    if node.stage != REPORT {
        return Ok(());
    }
    let files = [&node.params, &last.components.params].map(|params| params["recipe"].as_str());
    let [Some(own), Some(other)] = files else { return Ok(()) };
    // A file that was moved or removed since is not known to be another one.
    let [Ok(own), Ok(found)] = [own, other].map(std::fs::canonicalize) else { return Ok(()) };
    if own == found {
        return Ok(());
    }
    let message = format!("{} has no result: the last recipe of this name was {other}", node.name);
    Err(CliError::nothing(message, "run this recipe, and give it a `name` of its own"))
}

/// A job's state in one or two words, and the reason for it.
pub(crate) fn describe(prediction: &Prediction) -> (&'static str, String) {
    let sentences: Vec<&str> = prediction.changes().iter().map(|change| change.sentence.as_str()).collect();
    let sentences = sentences.join("; ");
    match &prediction.state {
        State::Cached { .. } => ("cached", String::new()),
        State::WillRun { running: true, .. } => ("running", sentences),
        State::WillRun { last_failure: Some(record), .. } => {
            ("will rerun", format!("failed before ({})", record.failure.message))
        }
        State::WillRun { .. } => ("will run", sentences),
        State::Pending { may_be_cut_off: true, .. } => ("may run", sentences),
        State::Pending { .. } => ("will run", sentences),
        State::MissingData { failure } => ("missing data", failure.to_string()),
        State::Blocked { because_of, failure } => ("blocked", format!("needs {because_of} ({})", failure.message)),
    }
}

/// The jobs of a recipe, on the device that its conditions name.
pub(crate) fn planned(recipe: &RecipeArgs) -> Result<Plan, CliError> {
    resolve(recipe, ChosenDevice::choose(&recipe.with.device)?.class())
}

/// Resolves the recipe with all changes that the command line makes to it.
fn resolve(recipe: &RecipeArgs, device: DeviceClass) -> Result<Plan, CliError> {
    let (with, stages) = (&recipe.with, stages());
    for (what, path) in [("recipe", &recipe.recipe), ("data", &with.data.root)] {
        if path.to_str().is_none() {
            let failure = Failure::new(FailureKind::BadInput, format!("the path of the {what} is not UTF-8"));
            return Err(CliError::Input(failure.at(path).into()));
        }
    }
    let mut overrides = Overrides { set: with.set.clone(), of_stages: Vec::new() };
    if let Some(count) = with.replicates {
        let axis = format!("axes.{SEED}");
        if with.set.iter().any(|set| set.split_once('=').is_some_and(|(key, _)| key.trim() == axis)) {
            return Err(CliError::Usage(format!("--replicates and -s both set {axis}: omit one of them")));
        }
        let seeds: Vec<usize> = (0..count).collect();
        overrides.set.push(format!("{axis} = {seeds:?}"));
    }
    overrides.of_stages.extend(with.budget.map(|budget| StageOverride {
        stage: TRAINING.into(),
        option: "--budget",
        params: format!("budget_secs = {:?}", budget.as_secs_f64()),
        yields: false,
    }));
    overrides.of_stages.extend(with.render_split.map(|split| StageOverride {
        stage: RENDERING.into(),
        option: "search",
        params: format!("split = {split:?}"),
        yields: false,
    }));
    let of_report = report_params(recipe, device, engine::recipe::name(&recipe.recipe, &overrides, &stages));
    overrides.of_stages.extend(of_report);
    let seedless = || {
        let hint = format!("add an axis `{SEED}`, train over it, and set params.seed = \"{{{SEED}}}\"");
        let failure =
            Failure::new(FailureKind::BadInput, "the recipe trains without a seed axis: nothing to replicate");
        CliError::Input(failure.hint(hint).at(&recipe.recipe).into())
    };
    let resolved = engine::recipe::resolve_with(&recipe.recipe, &overrides, &stages, &with.data.root);
    // `--replicates` sets an axis that no node runs over.
    let is_about_seeds = |errors: &RecipeErrors| matches!(&errors.0[..], [only] if only.key == format!("axes.{SEED}"));
    let mut plan = resolved.map_err(|errors| match with.replicates {
        Some(_) if is_about_seeds(&errors) => seedless(),
        _ => errors.into(),
    })?;
    let is_seedless = |node: &Node| node.stage == TRAINING && !node.coordinates.contains_key(SEED);
    if with.replicates.is_some() && plan.nodes.iter().any(is_seedless) {
        return Err(seedless());
    }
    named_methods::check(&plan)?;
    plan.device = device;
    plan.changes = with.changes();
    // The trials of a search are not runs with the same options: their renders show another split.
    plan.changes.extend(with.render_split.map(|split| format!("{OF_TRIAL} {split}")));
    Ok(plan)
}

/// The parameters of reports that depend on the command line. A recipe inherits neither the title of its base nor the
/// base's path in commands.
fn report_params(recipe: &RecipeArgs, device: DeviceClass, name: Option<String>) -> Vec<StageOverride> {
    let of_report = |key: &str, value: toml::Value, yields: bool| StageOverride {
        stage: REPORT.into(),
        option: "command line",
        params: format!("{key} = {value}"),
        yields,
    };
    let path = plain_path(&recipe.recipe).display().to_string();
    // A built-in recipe states the path of its file, which exists only in the sources.
    let is_file = builtin_name(&recipe.recipe).is_none();
    let mut params = vec![
        of_report("arguments", recipe.with.arguments(device).into(), false),
        of_report("recipe", path.into(), is_file),
    ];
    params.extend(name.map(|name| of_report("title", name.into(), true)));
    params
}

/// The plain spelling of a file's path: without links, `.` and `..`, and relative only if it was typed so and the file is below
/// the working directory. Otherwise, a report would be rebuilt for another spelling.
fn plain_path(path: &Path) -> PathBuf {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { return path.to_owned() };
    // The name stays, even if it is that of a link, because the recipe may be named after its file.
    let Ok(folder) = Path::new(".").join(folder).canonicalize() else { return path.to_owned() };
    let here = std::env::current_dir().and_then(std::fs::canonicalize).unwrap_or_default();
    let below = folder.strip_prefix(here).ok().filter(|_| path.is_relative());
    below.unwrap_or(&folder).join(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spellings_of_a_path_become_one() {
        // Tests run in the folder of their crate.
        let here = std::env::current_dir().and_then(std::fs::canonicalize).expect("a working directory");
        for spelling in ["src/session.rs", "./src/session.rs", "src/../src/session.rs"] {
            assert_eq!(plain_path(Path::new(spelling)), Path::new("src/session.rs"), "{spelling}");
            assert_eq!(plain_path(&here.join(spelling)), here.join("src/session.rs"), "{spelling}");
        }
        let above = here.parent().and_then(Path::parent).expect("the root of the workspace").join("Cargo.toml");
        assert_eq!(
            [plain_path(Path::new("../../Cargo.toml")), plain_path(&here.join("../../Cargo.toml"))],
            [above.clone(), above]
        );
        assert_eq!(plain_path(Path::new("builtin:quickstart")), Path::new("builtin:quickstart"));
    }
}
