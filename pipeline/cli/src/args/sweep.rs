//! `run --sweep`: a search over parameters, from the command line and from the recipe's `[sweep]`.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::time::Duration;

use ::sweep::{Parameter, Space, Strategy};
use clap::{Args, ValueEnum};
use engine::recipe::{RecipeError, RecipeErrors};
use jiff::Zoned;
use jiff::civil::Time;
use serde::Deserialize;
use table_generation::Column;
use toml::Spanned;

use super::goal::{Goal, Limit};
use super::values::{at_least_one, left_until, part, some_time, time_of_day};
use crate::error::CliError;

/// The default number of trials.
const TRIALS: usize = 20;
/// The default reduction factor: the best 1/N of the trials of a rung continue.
const REDUCTION: usize = 3;
/// How values are chosen.
#[derive(Clone, Copy, Debug, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(crate) enum StrategyName {
    /// Every combination
    Grid,
    /// Independent values
    Random,
    /// Evenly spread values (Sobol)
    Sobol,
    /// Half of the trials near the best ones so far (TPE)
    Tpe,
}

/// The options of a search. Those of the command line take precedence over those of the recipe.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct SweepArgs {
    /// Search over a parameter, e.g. nodes.train.params.schedule_scale=0.1,0.3 or KEY=log(1e-4,1e-2), uniform(0,1),
    /// int(1,8), and for some methods only: 'KEY=1,2 when method=scgs|mcgs'; can be repeated. The search improves the
    /// objective on validation views; see pipeline/sweep
    #[arg(long = "sweep", value_name = "KEY=VALUES", help_heading = "Search")]
    #[arg(conflicts_with_all = ["frozen", "precision", "profile", "budget", "only", "force", "json", "rehash", "require_data"])]
    pub(crate) parameters: Vec<Parameter>,
    /// How values are chosen (default: grid if there are few combinations, otherwise tpe)
    #[arg(long, value_enum, help_heading = "Search")]
    pub(crate) strategy: Option<StrategyName>,
    /// Start at most N trials (default: 20, or all combinations of a grid); more trials later continue the same search
    #[arg(long, value_parser = at_least_one, value_name = "N", help_heading = "Search")]
    pub(crate) trials: Option<usize>,
    /// Compare trials at N points of the training's last phase and continue only the best (default: 1, all trials are
    /// completed)
    #[arg(long, value_parser = at_least_one, value_name = "N", help_heading = "Search")]
    pub(crate) rungs: Option<usize>,
    /// With --rungs: continue the best of every N trials at each rung (default: 3)
    #[arg(long, value_parser = clap::value_parser!(u64).range(2..), value_name = "N", help_heading = "Search")]
    pub(crate) reduction: Option<u64>,
    /// Start no trial after TIME, e.g. 8h
    #[arg(long, value_parser = some_time, value_name = "TIME", help_heading = "Search")]
    pub(crate) within: Option<Duration>,
    /// Start no trial after this local time of day, e.g. 07:00
    #[arg(long, value_parser = time_of_day, value_name = "HH:MM", conflicts_with = "within", help_heading = "Search")]
    pub(crate) until: Option<Time>,
    /// Column of the table by which trials are compared: high values win for e.g. ssim, low ones for e.g. lpips_alex or
    /// training_secs (default: psnr_at_end, from the training's own curve, which needs no renders)
    #[arg(long, value_parser = Column::named, value_name = "COLUMN", help_heading = "Search")]
    pub(crate) objective: Option<Column>,
    /// Discard trials for which the mean of a column violates a limit, e.g. training_secs<=60, gaussians<=20000,
    /// size_mb<=5, psnr>=28; can be repeated
    #[arg(long = "limit", value_name = "COLUMN<=VALUE", help_heading = "Search")]
    pub(crate) limits: Vec<Limit>,
    /// Seed of the search
    #[arg(long, value_name = "N", help_heading = "Search")]
    pub(crate) sweep_seed: Option<u64>,
    /// At the end, train the best values with new seeds and evaluate them on test views: a run of the best recipe
    #[arg(long, conflicts_with = "on", help_heading = "Search")]
    pub(crate) evaluate: bool,
    /// Stop when the process of this number, which started this one, ends
    #[arg(long, hide = true, requires = "search_part", value_name = "PID")]
    pub(crate) search_parent: Option<u32>,
    /// Be process K of N of a search
    #[arg(long, hide = true, value_parser = part, value_name = "K/N")]
    pub(crate) search_part: Option<(usize, usize)>,
    /// Start no trial after this time, in seconds since 1970
    #[arg(long, hide = true, value_name = "SECS")]
    pub(crate) search_end: Option<f64>,
    /// Be a batch job of the run of this name
    #[arg(long, hide = true, value_name = "RUN", requires = "search_wave")]
    pub(crate) search_run: Option<String>,
    /// The wave of the batch job
    #[arg(long, hide = true, value_name = "N")]
    pub(crate) search_wave: Option<usize>,
    /// Close the wave
    #[arg(long, hide = true, requires = "search_wave")]
    pub(crate) search_report: bool,
}

