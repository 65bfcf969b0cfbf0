//! The best values of a search as a recipe, which extends the searched one.

use std::fmt::Write as _;

use anyhow::Context;
use fs_err as fs;
use sweep::Entry;
use toml::{Table, Value};

use super::{Search, first};
use crate::error::CliError;
use crate::session::{SEED, TRAINING, planned};

/// Seeds for evaluating the best values: different from those that chose them.
const NEW_SEEDS: [i64; 3] = [1001, 1002, 1003];

/// Assignments as a layer of a recipe. Like overrides of the command line, parameters of nodes apply after all rules.
#[derive(Default)]
struct Layer {
    /// Everything else.
    root: Table,
    /// The parameters of nodes, one rule per assignment.
    rules: Vec<Table>,
}

/// Writes the recipe with the best values, whose objective has the text `value`. Returns a sentence that says how to
/// evaluate it.
pub(super) fn write(search: &Search<'_>, best: &Entry, value: &str) -> Result<String, CliError> {
    let recipe = search.best();
    let plan = planned(&search.recipe)?;
    let mut layer = Layer::of(search.recipe.with.set.iter().chain(&best.assignments))?;
    let is_seeded = plan.nodes.iter().any(|node| node.stage == TRAINING && node.coordinates.contains_key(SEED));
    let has_new_seeds = is_seeded && !Layer::of(&best.assignments)?.has_seeds();
    if has_new_seeds {
        layer.set_seeds(&NEW_SEEDS);
    }
    let base = &search.recipe.recipe;
    let base = match engine::builtin_name(base) {
        Some(_) => base.display().to_string(),
        None => std::path::absolute(base)?.display().to_string(),
    };
    let mut text = format!("# The best of a search: {value} on validation views.\n");
    if has_new_seeds {
        text += "# The seeds are different from those that chose the values.\n";
    }
    let _ = writeln!(text, "extends = [{}]\nname = \"{}-best\"\n", Value::from(base), plan.recipe);
    text += &layer.text()?;
    fs::write(&recipe.recipe, text).context("cannot write the best recipe")?;
    match planned(&recipe) {
        Err(CliError::Recipe(errors)) => {
            return Ok(format!(
                "The recipe of the best values is invalid: {}: {}",
                recipe.recipe.display(),
                first(&errors)
            ));
        }
        plan => plan?,
    };
    let seeds = if has_new_seeds { ", with new seeds," } else { "" };
    Ok(format!("Evaluate it once{seeds} on test views: `{}`", recipe.command("run", search.store)))
}

impl Layer {
    /// Later assignments win.
    fn of<'a>(assignments: impl IntoIterator<Item = &'a String>) -> anyhow::Result<Self> {
        let mut layer = Self::default();
        for text in assignments {
            let mut table: Table = text.parse().with_context(|| format!("cannot read the assignment {text}"))?;
            let params = take_params(&mut table);
            layer.rules.extend((!params.is_empty()).then(|| Table::from_iter([("nodes".into(), params.into())])));
            merge(&mut layer.root, table);
        }
        // The recipe has a name of its own.
        layer.root.remove("name");
        Ok(layer)
    }

    fn has_seeds(&self) -> bool {
        self.root.get("axes").is_some_and(|axes| axes.get(SEED).is_some())
    }

    fn set_seeds(&mut self, seeds: &[i64]) {
        let axes = Table::from_iter([(SEED.to_owned(), Value::from(seeds.to_vec()))]);
        merge(&mut self.root, Table::from_iter([("axes".to_owned(), Value::from(axes))]));
    }

    fn text(mut self) -> anyhow::Result<String> {
        if !self.rules.is_empty() {
            self.root.insert("set".into(), Value::from(self.rules));
        }
        toml::to_string(&self.root).context("cannot write the assignments")
    }
}

/// Takes the parameters of all nodes out of a table: `{ NODE = { params = … } }`.
fn take_params(table: &mut Table) -> Table {
    let mut taken = Table::new();
    let Some(Value::Table(nodes)) = table.get_mut("nodes") else { return taken };
    for (name, node) in nodes.iter_mut() {
        if let Some(params) = node.as_table_mut().and_then(|fields| fields.remove("params")) {
            taken.insert(name.clone(), Value::from(Table::from_iter([("params".to_owned(), params)])));
        }
    }
    nodes.retain(|_, node| node.as_table().is_none_or(|fields| !fields.is_empty()));
    if nodes.is_empty() {
        table.remove("nodes");
    }
    taken
}

/// Lays `over` over `base`: tables merge, everything else is replaced.
fn merge(base: &mut Table, over: Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(base)), Value::Table(over)) => merge(base, over),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assignments_of_any_form_make_one_valid_layer() {
        let lambda = |value: &str| format!("nodes.train.params.loss.lambda_dssim={value}");
        let texts = [
            "name=\"foo\"".to_owned(),
            "axes={scene=[\"a\"], seed=[0, 1]}".into(),
            "axes.method=[\"x\"]".into(),
            "nodes={train={params={schedule_scale=0.03}, over=[\"scene\"]}}".into(),
            lambda("0.5"),
            lambda("0.1 # twice"),
            "nodes.train.params.density={max_count=500}".into(),
            "nodes.train.params.density.gradient_threshold=1e-4".into(),
        ];
        let mut layer = Layer::of(&texts).unwrap();
        assert!(layer.has_seeds());
        layer.set_seeds(&NEW_SEEDS);
        let written: Table = layer.text().unwrap().parse().unwrap();
        let expected: Table = r#"
            axes = { scene = ["a"], method = ["x"], seed = [1001, 1002, 1003] }
            nodes = { train = { over = ["scene"] } }
            set = [
                { nodes = { train = { params = { schedule_scale = 0.03 } } } },
                { nodes = { train = { params = { loss = { lambda_dssim = 0.5 } } } } },
                { nodes = { train = { params = { loss = { lambda_dssim = 0.1 } } } } },
                { nodes = { train = { params = { density = { max_count = 500 } } } } },
                { nodes = { train = { params = { density = { gradient_threshold = 1e-4 } } } } },
            ]
        "#
        .parse()
        .unwrap();
        assert_eq!(written, expected);
        let nothing: [String; 0] = [];
        assert_eq!(Layer::of(&nothing).unwrap().text().unwrap(), "");
    }
}
