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
    /// Stage → parameters from the command line for all of its jobs, applied last.
    pub(super) of_stages: Vec<(String, Table)>,
    /// Every value that any layer gives an axis: a recipe may narrow an axis and keep the rules of its base.
    pub(super) axis_values: BTreeMap<String, BTreeSet<String>>,
    /// The axes that any layer writes as all values that a stage lists.
    pub(super) axes_of_all: BTreeSet<String>,
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
    for StageOverride { stage, option, params } in &overrides.of_stages {
        let text = report.texts.add(Path::new(option), params.clone(), true);
        loaded.of_stages.extend(tree::parse(text, report).map(|table| (stage.clone(), table)));
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
        let bases = extends.as_ref().map(|item| extended(item, self.report)).unwrap_or_default();
        for item in bases {
            match self.read(&extended_path(path, item.as_str().unwrap_or_default()), Some(item)) {
                Some(mut base) => {
                    // A recipe does not inherit the name of its base.
                    base.shift_remove("name");
                    tree::merge(&mut merged, base);
                }
                None => is_whole = false,
            }
        }
        self.stack.pop();
        add_layer(&mut own, &mut self.loaded, self.report);
        tree::merge(&mut merged, own);
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
    let unusable = table.keys().find(|key| ["extends", "set"].contains(&key.as_str()));
    if let Some(key) = unusable {
        let hint = "override the values themselves, or write a recipe that extends this one";
        report.add(&place, key, format!("`{key}` cannot be overridden"), Some(hint.into()));
    } else if table.is_empty() {
        report.add(&place, "", "this override is empty", Some("write key.path=VALUE".into()));
    }
    Some(table)
}

/// Merges an override. Parameters of nodes are set apart, to be applied after all rules.
fn add_override(loaded: &mut Loaded, mut table: Table) {
    if let Some(Tree::Table(nodes)) = table.get_mut("nodes").map(|item| &mut item.tree) {
        let mut params = Table::new();
        for (name, node) in nodes.iter_mut() {
            let Tree::Table(fields) = &mut node.tree else {
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
    // Rules need not know the values that an override adds to an axis.
    tree::merge(&mut loaded.root, table);
}

/// A rule without a condition: `{ nodes = … }`.
fn rule(nodes: Table) -> Item {
    let place = nodes[0].key_at;
    let nodes = Item { tree: Tree::Table(nodes), key_at: place, at: place };
    Item { tree: Tree::Table(Table::from([("nodes".to_owned(), nodes)])), key_at: place, at: place }
}
