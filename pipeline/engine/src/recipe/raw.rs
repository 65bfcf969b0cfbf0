//! The recipe as typed data: keys and types are checked; stages are not consulted yet.

mod conditions;

use std::collections::{BTreeMap, BTreeSet};

use indexmap::IndexMap;
use serde_json::Value;

use super::errors::Report;
use super::hints::KnownParams;
use super::load::{Loaded, OfStage};
use super::places::Place;
use super::tree::{Item, Table, Tree};
use crate::suggest::names_hint;
use conditions::{Axes, conditions, only};

pub(super) use conditions::Conditions;

/// A recipe with known keys of the right types. Anything else is an error in the report and is left out.
#[derive(Default)]
pub(super) struct RawRecipe {
    pub(super) name: Option<String>,
    pub(super) axes: IndexMap<String, Axis>,
    pub(super) templates: IndexMap<String, Template>,
    pub(super) rules: Vec<Rule>,
    /// Parameters from the command line for all jobs of a stage.
    pub(super) of_stages: Vec<OfStage>,
}

impl RawRecipe {
    /// The name of the axis with this index.
    pub(super) fn axis_name(&self, axis: usize) -> &str {
        self.axes.get_index(axis).map_or("", |(name, _)| name)
    }

    /// Whether each of these axes has one of the values.
    pub(super) fn has_values(&self, wanted: &Conditions) -> bool {
        wanted.iter().all(|(&axis, wanted)| self.axes[axis].values.iter().any(|value| wanted.contains(&value.text)))
    }
}

#[derive(Default)]
pub(super) struct Axis {
    pub(super) at: Place,
    pub(super) values: Vec<AxisValue>,
}

/// A value of an axis: as text for names and coordinates, as a typed value for parameters.
#[derive(Clone)]
pub(super) struct AxisValue {
    pub(super) text: String,
    pub(super) value: Value,
}

/// One `[nodes.NAME]`.
pub(super) struct Template {
    pub(super) at: Place,
    pub(super) stage: Named,
    /// Indices into the axes, increasing.
    pub(super) over: Vec<usize>,
    /// Axis index → the values for which there are jobs. Axes without an entry have jobs for all values.
    pub(super) only: Conditions,
    /// Axis index → the values of which the recipe must have one. Otherwise, all jobs are left out.
    pub(super) only_with: Conditions,
    pub(super) inputs: Vec<Wire>,
    /// The jobs whose parameters and rules this node's own override.
    pub(super) like: Option<Like>,
    pub(super) params: Table,
    pub(super) params_at: Place,
}

/// `like = "template"`, or `like = { node = "template", axis = "value" }` for axes that only the other template has.
pub(super) struct Like {
    pub(super) node: Named,
    /// Axis index and value.
    pub(super) values: Vec<(usize, AxisValue)>,
}

/// A name in the recipe.
#[derive(Clone)]
pub(super) struct Named {
    pub(super) name: String,
    pub(super) at: Place,
}

/// `port = "template"` or `port = ["template", …]`.
pub(super) struct Wire {
    pub(super) port: Named,
    pub(super) from: Vec<Named>,
}

/// One `[[set]]`, or the overrides of the command line.
pub(super) struct Rule {
    /// Axis index → the values for which the rule applies.
    pub(super) when: Conditions,
    /// Template → parameters that override its own.
    pub(super) params: Vec<(String, Table)>,
}

const ROOT_KEYS: [&str; 6] = ["extends", "name", "axes", "nodes", "set", "sweep"];
/// The keys that an option can change: it can neither add a base nor rules.
const OPTION_KEYS: [&str; 3] = ["name", "axes", "nodes"];
const NODE_KEYS: [&str; 7] = ["stage", "over", "only", "only_with", "inputs", "like", "params"];
const RULE_KEYS: [&str; 2] = ["when", "nodes"];

/// Reads the merged text.
pub(super) fn read(loaded: Loaded, known: &KnownParams, report: &mut Report) -> RawRecipe {
    let mut recipe = RawRecipe { of_stages: loaded.of_stages, ..RawRecipe::default() };
    refuse_unknown(&loaded.root, "", &ROOT_KEYS, known, report);
    recipe.name = loaded.root.get("name").and_then(|item| recipe_name(item, report));
    for (key, item) in table_at(&loaded.root, "axes", "axes", report) {
        let values = axis_values(key, item, report);
        recipe.axes.insert(key.clone(), Axis { at: item.key_at, values });
    }
    for (key, item) in table_at(&loaded.root, "nodes", "nodes", report) {
        let axes = Axes { here: &recipe.axes, anywhere: &loaded.axis_values };
        if let Some(template) = template(key, item, axes, known, report) {
            recipe.templates.insert(key.clone(), template);
        }
    }
    let numbered = loaded.rules.into_iter().enumerate().map(|(index, item)| (Some(index + 1), item));
    for (number, mut item) in numbered.chain(loaded.overrides.into_iter().map(|item| (None, item))) {
        item.visit("set", &mut |_, item| (item.at.rule, item.key_at.rule) = (number, number));
        recipe.rules.extend(rule(&item, &recipe, &loaded.axis_values, report));
    }
    recipe
}