/// The part of a recipe that defines a search.
#[derive(Debug, Default, Deserialize)]
struct Root {
    #[serde(default)]
    sweep: Table,
}

/// `[sweep]` of a recipe.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Table {
    parameters: BTreeMap<String, Spanned<toml::Value>>,
    strategy: Option<StrategyName>,
    trials: Option<usize>,
    rungs: Option<usize>,
    reduction: Option<u64>,
    within: Option<Spanned<String>>,
    until: Option<Spanned<String>>,
    objective: Option<Spanned<String>>,
    limits: Vec<Spanned<String>>,
    seed: Option<u64>,
}

/// The text of a recipe with its path, for errors in its `[sweep]`.
#[derive(Clone, Copy)]
struct Source<'a> {
    recipe: &'a Path,
    text: &'a str,
}

impl Source<'_> {
    /// The table; empty if the recipe has none, or cannot be parsed, which is reported when it is resolved.
    fn table(self) -> Result<Table, RecipeErrors> {
        if self.text.parse::<toml::Table>().is_err() {
            return Ok(Table::default());
        }
        let root: Result<Root, toml::de::Error> = toml::from_str(self.text);
        root.map(|root| root.sweep)
            .map_err(|error| self.error(error.span().unwrap_or_default(), "sweep", error.message().replace('\n', ", ")))
    }

    /// Converts a value of the table, or reports what is wrong with it.
    fn read<T, U>(
        self,
        key: &str,
        value: &Spanned<T>,
        convert: impl FnOnce(&T) -> Result<U, String>,
    ) -> Result<U, RecipeErrors> {
        convert(value.get_ref()).map_err(|message| self.error(value.span(), &format!("sweep.{key}"), message))
    }

    fn error(self, span: Range<usize>, key: &str, message: String) -> RecipeErrors {
        RecipeErrors(vec![RecipeError::in_text(self.recipe, self.text, span, key, message, None)])
    }
}

/// A search as the user defines it.
#[derive(Clone, Debug)]
pub(crate) struct SweepSettings {
    /// The parameters with all of their conditions.
    pub(crate) space: Space,
    pub(crate) strategy: Option<StrategyName>,
    /// The maximum number of trials, if the user sets it.
    pub(crate) trials: Option<usize>,
    pub(crate) rungs: usize,
    pub(crate) reduction: usize,
    pub(crate) within: Option<Duration>,
    pub(crate) goal: Goal,
    pub(crate) seed: u64,
}

impl SweepArgs {
    /// The search that the command line and the text of the recipe define; `None` if neither does.
    pub(crate) fn settings(&self, recipe: &Path, text: &str) -> Result<Option<SweepSettings>, CliError> {
        let source = Source { recipe, text };
        let table = source.table()?;
        let mut parameters: Vec<Parameter> = Vec::new();
        for (key, values) in &table.parameters {
            parameters.push(source.read("parameters", values, |values| Parameter::new(key, &words(values)?))?);
        }
        parameters.retain(|old| self.parameters.iter().all(|new| new.key != old.key));
        parameters.extend(self.parameters.iter().cloned());
        let goal = self.goal(&table, source)?;
        // A time limit on the command line replaces both time limits of the recipe.
        let (until, within) = match (self.until, self.within) {
            (None, None) => {
                let until = table.until.as_ref().map(|text| source.read("until", text, |text| time_of_day(text)));
                let within = table.within.as_ref().map(|text| source.read("within", text, |text| some_time(text)));
                (until.transpose()?, within.transpose()?)
            }
            of_command_line => of_command_line,
        };
        if parameters.is_empty() {
            return Ok(None);
        }
        let until = until.map(|time| left_until(time, &Zoned::now())).transpose().map_err(CliError::Usage)?;
        let rungs = self.rungs.or(table.rungs).unwrap_or(1).max(1);
        if rungs == 1 && self.reduction.is_some() {
            return Err(CliError::Usage("--reduction has no effect with one rung: add --rungs N".into()));
        }
        let reduction = self.reduction.or(table.reduction).filter(|_| rungs > 1);
        Ok(Some(SweepSettings {
            space: Space(parameters),
            strategy: self.strategy.or(table.strategy),
            trials: self.trials.or(table.trials),
            rungs,
            reduction: reduction.map_or(REDUCTION, |reduction| reduction.max(2) as usize),
            within: until.into_iter().chain(within).min(),
            goal,
            seed: self.sweep_seed.or(table.seed).unwrap_or(0),
        }))
    }
}

