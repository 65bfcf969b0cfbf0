//! Axes whose values a stage lists: `method = "all"`, or `method = { except = ["vcgs"] }`.

use std::collections::BTreeSet;

use serde_json::Value;

use super::errors::Report;
use super::load::Loaded;
use super::tree::{Item, Table, Tree};
use crate::Registry;
use crate::suggest::names_hint;

/// Replaces every axis of this kind by the array of its values. Rules may name all of them, even where a layer of the
/// recipe narrows the axis.
pub(super) fn expand(loaded: &mut Loaded, registry: &Registry, report: &mut Report) {
    for axis in &loaded.axes_of_all {
        let values = values_of(axis, &loaded.root, registry).unwrap_or_default();
        loaded.axis_values.entry(axis.clone()).or_default().extend(values);
    }
    let axes = loaded.root.get("axes").and_then(Item::as_table).cloned().unwrap_or_default();
    for (axis, item) in &axes {
        let Some(except) = exceptions(axis, item, report) else { continue };
        let values = values_of(axis, &loaded.root, registry).unwrap_or_else(|| {
            let hint =
                format!("write them as an array: no stage lists the values of a parameter that is \"{{{axis}}}\"");
            report.add(&item.at, format!("axes.{axis}"), format!("unknown values of axis `{axis}`"), Some(hint));
            Vec::new()
        });
        if !values.is_empty() {
            refuse_unknown(axis, &except, &values, report);
        }
        let excluded: BTreeSet<&str> = except.iter().filter_map(Item::as_str).collect();
        let kept = values.into_iter().filter(|value| !excluded.contains(value.as_str()));
        let leaf = |value| Item { tree: Tree::Leaf(Value::String(value)), key_at: item.at, at: item.at };
        let array = Item { tree: Tree::Array(kept.map(leaf).collect()), ..*item };
        if let Some(Tree::Table(axes)) = loaded.root.get_mut("axes").map(|item| &mut item.tree) {
            axes.insert(axis.clone(), array);
        }
    }
}

/// The exceptions of an axis of all values; none for an axis of another kind.
fn exceptions(axis: &str, item: &Item, report: &mut Report) -> Option<Vec<Item>> {
    if !item.is_all_axis() {
        return None;
    }
    let Some(fields) = item.as_table() else { return Some(Vec::new()) };
    let key = format!("axes.{axis}");
    for (name, item) in fields.iter().filter(|(name, _)| *name != "except") {
        report.add(&item.key_at, &key, format!("unknown key `{name}`"), Some(names_hint(name, ["except"])));
    }
    match fields.get("except").map(|item| &item.tree) {
        Some(Tree::Array(items)) if items.iter().all(|item| item.as_str().is_some()) => Some(items.clone()),
        Some(_) => {
            report.add(&fields["except"].at, key, "`except` must be an array of strings", None);
            Some(Vec::new())
        }
        None => Some(Vec::new()),
    }
}

fn refuse_unknown(axis: &str, except: &[Item], values: &[String], report: &mut Report) {
    for item in except {
        let name = item.as_str().unwrap_or_default();
        if !values.iter().any(|value| value == name) {
            let hint = names_hint(name, values.iter().map(String::as_str));
            report.add(&item.at, format!("axes.{axis}"), format!("axis `{axis}` has no value `{name}`"), Some(hint));
        }
    }
}

/// The values that a stage lists for the first parameter that is `"{axis}"` in a node of the recipe.
fn values_of(axis: &str, root: &Table, registry: &Registry) -> Option<Vec<String>> {
    let placeholder = format!("{{{axis}}}");
    root.get("nodes")?.as_table()?.values().find_map(|node| {
        let fields = node.as_table()?;
        let stage = registry.get(fields.get("stage")?.as_str()?)?;
        let params = fields.get("params")?.as_table()?;
        leaves(params, "")
            .into_iter()
            .find_map(|(key, text)| if text == placeholder { stage.values(&key) } else { None })
    })
}

/// The strings of a table with their dotted keys.
fn leaves(table: &Table, prefix: &str) -> Vec<(String, String)> {
    let leaf = |(name, item): (&String, &Item)| match (&item.tree, item.as_str()) {
        (Tree::Table(inner), _) => leaves(inner, &format!("{prefix}{name}.")),
        (_, Some(text)) => vec![(format!("{prefix}{name}"), text.to_owned())],
        _ => Vec::new(),
    };
    table.iter().flat_map(leaf).collect()
}
