//! Expands a template into jobs: one per combination of axis values, each with its parameters.

use serde_json::Value;

use super::errors::Report;
use super::raw::{AxisValue, Like, RawRecipe, Template};
use super::tree::{self, Item, Table, Tree};
use crate::Coordinates;
use crate::suggest::names_hint;

/// One job of a template.
pub(super) struct Instance {
    pub(super) name: String,
    /// Axis index and value, in axis order.
    pub(super) values: Vec<(usize, AxisValue)>,
    pub(super) coordinates: Coordinates,
    /// The parameters that the recipe gives for these values.
    pub(super) params: Table,
}

/// The maximum number of jobs. More are probably a typing error: a plan takes about 25 kB per job, and the largest
/// recipes have hundreds of jobs.
const MAX_JOBS: usize = 20_000;

/// Whether the recipe has too many jobs to expand, which is also reported.
pub(super) fn has_too_many_jobs(recipe: &RawRecipe, report: &mut Report) -> bool {
    let jobs_of = |template: &Template| {
        let counts = template.over.iter().map(|&axis| values_for(recipe, template, axis).count());
        counts.fold(1_usize, usize::saturating_mul)
    };
    let jobs = recipe.templates.values().map(jobs_of).fold(0, usize::saturating_add);
    let largest = recipe.templates.iter().max_by_key(|(_, template)| jobs_of(template));
    if let (true, Some((name, template))) = (jobs > MAX_JOBS, largest) {
        let lengths = template.over.iter().map(|&axis| {
            let count = values_for(recipe, template, axis).count();
            format!("{count} of axis `{}`", recipe.axis_name(axis))
        });
        let message = format!("the recipe has {jobs} jobs, of which {} of node `{name}`", jobs_of(template));
        let hint = format!(
            "at most {MAX_JOBS} can be planned; `{name}` has one job per combination: {}",
            lengths.collect::<Vec<_>>().join(" × ")
        );
        report.add(&template.at, format!("nodes.{name}.over"), message, Some(hint));
    }
    jobs > MAX_JOBS
}

/// The values of an axis for which a template has jobs.
fn values_for<'a>(recipe: &'a RawRecipe, template: &'a Template, axis: usize) -> impl Iterator<Item = &'a AxisValue> {
    let has_jobs = move |value: &&AxisValue| template.only.get(&axis).is_none_or(|only| only.contains(&value.text));
    recipe.axes[axis].values.iter().filter(has_jobs)
}

/// All jobs of the template called `name`; the last axis varies fastest.
pub(super) fn instances(recipe: &RawRecipe, name: &str, template: &Template, report: &mut Report) -> Vec<Instance> {
    let mut combinations = vec![Vec::new()];
    for &axis in &template.over {
        let longer = |head: &Vec<(usize, AxisValue)>| {
            let with = |value: &AxisValue| head.iter().cloned().chain([(axis, value.clone())]).collect();
            values_for(recipe, template, axis).map(with).collect::<Vec<_>>()
        };
        combinations = combinations.iter().flat_map(longer).collect();
    }
    combinations.into_iter().map(|values| instance(recipe, name, template, values, report)).collect()
}

fn instance(
    recipe: &RawRecipe,
    name: &str,
    template: &Template,
    values: Vec<(usize, AxisValue)>,
    report: &mut Report,
) -> Instance {
    let mut params = Table::new();
    if let Some(Like { node, values: fixed }) = &template.like
        && let Some((model, model_template)) = recipe.templates.get_key_value(&node.name)
    {
        let values: Vec<(usize, AxisValue)> = values.iter().chain(fixed).cloned().collect();
        params = params_of(recipe, model, model_template, &values, report);
    }
    tree::merge(&mut params, params_of(recipe, name, template, &values, report));
    let texts = values.iter().map(|(_, value)| value.text.as_str());
    Instance {
        name: [name].into_iter().chain(texts).collect::<Vec<_>>().join("/"),
        coordinates: values.iter().map(|(axis, value)| (recipe.axis_name(*axis).into(), value.text.clone())).collect(),
        params,
        values,
    }
}