impl SweepSettings {
    /// How values are chosen, and the maximum number of trials, in a space whose conditions on axes are settled.
    pub(crate) fn plan(&self, settled: &Space) -> Result<(Strategy, usize), CliError> {
        let grid = settled.grid_size();
        let is_small = grid.is_some_and(|size| size <= self.trials.unwrap_or(TRIALS));
        let strategy = match self.strategy {
            Some(StrategyName::Random) => Strategy::Random,
            Some(StrategyName::Sobol) => Strategy::Sobol,
            Some(StrategyName::Tpe) => Strategy::Tpe,
            None if !is_small => Strategy::Tpe,
            Some(StrategyName::Grid) | None => {
                let hint = "a grid needs listed values for every parameter, e.g. KEY=0.1,0.3";
                let size = grid.ok_or_else(|| CliError::Usage(hint.into()))?;
                return Ok((Strategy::Grid, self.trials.unwrap_or(size).min(size)));
            }
        };
        Ok((strategy, self.trials.unwrap_or(TRIALS)))
    }
}

impl SweepArgs {
    /// A parameter that the command line has twice.
    pub(crate) fn repeated(&self) -> Option<&str> {
        let keys: Vec<&str> = self.parameters.iter().map(|parameter| parameter.key.as_str()).collect();
        keys.iter().enumerate().find(|(at, key)| keys[..*at].contains(key)).map(|(_, key)| *key)
    }

    /// An option of a search that the command line has.
    pub(crate) fn named(&self) -> Option<&'static str> {
        let named = [
            ("--strategy", self.strategy.is_some()),
            ("--trials", self.trials.is_some()),
            ("--rungs", self.rungs.is_some()),
            ("--reduction", self.reduction.is_some()),
            ("--within", self.within.is_some()),
            ("--until", self.until.is_some()),
            ("--objective", self.objective.is_some()),
            ("--limit", !self.limits.is_empty()),
            ("--sweep-seed", self.sweep_seed.is_some()),
            ("--evaluate", self.evaluate),
        ];
        named.into_iter().find(|(_, is_named)| *is_named).map(|(option, _)| option)
    }

    /// The objective and the limits; those of the command line take precedence over those of the recipe.
    fn goal(&self, table: &Table, source: Source<'_>) -> Result<Goal, RecipeErrors> {
        let of_table = table.objective.as_ref();
        let of_table = of_table.map(|name| source.read("objective", name, |name| Column::named(name))).transpose()?;
        let limit = |text: &Spanned<String>| source.read("limits", text, |text| text.parse::<Limit>());
        let mut limits: Vec<Limit> = table.limits.iter().map(limit).collect::<Result<_, _>>()?;
        limits.retain(|old| self.limits.iter().all(|new| !new.replaces(old)));
        limits.extend(&self.limits);
        Ok(Goal { objective: self.objective.or(of_table).unwrap_or(Column::PsnrAtEnd), limits })
    }
}

/// The values of a parameter in `[sweep]` as on the command line: text, an array of values, or a table of both with a
/// condition.
fn words(values: &toml::Value) -> Result<String, String> {
    let toml::Value::Table(table) = values else { return Ok(listed(values)) };
    if let Some(unknown) = table.keys().find(|key| !["values", "when"].contains(&key.as_str())) {
        return Err(format!("unknown key `{unknown}`: expected {{ values = …, when = {{ AXIS = … }} }}"));
    }
    let text = table.get("values").map(listed).unwrap_or_default();
    let Some(when) = table.get("when") else { return Ok(text) };
    let conditions: Vec<_> = when.as_table().into_iter().flatten().collect();
    let [(axis, allowed)] = conditions[..] else {
        return Err("`when` takes one axis with its values, e.g. { method = \"scgs\" }".into());
    };
    Ok(format!("{text} when {axis}={}", listed(allowed).replace(',', "|")))
}

