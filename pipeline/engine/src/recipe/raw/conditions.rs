//! Conditions on axis values: `only` and `only_with` of a node, and `when` of a rule.

use std::collections::{BTreeMap, BTreeSet};

use indexmap::IndexMap;

use super::{Axis, table_at};
use crate::recipe::errors::Report;
use crate::recipe::tree::{Item, Table, Tree};
use crate::suggest::names_hint;

/// Axis index → the values for which the condition holds.
pub(in crate::recipe) type Conditions = BTreeMap<usize, BTreeSet<String>>;

/// The axes of a recipe, and all values that any layer gives them.
#[derive(Clone, Copy)]
pub(super) struct Axes<'a> {
    /// The axes with the values of the merged recipe.
    pub(super) here: &'a IndexMap<String, Axis>,
    /// Axis → the values of all layers.
    pub(super) anywhere: &'a BTreeMap<String, BTreeSet<String>>,
}

/// The condition `only` of a node: the values for which it has jobs, on axes that it is expanded over.
pub(super) fn only(fields: &Table, key: &str, over: &[usize], axes: Axes<'_>, report: &mut Report) -> Conditions {
    let key = format!("{key}.only");
    let only = conditions(fields, "only", &key, axes, report);
    if let Some((axis, _)) = only.keys().filter(|axis| !over.contains(axis)).find_map(|axis| axes.here.get_index(*axis))
    {
        let message = format!("the node is not expanded over axis `{axis}`");
        report.add(&fields["only"].key_at, key, message, Some("add it to the node's `over`".into()));
    }
    only
}

/// The condition in the table `name`. Values that no layer gives the axis are errors.
pub(super) fn conditions(fields: &Table, name: &str, dotted: &str, axes: Axes<'_>, report: &mut Report) -> Conditions {
    let mut conditions = Conditions::new();
    for (axis, item) in table_at(fields, name, dotted, report) {
        let key = format!("{dotted}.{axis}");
        let Some((index, _, values)) = axes.here.get_full(axis) else {
            let hint = names_hint(axis, axes.here.keys().map(String::as_str));
            report.add(&item.key_at, key, format!("unknown axis `{axis}`"), Some(hint));
            continue;
        };
        let mut allowed: BTreeSet<&str> = values.values.iter().map(|value| value.text.as_str()).collect();
        allowed.extend(axes.anywhere.get(axis).into_iter().flatten().map(String::as_str));
        let wanted = if let Tree::Array(items) = &item.tree { items.as_slice() } else { std::slice::from_ref(item) };
        let is_empty = wanted.is_empty() && !report.concerns(&key);
        if is_empty || wanted.iter().any(|item| item.axis_text().is_none()) {
            let hint = names_hint("", allowed.iter().copied());
            report.add(&item.at, &key, "a condition is one value of the axis, or an array of at least one", Some(hint));
        }
        for (item, text) in wanted.iter().filter_map(|item| Some((item, item.axis_text()?))) {
            if !allowed.contains(text.as_str()) {
                let hint = names_hint(&text, allowed.iter().copied());
                report.add(&item.at, &key, format!("axis `{axis}` has no value `{text}`"), Some(hint));
            }
        }
        conditions.insert(index, wanted.iter().filter_map(Item::axis_text).collect());
    }
    conditions
}
