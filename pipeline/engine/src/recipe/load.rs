//! Reads a recipe with everything that it extends and the overrides of the command line.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::errors::{Report, join_arrows};
use super::hints;
use super::places::Place;
use super::tree::{self, Item, Table, Tree};
use crate::library::{Library, builtin_name, extended_path};

/// The changes that the command line makes to a recipe.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Assignments of values, e.g. `nodes.train.params.iterations=500`.
    pub set: Vec<String>,
    /// Parameters for all jobs of a stage.
    pub of_stages: Vec<StageOverride>,
}

/// Parameters that one option of the command line sets for all jobs of a stage.
#[derive(Clone, Debug)]
pub struct StageOverride {
    /// The stage's id.
    pub stage: String,
    /// The option that messages name, e.g. `--budget`.
    pub option: &'static str,
    /// The parameters in TOML, e.g. `budget_secs = 60.0`.
    pub params: String,
    /// Whether they replace only defaults and values that the recipe inherits, not its own values or those of `-s`.
    pub yields: bool,
}

/// The merged text of a recipe, before it is interpreted.
#[derive(Default)]
pub(super) struct Loaded {
    /// All layers merged, without `extends` and `set`.
    pub(super) root: Table,
    /// The entries of `[[set]]`: base recipes first.
    pub(super) rules: Vec<Item>,
    /// Parameters of nodes from the command line, applied after all rules.
    pub(super) overrides: Vec<Item>,
    /// Parameters from the command line for all jobs of a stage, applied last.
    pub(super) of_stages: Vec<OfStage>,
    /// Every value that any layer gives an axis: a recipe may narrow an axis and keep the rules of its base.
    pub(super) axis_values: BTreeMap<String, BTreeSet<String>>,
    /// The axes that any layer writes as all values that a stage lists.
    pub(super) axes_of_all: BTreeSet<String>,
}

/// The parsed parameters of a [`StageOverride`].
pub(super) struct OfStage {
    pub(super) stage: String,
    pub(super) params: Table,
    pub(super) yields: bool,
}

/// Reads the recipe at `path` and reports all errors. Returns nothing if a file cannot be read: without it, the other
/// files would only raise spurious errors.
pub(super) fn load(path: &Path, overrides: &Overrides, library: Library, report: &mut Report) -> Option<Loaded> {
    let mut reader = Reader { library, stack: Vec::new(), report, loaded: Loaded::default() };
    let root = reader.read(path, None);
    let mut loaded = reader.loaded;
    let tables: Vec<Option<Table>> = overrides
        .set
        .iter()
        .map(|text| {
            let text = report.texts.add(Path::new("-s"), text.clone(), true);
            read_override(text, report)
        })
        .collect();
    loaded.root = root?;
    tables.into_iter().flatten().for_each(|table| add_override(&mut loaded, table));
    for StageOverride { stage, option, params, yields } in &overrides.of_stages {
        let text = report.texts.add(Path::new(option), params.clone(), true);
        let of_stage = |params| OfStage { stage: stage.clone(), params, yields: *yields };
        loaded.of_stages.extend(tree::parse(text, report).map(of_stage));
    }
    Some(loaded)
}

/// Reads a recipe and all recipes that it extends.
struct Reader<'a> {
    library: Library,
    /// The recipes that extend the one being read.
    stack: Vec<PathBuf>,
    report: &'a mut Report,
    loaded: Loaded,
}

impl Reader<'_> {
    /// Reads one recipe and merges it over the recipes that it extends. `named_at` is the place that names it.
    fn read(&mut self, path: &Path, named_at: Option<&Item>) -> Option<Table> {
        let identity = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let content = self.content(path);
        let text = self.report.texts.add(path, content.as_deref().unwrap_or("").into(), false);
        if let Err(error) = content {
            self.report_unreadable(path, &error, text, named_at);
            return None;
        }
        if let Some(first) = self.stack.iter().position(|open| *open == identity) {
            let place = named_at.map_or(Place::new(text, 0..0), |item| item.at);
            let names = self.stack[first..].iter().chain([&identity]).map(|path| path.display().to_string());
            self.report.add(&place, "extends", format!("recipes extend each other: {}", join_arrows(names)), None);
            return None;
        }
        let mut own = tree::parse(text, self.report)?;
        let extends = own.shift_remove("extends");
        self.stack.push(identity);
        let (mut merged, mut is_whole) = (Table::new(), true);
        let first_rule = self.loaded.rules.len();
        let bases = extends.as_ref().map(|item| extended(item, self.report)).unwrap_or_default();
        for item in bases {
            let inherited = first_rule..self.loaded.rules.len();
            match self.read(&extended_path(path, item.as_str().unwrap_or_default()), Some(item)) {
                Some(mut base) => {
                    // A recipe inherits neither the name of its base nor its search: the best recipe of a search extends
                    // the searched one.
                    ["name", "sweep"].iter().for_each(|key| drop(base.shift_remove(*key)));
                    lay_over(&mut merged, base, &mut self.loaded.rules[inherited]);
                }
                None => is_whole = false,
            }
        }
        self.stack.pop();
        let inherited = first_rule..self.loaded.rules.len();
        add_layer(&mut own, &mut self.loaded, self.report);
        lay_over(&mut merged, own, &mut self.loaded.rules[inherited]);
        is_whole.then_some(merged)
    }

    fn content(&self, path: &Path) -> io::Result<String> {
        match builtin_name(path) {
            Some(name) => self.library.text(name).map(str::to_owned).ok_or_else(|| ErrorKind::NotFound.into()),
            None => std::fs::read_to_string(path),
        }
    }

    /// Reports an unreadable recipe at the line that names it. The recipe of the command line has no line.
    fn report_unreadable(&mut self, path: &Path, error: &io::Error, text: usize, named_at: Option<&Item>) {
        let (message, hint) = match error.kind() {
            ErrorKind::NotFound => {
                (format!("no such recipe: {}", path.display()), hints::missing_recipe(path, self.library))
            }
            _ => (format!("cannot read the recipe ({error}): {}", path.display()), None),
        };
        match named_at {
            Some(item) => self.report.add(&item.at, "extends", message, hint),
            None => self.report.add_for_file(text, message, hint),
        }
    }
}