/// Text as it is, and the values of an array with commas between them.
fn listed(values: &toml::Value) -> String {
    match values {
        toml::Value::String(text) => text.clone(),
        toml::Value::Array(items) => items.iter().map(toml::Value::to_string).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECIPE: &str = "[sweep]\ntrials = 7\nparameters = { \"a.b\" = [1, 2], \"c\" = \"log(0.1, 1)\" }\n";

    /// The line of an error in `[sweep]`, with its key and message.
    fn place(error: CliError) -> (usize, String) {
        let CliError::Recipe(RecipeErrors(errors)) = error else { panic!("{error:?}") };
        (errors[0].line, format!("{}: {}", errors[0].key, errors[0].message))
    }

    #[test]
    fn the_command_line_wins_over_the_recipe() {
        let settings = |args: &SweepArgs, text: &str| args.settings(Path::new("x.toml"), text);
        let of_recipe = settings(&SweepArgs::default(), RECIPE).unwrap().unwrap();
        let plan = |settings: &SweepSettings| settings.plan(&settings.space).unwrap();
        assert_eq!((plan(&of_recipe), of_recipe.rungs), ((Strategy::Tpe, 7), 1));
        let args = SweepArgs { parameters: vec!["c=1,2".parse().unwrap()], trials: Some(3), ..SweepArgs::default() };
        let both = settings(&args, RECIPE).unwrap().unwrap();
        let keys: Vec<String> = both.space.0.iter().map(ToString::to_string).collect();
        assert_eq!(keys, ["a.b=1,2", "c=1,2"]);
        assert_eq!(plan(&both), (Strategy::Tpe, 3), "four combinations are more than three trials");
        let grid = settings(&SweepArgs { trials: None, ..args }, "").unwrap().unwrap();
        assert_eq!((plan(&grid), grid.rungs), ((Strategy::Grid, 2), 1));
        let named = SweepSettings { strategy: Some(StrategyName::Grid), ..of_recipe };
        assert!(matches!(named.plan(&named.space), Err(CliError::Usage(_))), "a range has no grid");
        assert!(settings(&SweepArgs::default(), "").unwrap().is_none());
        assert_eq!((grid.goal.objective, grid.goal.limits.len()), (Column::PsnrAtEnd, 0));
        let wrong = |text: &str| place(settings(&SweepArgs::default(), text).unwrap_err());
        let (line, text) = wrong(&RECIPE.replace("trials", "trails"));
        assert!(line == 2 && text.contains("trails") && text.contains("trials"), "{text}");
        let timed = format!("{RECIPE}within = \"1s\"\n");
        assert_eq!(settings(&SweepArgs::default(), &timed).unwrap().unwrap().within, Some(Duration::from_secs(1)));
        let until = SweepArgs { until: Some(jiff::civil::time(7, 0, 0, 0)), ..SweepArgs::default() };
        let left = settings(&until, &timed).unwrap().unwrap().within.unwrap();
        assert!(left > Duration::from_secs(1), "until 07:00, whatever the recipe says: {left:?}");
        let alone = SweepArgs { within: Some(Duration::from_secs(60)), ..SweepArgs::default() };
        assert!(settings(&alone, "").unwrap().is_none() && alone.named() == Some("--within"));
        let never = format!("{RECIPE}within = \"0s\"\n");
        let (line, text) = wrong(&never);
        assert!(line == 4 && text.starts_with("sweep.within: expected a time longer than"), "{text}");
    }

    #[test]
    fn a_recipe_states_objective_limits_and_conditions() {
        let text = "[sweep]\nobjective = \"lpips_alex\"\nlimits = [\"gaussians<=500\", \"size_mb<=5\"]\n[sweep.parameters]\n\
                    \"n.k\" = { values = [64, 128], when = { method = [\"scgs\", \"mcgs\"] } }\n";
        let args = SweepArgs { limits: vec!["gaussians<=100".parse().unwrap()], ..SweepArgs::default() };
        let settings = args.settings(Path::new("x.toml"), text).unwrap().unwrap();
        assert_eq!(settings.goal.objective.key(), "lpips_alex");
        let limits: Vec<String> = settings.goal.limits.iter().map(ToString::to_string).collect();
        assert_eq!(limits, ["size_mb<=5", "gaussians<=100"]);
        assert_eq!(settings.space.0[0].to_string(), "n.k=64,128 when method=scgs|mcgs");
        let wrong = |text: &str| place(SweepArgs::default().settings(Path::new("x.toml"), text).unwrap_err());
        let (line, message) = wrong(&text.replace("lpips_alex", "lpips"));
        assert!(line == 2 && message.starts_with("sweep.objective: no column is called `lpips`"), "{message}");
        let (line, message) = wrong(&text.replace("when = {", "when = { seed = [1],"));
        assert!(line == 5 && message.starts_with("sweep.parameters: `when` takes one axis"), "{message}");
    }
}