fn recipe_name(item: &Item, report: &mut Report) -> Option<String> {
    let Named { name, at } = name(item, "name", report)?;
    check_name(&name, at, "name", report);
    Some(name)
}

fn axis_values(axis: &str, item: &Item, report: &mut Report) -> Vec<AxisValue> {
    let key = format!("axes.{axis}");
    check_name(axis, item.key_at, &key, report);
    let Tree::Array(items) = &item.tree else {
        let hint = "or \"all\", or { except = […] }, where a stage lists the values";
        report.add(&item.at, key, "an axis is an array of strings or numbers", Some(hint.into()));
        return Vec::new();
    };
    // Values that recipes cannot contain are reported already and left out.
    if items.is_empty() && !report.concerns(&key) {
        report.add(&item.at, &key, "an axis needs at least one value", None);
    }
    let (mut values, mut known) = (Vec::new(), BTreeSet::new());
    for item in items {
        let Some(text) = item.axis_text() else {
            report.add(&item.at, &key, "axis values are strings or numbers", None);
            continue;
        };
        check_characters(&text, item.at, &key, report);
        if known.insert(text.clone()) {
            values.push(AxisValue { text, value: item.to_json() });
        } else {
            report.add(&item.at, &key, format!("axis value `{text}` occurs twice"), None);
        }
    }
    values
}

fn template(name: &str, item: &Item, axes: Axes<'_>, known: &KnownParams, report: &mut Report) -> Option<Template> {
    let key = format!("nodes.{name}");
    check_name(name, item.key_at, &key, report);
    let fields = as_table(item, &key, report)?;
    refuse_unknown(fields, &format!("{key}."), &NODE_KEYS, known, report);
    // A node without a stage is kept, so that references to it are not reported as unknown.
    let stage = fields.get("stage").and_then(|item| self::name(item, &format!("{key}.stage"), report));
    let params = fields.get("params");
    let over = over(fields, &key, axes.here, report);
    Some(Template {
        at: item.key_at,
        stage: stage.unwrap_or(Named { name: String::new(), at: item.key_at }),
        only: only(fields, &key, &over, axes, report),
        only_with: conditions(fields, "only_with", &format!("{key}.only_with"), axes, report),
        over,
        inputs: wires(fields, &key, report),
        like: fields.get("like").and_then(|item| like(item, &format!("{key}.like"), axes.here, report)),
        params: params.and_then(|item| as_table(item, &format!("{key}.params"), report)).cloned().unwrap_or_default(),
        params_at: params.map_or(item.key_at, |item| item.key_at),
    })
}

fn over(fields: &Table, key: &str, axes: &IndexMap<String, Axis>, report: &mut Report) -> Vec<usize> {
    let key = format!("{key}.over");
    let mut over = BTreeSet::new();
    for axis in fields.get("over").map(|item| names(item, &key, report)).unwrap_or_default() {
        match axes.get_index_of(&axis.name) {
            Some(index) if over.insert(index) => (),
            Some(_) => report.add(&axis.at, &key, format!("axis `{}` occurs twice", axis.name), None),
            None => {
                let hint = Some(names_hint(&axis.name, axes.keys().map(String::as_str)));
                report.add(&axis.at, &key, format!("unknown axis `{}`", axis.name), hint);
            }
        }
    }
    over.into_iter().collect()
}

fn wires(fields: &Table, key: &str, report: &mut Report) -> Vec<Wire> {
    let key = format!("{key}.inputs");
    let mut wires = Vec::new();
    for (port, item) in table_at(fields, "inputs", &key, report) {
        let from = match &item.tree {
            Tree::Array(_) => names(item, &format!("{key}.{port}"), report),
            _ => name(item, &format!("{key}.{port}"), report).into_iter().collect(),
        };
        wires.push(Wire { port: Named { name: port.clone(), at: item.key_at }, from });
    }
    wires
}

fn like(item: &Item, key: &str, axes: &IndexMap<String, Axis>, report: &mut Report) -> Option<Like> {
    let Tree::Table(fields) = &item.tree else {
        return Some(Like { node: name(item, key, report)?, values: Vec::new() });
    };
    let mut values = Vec::new();
    for (axis, item) in fields.iter().filter(|(axis, _)| *axis != "node") {
        match (axes.get_index_of(axis), item.axis_text()) {
            (Some(index), Some(text)) => values.push((index, AxisValue { text, value: item.to_json() })),
            (Some(_), None) => report.add(&item.at, key, "axis values are strings or numbers", None),
            (None, _) => {
                let hint = Some(names_hint(axis, axes.keys().map(String::as_str).chain(["node"])));
                report.add(&item.key_at, key, format!("unknown axis `{axis}`"), hint);
            }
        }
    }
    let Some(node) = fields.get("node") else {
        report.add(&item.at, key, "`like` must name a node, e.g. { node = \"train\" }", None);
        return None;
    };
    Some(Like { node: name(node, key, report)?, values })
}

