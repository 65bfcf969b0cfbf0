//! Arguments that name a recipe, change it, and select its jobs.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use clap::builder::NonEmptyStringValueParser;
use engine::DeviceClass;

use super::values::{replicates, some_time};
use crate::output::quoted;

/// The device if none is named.
pub(crate) const AUTO: &str = "auto";

/// The data folder if none is named.
const DATA_ROOT: &str = "data";

/// The store if none is named.
pub(crate) const STORE: &str = "store";

/// The environment variables that options are read from.
pub(crate) const VARIABLES: [&str; 3] = ["PIPELINE_STORE", "PIPELINE_DATA", "PIPELINE_DEVICE"];

/// A recipe and the conditions to apply it under.
#[derive(Clone, Debug, Args)]
pub(crate) struct RecipeArgs {
    /// Recipe to use: a TOML file, or builtin:NAME for one of `pipeline recipes list`
    pub(crate) recipe: PathBuf,
    #[command(flatten)]
    pub(crate) with: Conditions,
}

/// A recipe and one of its jobs.
#[derive(Debug, Args)]
pub(crate) struct NodeArgs {
    #[command(flatten)]
    pub(crate) recipe: RecipeArgs,
    /// Name of the job, e.g. train/lego/static3dgs/0
    #[arg(value_name = "JOB")]
    pub(crate) node: String,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

impl RecipeArgs {
    /// The command of a verb that finds the results of this command line.
    pub(crate) fn command(&self, verb: &str, store: &Path) -> String {
        command(verb, &self.recipe, &self.with.changes(), [store, &self.with.data.root, Path::new(&self.with.device)])
    }
}

/// `pipeline VERB RECIPE CHANGES…` for a shell, with the store, the data folder and the device if they are not implied.
pub(crate) fn command(verb: &str, recipe: &Path, changes: &[String], places: [&Path; 3]) -> String {
    let mut words = vec!["pipeline".to_owned(), verb.to_owned(), recipe.display().to_string()];
    words.extend(changes.iter().cloned());
    let defaults = [("--store", STORE), ("--data-root", DATA_ROOT), ("--device", AUTO)];
    for ((place, (option, default)), variable) in places.into_iter().zip(defaults).zip(VARIABLES) {
        let value = place.display().to_string();
        // The shell has the variables of this process.
        if value != std::env::var(variable).unwrap_or_else(|_| default.into()) {
            words.extend([option.into(), value]);
        }
    }
    words.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ")
}

/// The folder with all data.
#[derive(Clone, Debug, Args)]
pub(crate) struct DataArgs {
    /// Folder of the data sets; relative paths of data in recipes start here
    #[arg(long = "data-root", env = "PIPELINE_DATA", default_value = DATA_ROOT, value_name = "DIR")]
    pub(crate) root: PathBuf,
}

/// Data, device and changes to the recipe.
#[derive(Clone, Debug, Args)]
pub(crate) struct Conditions {
    #[command(flatten)]
    pub(crate) data: DataArgs,
    /// Override a value of the recipe, e.g. nodes.train.params.schedule_scale=0.5; can be repeated
    #[arg(short = 's', long = "set", value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
    /// Train with the seeds 0 to N − 1 instead of the recipe's seeds
    #[arg(long, value_parser = replicates, value_name = "N")]
    pub(crate) replicates: Option<usize>,
    /// Scale each training's schedule to take about TIME (e.g. 60s, 10m). The scale is calibrated at start-up, so
    /// results are not bit-reproducible
    #[arg(long, value_parser = some_time, value_name = "TIME")]
    pub(crate) budget: Option<Duration>,
    /// Device to train and render on: cpu, gpu (the adapter that is likely fastest), auto (a hardware GPU if there is
    /// one, otherwise the CPU), or an adapter by a part of its name, its PCI id or its PCI bus. Results of CPU and GPU
    /// are kept apart
    #[arg(long, env = "PIPELINE_DEVICE", default_value = AUTO, value_name = "DEVICE", value_parser = NonEmptyStringValueParser::new())]
    pub(crate) device: String,
    /// The split that all renders show instead of the recipe's.
    #[arg(skip)]
    pub(crate) render_split: Option<&'static str>,
}

impl Conditions {
    /// The arguments that change the recipe.
    pub(crate) fn changes(&self) -> Vec<String> {
        let mut arguments: Vec<String> = self.set.iter().flat_map(|set| ["-s".into(), set.clone()]).collect();
        arguments.extend(self.replicates.iter().flat_map(|count| ["--replicates".into(), count.to_string()]));
        let budget = self.budget.map(|budget| humantime::format_duration(budget).to_string().replace(' ', ""));
        arguments.extend(budget.into_iter().flat_map(|budget| ["--budget".into(), budget]));
        arguments
    }

    /// The arguments that reproduce the results on a device of this class. The location of the data cannot change a
    /// result, so `DATA` stands for a data folder other than the default.
    pub(crate) fn arguments(&self, device: DeviceClass) -> Vec<String> {
        let mut arguments = self.changes();
        arguments.extend(["--device".into(), device.as_str().into()]);
        let is_elsewhere = self.data.root != Path::new(DATA_ROOT);
        arguments.extend(["--data-root", "DATA"].map(String::from).into_iter().filter(|_| is_elsewhere));
        arguments
    }
}

/// A subset of a recipe's jobs.
#[derive(Clone, Debug, Args)]
pub(crate) struct SelectionArgs {
    /// Select only matching jobs and those that they depend on, e.g. train/lego or train/*/static*; can be repeated
    #[arg(long, value_name = "PATTERN")]
    pub(crate) only: Vec<String>,
    /// Run matching jobs even if their results exist; can be repeated
    #[arg(long, value_name = "PATTERN")]
    pub(crate) force: Vec<String>,
    /// Hash all source files again instead of trusting their time stamps
    #[arg(long)]
    pub(crate) rehash: bool,
}
