//! A recipe with its store: what most verbs start from.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use engine::recipe::{Overrides, StageOverride};
use engine::scheduler::Sources;
use engine::status::{History, Prediction, State, predict};
use engine::store::{ActionRecord, Provenance};
use engine::{DeviceClass, Failure, FailureKind, Plan, Store};

use crate::args::{RecipeArgs, SelectionArgs};
use crate::device::ChosenDevice;
use crate::error::CliError;
use crate::output::tell;
use crate::stages::stages;

/// The stage that `--replicates`, `--budget` and `--profile` are about.
pub const TRAINING: &str = "training";
/// The stage of reports.
pub const REPORT: &str = "table-generation";
/// The axis that `--replicates` sets.
const SEED: &str = "seed";

/// The recipe with everything that the command line changes in it.
fn resolve(recipe: &RecipeArgs, device: DeviceClass) -> Result<Plan, CliError> {
    let (with, stages) = (&recipe.with, stages());
    let mut overrides = Overrides { set: with.set.clone(), of_stages: Vec::new() };
    if let Some(count) = with.replicates {
        let seeds: Vec<usize> = (0..count).collect();
        overrides.set.push(format!("axes.{SEED} = {seeds:?}"));
    }
    overrides.of_stages.extend(with.budget.map(|budget| StageOverride {
        stage: TRAINING.into(),
        option: "--budget",
        params: format!("budget_secs = {:?}", budget.as_secs_f64()),
    }));
    // The commands that a report prints make its numbers only with the arguments that made them here.
    let arguments = toml::Value::from(with.arguments(device));
    overrides.of_stages.push(StageOverride {
        stage: REPORT.into(),
        option: "command line",
        params: format!("arguments = {arguments}"),
    });
    let mut plan = engine::recipe::resolve_with(&recipe.recipe, &overrides, &stages, &with.data_root)?;
    let is_seedless = |node: &engine::Node| node.stage == TRAINING && !node.coordinates.contains_key(SEED);
    if with.replicates.is_some() && plan.nodes.iter().any(is_seedless) {
        let hint = format!("add an axis `{SEED}`, train over it, and give it on: params.seed = \"{{{SEED}}}\"");
        let failure = Failure::new(FailureKind::BadInput, "the recipe trains without seeds: nothing to replicate");
        return Err(CliError::Input(failure.hint(hint).at(&recipe.recipe).into()));
    }
    plan.device = device;
    Ok(plan)
}

/// A resolved recipe, the store, and which of its jobs are meant.
pub struct Session {
    pub plan: Plan,
    pub store: Store,
    pub data_root: PathBuf,
    pub device: ChosenDevice,
    /// Whether the command line changes nothing in the recipe.
    pub is_plain: bool,
    /// The jobs asked for.
    pub targets: BTreeSet<usize>,
    /// Jobs to run even if their results are there.
    pub force: BTreeSet<usize>,
    pub rehash: bool,
}

impl Session {
    /// Resolves the recipe and opens the store, making it if needed; all jobs are meant.
    pub fn open(store: &Path, recipe: &RecipeArgs) -> Result<Self, CliError> {
        Self::with(|| Store::open(store), recipe)
    }

    /// The same for verbs that only look: no store is made.
    pub fn look(store: &Path, recipe: &RecipeArgs) -> Result<Self, CliError> {
        Self::with(|| Store::look(store), recipe)
    }

    fn with(store: impl FnOnce() -> anyhow::Result<Store>, recipe: &RecipeArgs) -> Result<Self, CliError> {
        let device = ChosenDevice::choose(&recipe.with.device)?;
        let plan = resolve(recipe, device.class())?;
        for idle in plan.idle_axes() {
            tell(&format!("warning: {idle}; give it to a parameter, as \"{{{}}}\", or leave it out", idle.axis));
        }
        let targets = (0..plan.nodes.len()).collect();
        let (data_root, is_plain) = (recipe.with.data_root.clone(), recipe.with.is_plain());
        Ok(Self { plan, store: store()?, data_root, device, is_plain, targets, force: BTreeSet::new(), rehash: false })
    }

    /// The same with a selection of jobs.
    pub fn select(mut self, selection: &SelectionArgs) -> Result<Self, CliError> {
        self.targets = self.plan.select(&selection.only)?;
        if !selection.force.is_empty() {
            self.force = self.plan.select(&selection.force)?;
        }
        self.rehash = selection.rehash;
        Ok(self)
    }

    /// What a run of the targets would do, by node index.
    pub fn predict(&self) -> Result<BTreeMap<usize, Prediction>, CliError> {
        self.predict_for(&self.targets)
    }

    /// What a run of `targets` would do, by node index.
    pub fn predict_for(&self, targets: &BTreeSet<usize>) -> Result<BTreeMap<usize, Prediction>, CliError> {
        let nodes = self.plan.with_ancestors(targets);
        let sources = Sources::digest(&self.plan, &nodes, &self.data_root, &self.store, self.rehash)?;
        Ok(predict(&self.plan, &self.store, &nodes, &self.force, &sources)?)
    }

    /// Whether a run of the targets may compute on a GPU.
    pub fn needs_device(&self) -> Result<bool, CliError> {
        if self.device.class() == DeviceClass::Cpu {
            return Ok(false);
        }
        let may_compute =
            |(&index, prediction): (&usize, &Prediction)| self.plan.nodes[index].on_device && prediction.may_run();
        Ok(self.predict()?.iter().any(may_compute))
    }

    /// The index of the job called `name`.
    pub fn node(&self, name: &str) -> Result<usize, CliError> {
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

    /// The record of one job's result: the current one or, of a recipe as it is, the last one that it has on this class of
    /// devices, with a warning that says which. Another recipe's is never taken.
    pub fn record(&self, index: usize) -> Result<ActionRecord, CliError> {
        if let Some(Prediction { state: State::Cached { record }, .. }) =
            self.predict_for(&BTreeSet::from([index]))?.remove(&index)
        {
            return Ok(*record);
        }
        let (node, recipe) = (&self.plan.nodes[index], &self.plan.recipe);
        let history = if self.is_plain { History::read(&self.store)? } else { History::default() };
        let Some(last) = history.newest(recipe, node, Some(self.plan.device)) else {
            let message = format!("{} of recipe {recipe} has no result on this device", node.name);
            let same = if self.is_plain { "" } else { ", with the same -s, --replicates and --budget" };
            return Err(CliError::nothing(message, format!("run the recipe first{same}")));
        };
        let Provenance { run, .. } = &last.provenance;
        tell(&format!(
            "warning: the recipe, its data or the code differ from what {} ran with; this is its last result, of run {run}",
            node.name
        ));
        Ok(last.clone())
    }
}