fn rule(
    item: &Item,
    recipe: &RawRecipe,
    known: &BTreeMap<String, BTreeSet<String>>,
    report: &mut Report,
) -> Option<Rule> {
    let fields = as_table(item, "set", report)?;
    refuse_unknown(fields, "set.", &RULE_KEYS, &KnownParams::default(), report);
    let axes = Axes { here: &recipe.axes, anywhere: known };
    let when = conditions(fields, "when", "set.when", axes, report);
    let mut params = Vec::new();
    for (name, item) in table_at(fields, "nodes", "set.nodes", report) {
        let key = format!("set.nodes.{name}");
        let Some(template) = recipe.templates.get(name) else {
            let hint = Some(names_hint(name, recipe.templates.keys().map(String::as_str)));
            report.add(&item.key_at, key, format!("unknown node `{name}`"), hint);
            continue;
        };
        if let Some((&axis, _)) = when.iter().find(|(axis, _)| !template.over.contains(axis)) {
            let axis = recipe.axis_name(axis);
            let message = format!("this rule depends on axis `{axis}`, over which node `{name}` is not expanded");
            report.add(&item.key_at, &key, message, None);
        }
        let Some(fields) = as_table(item, &key, report) else {
            continue;
        };
        refuse_unknown(fields, &format!("{key}."), &["params"], &KnownParams::default(), report);
        params.push((name.clone(), table_at(fields, "params", &format!("{key}.params"), report).clone()));
    }
    Some(Rule { when, params })
}

/// Recipes, axes and nodes are named in command-line arguments, where a leading `-` would make the name an option.
fn check_name(name: &str, at: Place, key: &str, report: &mut Report) {
    if name.starts_with('-') {
        report.add(&at, key, format!("the name `{name}` looks like an option"), Some("start it with a letter".into()));
    }
    check_characters(name, at, key, report);
}

/// Names become parts of job names, folders and patterns.
fn check_characters(name: &str, at: Place, key: &str, report: &mut Report) {
    let plain = |c: char| c.is_ascii_alphanumeric() || "._+-".contains(c);
    if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
        let part_of = if key == "name" { "a recipe's name" } else { "part of a job's name" };
        let hint = "use letters, digits, `_`, `-`, `+` and `.`, without a leading `.`";
        report.add(&at, key, format!("`{name}` cannot be {part_of}"), Some(hint.into()));
    }
}

fn refuse_unknown(table: &Table, prefix: &str, allowed: &[&str], known: &KnownParams, report: &mut Report) {
    for (key, item) in table.iter().filter(|(key, _)| !allowed.contains(&key.as_str())) {
        // A table at the top of a file is a misspelt section. An option may lack the path of a parameter.
        let is_option = report.texts.get(item.key_at.text).is_override;
        let hint = match (prefix.is_empty(), is_option) {
            (true, true) => known.option_hint((key, item), table, &NODE_KEYS, &OPTION_KEYS),
            (true, false) if item.as_table().is_some() => names_hint(key, allowed.iter().copied()),
            _ => known.hint(prefix, key, allowed),
        };
        report.add(&item.key_at, format!("{prefix}{key}"), format!("unknown key `{key}`"), Some(hint));
    }
}

/// The table under `key`; an empty one if the key is missing.
fn table_at<'a>(parent: &'a Table, key: &str, dotted: &str, report: &mut Report) -> &'a Table {
    static NONE: std::sync::LazyLock<Table> = std::sync::LazyLock::new(Table::new);
    parent.get(key).and_then(|item| as_table(item, dotted, report)).unwrap_or(&NONE)
}

fn as_table<'a>(item: &'a Item, key: &str, report: &mut Report) -> Option<&'a Table> {
    if item.as_table().is_none() {
        report.add(&item.at, key, format!("`{}` must be a table", last(key)), None);
    }
    item.as_table()
}

fn name(item: &Item, key: &str, report: &mut Report) -> Option<Named> {
    if item.as_str().is_none() {
        report.add(&item.at, key, format!("`{}` must be a string", last(key)), None);
    }
    Some(Named { name: item.as_str()?.into(), at: item.at })
}

fn names(item: &Item, key: &str, report: &mut Report) -> Vec<Named> {
    let Tree::Array(items) = &item.tree else {
        report.add(&item.at, key, format!("`{}` must be an array of strings", last(key)), None);
        return Vec::new();
    };
    items.iter().filter_map(|item| name(item, key, report)).collect()
}

fn last(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}