/// A template's parameters for these axis values, with all rules whose conditions hold.
fn params_of(
    recipe: &RawRecipe,
    name: &str,
    template: &Template,
    values: &[(usize, AxisValue)],
    report: &mut Report,
) -> Table {
    let value_of = |axis: usize| values.iter().find(|(own, _)| *own == axis).map(|(_, value)| value);
    let mut params = template.params.clone();
    for rule in &recipe.rules {
        let holds = |(&axis, wanted): (&usize, &_)| value_of(axis).is_some_and(|value| contains(wanted, value));
        if rule.when.iter().all(holds) {
            let own = rule.params.iter().filter(|(template, _)| template == name);
            own.for_each(|(_, over)| tree::merge(&mut params, over.clone()));
        }
    }
    for (key, item) in &mut params {
        item.visit(&format!("nodes.{name}.params.{key}"), &mut |key, item| {
            substitute(item, key, recipe, &value_of, report);
        });
    }
    params
}

fn contains(wanted: &std::collections::BTreeSet<String>, value: &AxisValue) -> bool {
    wanted.contains(&value.text)
}

/// Substitutes `{axis}` in a string. A string that is one placeholder becomes the axis value with its type.
fn substitute<'a>(
    item: &mut Item,
    key: &str,
    recipe: &RawRecipe,
    value_of: &impl Fn(usize) -> Option<&'a AxisValue>,
    report: &mut Report,
) {
    let Some(text) = item.as_str() else { return };
    let parts = split(text);
    let mut filled: Vec<Value> = Vec::new();
    for part in &parts {
        let axis = match part {
            Part::Text(text) => {
                filled.push(Value::String((*text).into()));
                continue;
            }
            Part::Axis(axis) => *axis,
        };
        match recipe.axes.get_index_of(axis).map(value_of) {
            Some(Some(value)) => filled.push(value.value.clone()),
            Some(None) => {
                let message = format!("this node is not expanded over axis `{axis}`");
                report.add(&item.at, key, message, Some(format!("add \"{axis}\" to the node's `over`")));
            }
            None => {
                let names = names_hint(axis, recipe.axes.keys().map(String::as_str));
                let hint = Some(format!("{names}; for a literal brace write {{{{{axis}}}}}"));
                report.add(&item.at, key, format!("unknown axis `{axis}`"), hint);
            }
        }
    }
    if let [Part::Axis(_)] = parts[..] {
        let Some(value) = filled.pop() else { return };
        item.tree = Tree::Leaf(value);
    } else {
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        item.tree = Tree::Leaf(Value::String(filled.iter().map(text).collect()));
    }
}

/// The first axis whose value a string of the recipe takes.
pub(super) fn axis_in(text: &str) -> Option<&str> {
    split(text).into_iter().find_map(|part| if let Part::Axis(axis) = part { Some(axis) } else { None })
}

#[derive(Debug, PartialEq)]
enum Part<'a> {
    Text(&'a str),
    Axis(&'a str),
}

/// Splits at `{name}`. `{{name}}` is the text `{name}`; braces around anything else are text.
fn split(text: &str) -> Vec<Part<'_>> {
    let mut parts = Vec::new();
    let mut rest = text;
    while let Some((open, length)) = placeholder(rest) {
        let close = open + length + 1;
        let escaped = rest[..open].ends_with('{') && rest[close + 1..].starts_with('}');
        if escaped {
            parts.push(Part::Text(&rest[..open - 1]));
            parts.push(Part::Text(&rest[open..=close]));
            rest = &rest[close + 2..];
        } else {
            parts.push(Part::Text(&rest[..open]));
            parts.push(Part::Axis(&rest[open + 1..close]));
            rest = &rest[close + 1..];
        }
    }
    parts.push(Part::Text(rest));
    parts.retain(|part| *part != Part::Text(""));
    parts
}

/// The position of the first `{name}`, and the length of the name.
fn placeholder(text: &str) -> Option<(usize, usize)> {
    text.match_indices('{').find_map(|(open, _)| {
        let length = text[open + 1..].find('}')?;
        let name = &text[open + 1..open + 1 + length];
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        (!name.is_empty() && name.chars().all(plain)).then_some((open, length))
    })
}