/// The entries of `extends`, if it is an array of strings.
fn extended<'a>(item: &'a Item, report: &mut Report) -> &'a [Item] {
    match &item.tree {
        Tree::Array(items) if items.iter().all(|item| item.as_str().is_some()) => items,
        _ => {
            report.add(&item.at, "extends", "`extends` must be an array of file names", None);
            &[]
        }
    }
}

/// Lays `over` over the layers in `base`, whose rules are `rules`. Where it gives a node another stage, what these layers state
/// about the node's parameters is dropped: the other stage does not have them.
fn lay_over(base: &mut Table, over: Table, rules: &mut [Item]) {
    for name in restaged(base, &over) {
        if let Some(node) = nodes_of(base).and_then(|nodes| nodes.get_mut(&name)?.as_table_mut()) {
            node.shift_remove("params");
        }
        for nodes in rules.iter_mut().filter_map(|rule| nodes_of(rule.as_table_mut()?)) {
            nodes.shift_remove(&name);
        }
    }
    tree::merge(base, over);
}

/// The nodes to which `over` gives another stage than `base`.
fn restaged(base: &Table, over: &Table) -> Vec<String> {
    let stage = |node: &Item| Some(node.as_table()?.get("stage")?.as_str()?.to_owned());
    let nodes = |layer: &Table| -> BTreeMap<String, String> {
        let nodes = layer.get("nodes").and_then(Item::as_table).into_iter().flatten();
        nodes.filter_map(|(name, node)| Some((name.clone(), stage(node)?))).collect()
    };
    let before = nodes(base);
    let is_other = |name: &String, stage: &String| before.get(name).is_some_and(|old| old != stage);
    nodes(over).into_iter().filter(|(name, stage)| is_other(name, stage)).map(|(name, _)| name).collect()
}

/// The table `nodes` of a layer or of a rule.
fn nodes_of(table: &mut Table) -> Option<&mut Table> {
    table.get_mut("nodes")?.as_table_mut()
}

/// Moves the rules out of a layer and records its axis values.
fn add_layer(layer: &mut Table, loaded: &mut Loaded, report: &mut Report) {
    match layer.shift_remove("set") {
        Some(Item { tree: Tree::Array(rules), .. }) => loaded.rules.extend(rules),
        Some(item) => report.add(&item.key_at, "set", "`set` must be an array of tables: [[set]]", None),
        None => (),
    }
    for (axis, item) in layer.get("axes").and_then(Item::as_table).into_iter().flatten() {
        if let Tree::Array(values) = &item.tree {
            loaded.axis_values.entry(axis.clone()).or_default().extend(values.iter().filter_map(Item::axis_text));
        } else if item.is_all_axis() {
            loaded.axes_of_all.insert(axis.clone());
        }
    }
}

fn read_override(text: usize, report: &mut Report) -> Option<Table> {
    let content = report.texts.get(text).text.clone();
    if toml::de::DeTable::parse(&content).is_err() {
        let hint = r#"write key.path=VALUE; strings need quotes, e.g. -s 'name="x"'"#.to_owned();
        report.add(&Place::new(text, 0..content.len()), "", "this override is not a TOML assignment", Some(hint));
        return None;
    }
    let table = tree::parse(text, report)?;
    let place = Place::new(text, 0..content.len());
    let unusable = table.keys().find(|key| ["extends", "set", "sweep"].contains(&key.as_str()));
    if let Some(key) = unusable {
        let hint = match key.as_str() {
            "sweep" => "a search has options of its own, e.g. --sweep, --trials and --limit of `pipeline run`",
            _ => "override the values themselves, or write a recipe that extends this one",
        };
        report.add(&place, key, format!("`{key}` cannot be overridden"), Some(hint.into()));
    } else if table.is_empty() {
        report.add(&place, "", "this override is empty", Some("write key.path=VALUE".into()));
    }
    Some(table)
}

/// Merges an override. Parameters of nodes are set apart, to be applied after all rules.
fn add_override(loaded: &mut Loaded, mut table: Table) {
    if let Some(nodes) = nodes_of(&mut table) {
        let mut params = Table::new();
        for (name, node) in nodes.iter_mut() {
            let Some(fields) = node.as_table_mut() else {
                continue;
            };
            if let Some(item) = fields.shift_remove("params") {
                let only_params = Table::from([("params".to_owned(), item)]);
                params.insert(name.clone(), Item { tree: Tree::Table(only_params), ..*node });
            }
        }
        nodes.retain(|_, node| node.as_table().is_none_or(|fields| !fields.is_empty()));
        loaded.overrides.extend((!params.is_empty()).then(|| rule(params)));
    }
    // The override's axis values need not enter `axis_values`: conditions accept the values of the merged axes as
    // well.
    lay_over(&mut loaded.root, table, &mut loaded.rules);
}

/// A rule without a condition: `{ nodes = … }`.
fn rule(nodes: Table) -> Item {
    let place = nodes[0].key_at;
    let nodes = Item { tree: Tree::Table(nodes), key_at: place, at: place };
    Item { tree: Tree::Table(Table::from([("nodes".to_owned(), nodes)])), key_at: place, at: place }
}
