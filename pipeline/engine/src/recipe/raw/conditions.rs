//! For which values of the axes something holds.

use std::collections::{BTreeMap, BTreeSet};

use indexmap::IndexMap;

use super::{Axis, axis_text, table_at};
use crate::recipe::errors::{Report, names_hint};
use crate::recipe::tree::{Table, Tree};

/// Axis index → the values that are meant.
pub(crate) type Conditions = BTreeMap<usize, BTreeSet<String>>;

/// The axes of a recipe, and every value that any layer of it gives them.
#[derive(Clone, Copy)]
pub(super) struct Axes<'a> {
    pub here: &'a IndexMap<String, Axis>,
    pub anywhere: &'a BTreeMap<String, BTreeSet<String>>,
}

/// The values for which a node has jobs, on axes that it is expanded over.
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

/// The values per axis in the table `name`, which must be values that the axes can have.
pub(super) fn conditions(fields: &Table, name: &str, dotted: &str, axes: Axes<'_>, report: &mut Report) -> Conditions {
    let mut conditions = Conditions::new();
    for (axis, item) in table_at(fields, name, dotted, report) {
        let key = format!("{dotted}.{axis}");
        let Some((index, _, values)) = axes.here.get_full(axis) else {
            let hint = names_hint(axis, axes.here.keys().map(String::as_str));
            report.add(&item.key_at, key, format!("unknown axis `{axis}`"), hint);
            continue;
        };
        let mut allowed: BTreeSet<&str> = values.values.iter().map(|value| value.text.as_str()).collect();
        allowed.extend(axes.anywhere.get(axis).into_iter().flatten().map(String::as_str));
        let wanted = if let Tree::Array(items) = &item.tree { items.as_slice() } else { std::slice::from_ref(item) };
        for item in wanted {
            let text = axis_text(item).unwrap_or_default();
            if !allowed.contains(text.as_str()) {
                let hint = names_hint(&text, allowed.iter().copied());
                report.add(&item.at, &key, format!("axis `{axis}` has no value `{text}`"), hint);
            }
        }
        conditions.insert(index, wanted.iter().filter_map(axis_text).collect());
    }
    conditions
}
