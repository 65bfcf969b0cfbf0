//! Hints for keys and recipes that do not exist: what the user may have meant.

use std::path::Path;

use serde_json::Value;

use super::tree::{Item, Table};
use crate::Registry;
use crate::library::{Library, builtin_name};
use crate::suggest::{names_hint, nearest};

/// Places that one hint lists; a parameter of many methods has more.
const MAX_PLACES: usize = 3;

/// The parameters of all nodes of a recipe, as (name, dotted key), e.g. `iterations` at
/// `nodes.train.params.iterations`. Nodes that are `like` another one have none of their own.
#[derive(Default)]
pub(super) struct KnownParams(Vec<(String, String)>);

impl KnownParams {
    /// The parameters that the stages of the merged recipe have.
    pub(super) fn of(root: &Table, registry: &Registry) -> Self {
        let mut known = Self::default();
        for (name, node) in root.get("nodes").and_then(Item::as_table).into_iter().flatten() {
            let Some(fields) = node.as_table().filter(|fields| !fields.contains_key("like")) else { continue };
            let stage = fields.get("stage").and_then(Item::as_str).and_then(|stage| registry.get(stage));
            stage.into_iter().for_each(|stage| known.add(&format!("nodes.{name}.params"), &stage.default_params()));
        }
        known
    }

    fn add(&mut self, place: &str, params: &Value) {
        for (name, value) in params.as_object().into_iter().flatten() {
            let place = format!("{place}.{name}");
            self.add(&place, value);
            self.0.push((name.clone(), place));
        }
    }

    /// The hint for the unknown key `prefix` + `key`: the places of a parameter of this name below `prefix`, otherwise
    /// the nearest of the `allowed` keys and of the parameters.
    pub(super) fn hint(&self, prefix: &str, key: &str, allowed: &[&str]) -> String {
        let wanted = if prefix.is_empty() { "nodes." } else { prefix };
        let below = || self.0.iter().filter(|(_, place)| place.starts_with(wanted));
        let places = |name: &str| -> Vec<String> {
            below().filter(|(own, _)| own == name).map(|(_, place)| place.clone()).collect()
        };
        let exact = places(key);
        if !exact.is_empty() {
            return suggestion(exact);
        }
        let parameters = below().map(|(name, _)| name.as_str());
        match nearest(key, allowed.iter().copied().chain(parameters)) {
            Some(name) if !allowed.contains(&name.as_str()) => suggestion(places(&name)),
            _ => names_hint(key, allowed.iter().copied()),
        }
    }

    /// The hint for the unknown key `key` of an option. If `key` is a node, the rest of the path is a field or a
    /// parameter of that node; otherwise, the path may be the end of a parameter's dotted key. `fields` are the keys
    /// of a node, and `allowed` the keys that options can change.
    pub(super) fn option_hint(
        &self,
        (key, item): (&str, &Item),
        root: &Table,
        fields: &[&str],
        allowed: &[&str],
    ) -> String {
        let path = path(key, item);
        let is_node = root.get("nodes").and_then(Item::as_table).is_some_and(|nodes| nodes.contains_key(key));
        let ends_so = |place: &&String| place.ends_with(&format!(".{path}"));
        let places: Vec<String> = match path.split_once('.').filter(|_| is_node) {
            Some((_, rest)) if fields.contains(&rest.split('.').next().unwrap_or(rest)) => {
                vec![format!("nodes.{path}")]
            }
            Some((_, rest)) => vec![format!("nodes.{key}.params.{rest}")],
            None => self.0.iter().map(|(_, place)| place).filter(ends_so).cloned().collect(),
        };
        match places.is_empty() {
            true => self.hint("", key, allowed),
            false => suggestion(places),
        }
    }
}

/// The question whether one of these places was meant. The least nested is the likeliest.
fn suggestion(mut places: Vec<String>) -> String {
    places.sort_by_key(|place| place.matches('.').count());
    let places: Vec<String> = places.iter().take(MAX_PLACES).map(|place| format!("`{place}`")).collect();
    format!("did you mean {}?", places.join(" or "))
}

/// The dotted path of the first value below a key of an option.
fn path(key: &str, item: &Item) -> String {
    match item.as_table().and_then(Table::first) {
        Some((inner, item)) => format!("{key}.{}", path(inner, item)),
        None => key.to_owned(),
    }
}

/// The hint for a recipe that does not exist: the nearest file of its folder, or the built-in recipe of its name.
pub(super) fn missing_recipe(path: &Path, library: Library) -> Option<String> {
    let builtin = |name: &str| nearest(name, library.names()).map(|name| format!("builtin:{name}"));
    if let Some(name) = builtin_name(path) {
        let all = || format!("built-in recipes: {}", library.names().collect::<Vec<_>>().join(", "));
        return Some(builtin(name).map_or_else(all, |name| format!("did you mean {name}?")));
    }
    let name = path.file_name()?.to_str()?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = std::fs::read_dir(folder.unwrap_or(Path::new("."))).into_iter().flatten().flatten();
    let files = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let recipes: Vec<String> = files.filter(|file| file.ends_with(".toml")).collect();
    // Without its ending, a name is compared with names without endings.
    let stem = name.strip_suffix(".toml").unwrap_or(name);
    let near = nearest(stem, recipes.iter().filter_map(|file| file.strip_suffix(".toml")));
    let file = near.map(|stem| folder.unwrap_or(Path::new("")).join(stem + ".toml").display().to_string());
    let name = file.or_else(|| builtin(stem))?;
    Some(format!("did you mean {name}?"))
}
