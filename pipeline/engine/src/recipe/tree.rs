//! TOML as a tree in which every key and value has its place.

use indexmap::IndexMap;
use serde_json::Value;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::errors::Report;
use super::places::Place;

/// A table in the order of the file.
pub(super) type Table = IndexMap<String, Item>;

/// A value, its place and the place of its key.
#[derive(Clone, Debug)]
pub(super) struct Item {
    pub(super) tree: Tree,
    pub(super) key_at: Place,
    pub(super) at: Place,
}

#[derive(Clone, Debug)]
pub(super) enum Tree {
    /// A string, number or truth value.
    Leaf(Value),
    Array(Vec<Item>),
    Table(Table),
}

impl Item {
    pub(super) fn to_json(&self) -> Value {
        match &self.tree {
            Tree::Leaf(value) => value.clone(),
            Tree::Array(items) => items.iter().map(Self::to_json).collect(),
            Tree::Table(table) => table_to_json(table),
        }
    }

    pub(super) fn as_table(&self) -> Option<&Table> {
        if let Tree::Table(table) = &self.tree { Some(table) } else { None }
    }

    pub(super) fn as_table_mut(&mut self) -> Option<&mut Table> {
        if let Tree::Table(table) = &mut self.tree { Some(table) } else { None }
    }

    pub(super) fn as_str(&self) -> Option<&str> {
        if let Tree::Leaf(Value::String(text)) = &self.tree { Some(text) } else { None }
    }

    /// Whether the item is an axis of all values that a stage lists, or of all but some.
    pub(super) fn is_all_axis(&self) -> bool {
        self.as_str() == Some("all") || self.as_table().is_some()
    }

    /// The item as an axis value: strings and numbers have a text. Equal numbers have equal texts: 1.0 is `1`.
    pub(super) fn axis_text(&self) -> Option<String> {
        match &self.tree {
            Tree::Leaf(Value::String(text)) => Some(text.clone()),
            Tree::Leaf(Value::Number(number)) => number.as_i64().map(|int| int.to_string()).or_else(|| {
                // Adding 0 removes the sign of a negative zero.
                let float = number.as_f64()? + 0.0;
                let is_plain = float == 0.0 || (1e-5..1e15).contains(&float.abs());
                Some(if is_plain { format!("{float}") } else { format!("{float:e}") })
            }),
            _ => None,
        }
    }

    /// Calls `f` for this item, whose dotted key is `key`, and for all items below it.
    pub(super) fn visit(&mut self, key: &str, f: &mut impl FnMut(&str, &mut Item)) {
        f(key, self);
        match &mut self.tree {
            Tree::Leaf(_) => (),
            Tree::Array(items) => items.iter_mut().for_each(|item| item.visit(key, f)),
            Tree::Table(table) => table.iter_mut().for_each(|(name, item)| item.visit(&format!("{key}.{name}"), f)),
        }
    }
}

pub(super) fn table_to_json(table: &Table) -> Value {
    table.iter().map(|(key, item)| (key.clone(), item.to_json())).collect()
}

/// Lays `over` over `base`: tables merge, everything else is replaced.
pub(super) fn merge(base: &mut Table, over: Table) {
    for (key, item) in over {
        match (base.get_mut(&key).map(|item| &mut item.tree), item.tree) {
            (Some(Tree::Table(base)), Tree::Table(over)) => merge(base, over),
            (_, tree) => {
                base.insert(key, Item { tree, ..item });
            }
        }
    }
}

/// The deepest item on the dotted path `key`, and whether it is at the end of the path.
pub(super) fn find<'a>(table: &'a Table, key: &str) -> Option<(&'a Item, bool)> {
    let (first, rest) = key.split_once('.').unwrap_or((key, ""));
    let item = table.get(first)?;
    if rest.is_empty() {
        return Some((item, true));
    }
    item.as_table().and_then(|table| find(table, rest)).or(Some((item, false)))
}

/// Parses text number `text`. Reports the first syntax error, because others often follow from it, and returns no tree
/// if there is one.
pub(super) fn parse(text: usize, report: &mut Report) -> Option<Table> {
    let content = report.texts.get(text).text.clone();
    let (root, errors) = DeTable::parse_recoverable(&content);
    let Some(first) = errors.iter().min_by_key(|error| error.span().map_or(0, |span| span.start)) else {
        return Some(table(root.get_ref(), text, "", report));
    };
    let place = Place::new(text, first.span().unwrap_or(0..0));
    // The parser notices an open array at the next line that does not fit.
    let is_in_array = first.message().contains("array elements");
    let hint = is_in_array.then(|| "or close the array with `]` on a line above".to_owned());
    report.add(&place, "", first.message().replace('\n', ", "), hint);
    None
}

fn table(table: &DeTable, text: usize, prefix: &str, report: &mut Report) -> Table {
    let mut entries: Vec<_> = table.iter().collect();
    // The parser sorts by name; axes and nodes keep the order of the file.
    entries.sort_by_key(|(key, _)| key.span().start);
    let mut found = Table::new();
    for (key, value) in entries {
        let dotted = format!("{prefix}{}", key.get_ref());
        let key_at = Place::new(text, key.span());
        found.extend(item(value, key_at, &dotted, report).map(|item| (key.get_ref().to_string(), item)));
    }
    found
}

/// The item; none, with an error, if recipes cannot contain its value.
fn item(value: &Spanned<DeValue>, key_at: Place, dotted: &str, report: &mut Report) -> Option<Item> {
    let at = Place::new(key_at.text, value.span());
    let tree = match value.get_ref() {
        DeValue::Array(items) => {
            Tree::Array(items.iter().filter_map(|value| item(value, at, dotted, report)).collect())
        }
        DeValue::Table(inner) => Tree::Table(table(inner, at.text, &format!("{dotted}."), report)),
        leaf => {
            let value = leaf_value(leaf);
            Tree::Leaf(value.map_err(|problem| report.add(&at, dotted, problem, None)).ok()?)
        }
    };
    Some(Item { tree, key_at, at })
}

fn leaf_value(value: &DeValue) -> Result<Value, &'static str> {
    match value {
        DeValue::String(text) => Ok(Value::String(text.to_string())),
        DeValue::Boolean(value) => Ok(Value::Bool(*value)),
        DeValue::Integer(digits) => {
            i64::from_str_radix(digits.as_str(), digits.radix()).map(Value::from).map_err(|_| "integer out of range")
        }
        DeValue::Float(digits) => match digits.as_str().parse::<f64>().ok().and_then(serde_json::Number::from_f64) {
            Some(number) => Ok(Value::Number(number)),
            None => Err("numbers must be finite"),
        },
        DeValue::Datetime(_) => Err("dates are not used in recipes; write a string"),
        DeValue::Array(_) | DeValue::Table(_) => Err("not a single value"),
    }
}
