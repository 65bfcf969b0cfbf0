//! The parameters of a search, and the values that they may take.

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use crate::condition::{Condition, bare};

/// A parameter with its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The dotted key in the recipe, e.g. `nodes.train.params.schedule_scale`.
    pub key: String,
    domain: Domain,
    when: Option<Condition>,
}

#[derive(Clone, Debug, PartialEq)]
enum Domain {
    /// These values, as TOML.
    Choices(Vec<String>),
    Uniform(f64, f64),
    Log(f64, f64),
    Whole(i64, i64),
}

/// All parameters of a search. A point has one coordinate in [0, 1) per parameter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Space(pub Vec<Parameter>);

/// The values of an axis of the recipe.
#[derive(Clone, Debug, Default)]
pub struct AxisValues {
    /// The values that the recipe has jobs for.
    pub chosen: BTreeSet<String>,
    /// The values that a condition may name: also those that an override of the recipe leaves out.
    pub known: BTreeSet<String>,
}

/// Why a condition cannot be decided.
#[derive(Clone, Debug, PartialEq)]
pub struct ConditionError {
    /// The problem, with the parameter and the condition.
    pub message: String,
    /// A value that the condition names and nothing has, and the values that it may name.
    pub unknown: Option<(String, Vec<String>)>,
}

impl Parameter {
    /// A parameter from its key and the text of its values: `0.1,0.2`, `log(1e-4, 1e-2)`, `uniform(0, 1)` or `int(1, 8)`,
    /// each also with one condition: `1,2 when method=scgs|mcgs`. The error says what is wrong with the text.
    pub fn new(key: &str, values: &str) -> Result<Self, String> {
        let (values, when) = match values.rsplit_once(" when ") {
            Some((values, _)) if values.contains(" when ") => {
                return Err(format!("{key}: more than one condition: {values}"));
            }
            Some((values, condition)) => (values.trim(), Some(condition.parse()?)),
            None => (values, None),
        };
        let range = |name: &str| values.trim().strip_prefix(name)?.trim_start().strip_prefix('(')?.strip_suffix(')');
        let ends =
            |text: &str| ends::<f64>(text).filter(|(low, high)| low < high && low.is_finite() && high.is_finite());
        let wrong = |form: &str| format!("{key}: expected {form} with LOW < HIGH, not {values}");
        let domain = if let Some(text) = range("log") {
            let (low, high) = ends(text).filter(|(low, _)| 0.0 < *low).ok_or_else(|| wrong("log(LOW, HIGH)"))?;
            Domain::Log(low, high)
        } else if let Some(text) = range("uniform") {
            let (low, high) = ends(text).ok_or_else(|| wrong("uniform(LOW, HIGH)"))?;
            Domain::Uniform(low, high)
        } else if let Some(text) = range("int") {
            let whole = self::ends::<i64>(text).filter(|(low, high)| low < high);
            let (low, high) = whole.ok_or_else(|| wrong("int(LOW, HIGH) of whole numbers"))?;
            if high.checked_sub(low).and_then(|width| width.checked_add(1)).is_none() {
                return Err(format!("{key}: {values} has more than 2^63 - 1 numbers"));
            }
            Domain::Whole(low, high)
        } else {
            let choices: Vec<String> = split(values).into_iter().filter(|choice| !choice.is_empty()).collect();
            if choices.is_empty() {
                return Err(format!("{key}: no values"));
            }
            let choices: Vec<String> = choices.iter().map(|choice| quoted(choice)).collect();
            if let Some(twice) = repeated(&choices) {
                return Err(format!("{key}: the value {twice} occurs twice"));
            }
            Domain::Choices(choices)
        };
        if key.trim().is_empty() {
            return Err(format!("a parameter has no key: ={values}"));
        }
        Ok(Self { key: key.trim().into(), domain, when })
    }

    /// The value at a coordinate in [0, 1), as TOML.
    pub fn at(&self, coordinate: f64) -> String {
        let u = coordinate.clamp(0.0, 1.0 - f64::EPSILON);
        match &self.domain {
            Domain::Choices(choices) => choices[(u * choices.len() as f64) as usize].clone(),
            Domain::Uniform(low, high) => number(low + u * (high - low)),
            Domain::Log(low, high) => number((low.ln() + u * (high / low).ln()).exp()),
            Domain::Whole(low, high) => (low + (u * (high - low + 1) as f64) as i64).to_string(),
        }
    }

    /// The coordinates of all listed values, or of both ends of a range.
    fn probes(&self) -> Vec<f64> {
        match &self.domain {
            Domain::Choices(choices) => (0..choices.len()).map(|index| middle(index, choices.len())).collect(),
            Domain::Uniform(..) | Domain::Log(..) | Domain::Whole(..) => vec![0.0, 1.0],
        }
    }

    /// The index of the value at a coordinate, where there are at most `most` values.
    pub(crate) fn index_at(&self, coordinate: f64, most: usize) -> Option<usize> {
        let count = self.count().filter(|count| *count <= most)?;
        Some(((coordinate * count as f64) as usize).min(count - 1))
    }

    /// The number of values, if there are only a few.
    pub fn count(&self) -> Option<usize> {
        match &self.domain {
            Domain::Choices(choices) => Some(choices.len()),
            Domain::Whole(low, high) => usize::try_from(high - low + 1).ok(),
            Domain::Uniform(..) | Domain::Log(..) => None,
        }
    }
}

impl FromStr for Parameter {
    type Err = String;

    /// Parses `KEY=VALUES`.
    fn from_str(text: &str) -> Result<Self, String> {
        let (key, values) = text.split_once('=').ok_or_else(|| format!("expected KEY=VALUES, not {text}"))?;
        Self::new(key, values)
    }
}

impl Space {
    /// Decides the conditions about axes that are not searched; `axis` returns the values of an axis of the recipe. The error
    /// names a condition that nothing decides, or that names a value that nothing has.
    pub fn settled(self, axis: impl Fn(&str) -> Option<AxisValues>) -> Result<Self, ConditionError> {
        let mut settled = Vec::new();
        for mut parameter in self.0.clone() {
            let Some(condition) = &parameter.when else {
                settled.push(parameter);
                continue;
            };
            let wrong = |reason: &str, unknown| {
                let message = format!("{}: when {}: {reason}", parameter.key, condition.name);
                Err(ConditionError { message, unknown })
            };
            let other = self.0.iter().find(|other| condition.is_about(&other.key));
            let axis = axis(&condition.name);
            if other.is_some_and(|other| other.when.is_some()) {
                return wrong("this parameter has a condition itself", None);
            }
            if other.is_none() && axis.is_none() {
                return wrong("neither a parameter of the search nor an axis of the recipe", None);
            }
            let AxisValues { chosen, mut known } = axis.unwrap_or_default();
            let has = |value: &&String| known.contains(*value) || other.is_some_and(|other| other.domain.has(value));
            if let Some(value) = condition.values.iter().find(|value| !has(value)).cloned() {
                known.extend(other.into_iter().flat_map(|other| other.domain.names()));
                let reason = format!("there is no value `{value}`");
                return wrong(&reason, Some((value, known.into_iter().collect())));
            }
            match chosen.iter().filter(|value| condition.allows(value)).count() {
                _ if other.is_some() => settled.push(parameter),
                0 => {}
                count if count == chosen.len() => {
                    parameter.when = None;
                    settled.push(parameter);
                }
                _ => return wrong("the recipe has several values: choose one with -s, or search over the axis", None),
            }
        }
        Ok(Self(settled))
    }

    /// Which parameters are set at a point: those whose condition holds.
    pub fn active(&self, point: &[f64]) -> Vec<bool> {
        let value = |condition: &Condition| {
            let at = self.0.iter().position(|other| condition.is_about(&other.key))?;
            Some(self.0[at].at(*point.get(at)?))
        };
        let holds = |condition: &Condition| value(condition).is_some_and(|value| condition.allows(&value));
        self.0.iter().map(|parameter| parameter.when.as_ref().is_none_or(holds)).collect()
    }

    /// The assignments of a point, e.g. `nodes.train.params.seed=1`.
    pub fn assignments(&self, point: &[f64]) -> Vec<String> {
        let set = self.0.iter().zip(point).zip(self.active(point)).filter(|(_, is_active)| *is_active);
        set.map(|((parameter, at), _)| format!("{}={}", parameter.key, parameter.at(*at))).collect()
    }

    /// The number of different points of the grid over all values; `None` if some parameter is continuous.
    pub fn grid_size(&self) -> Option<usize> {
        let product = self.product()?;
        let has_conditions = self.0.iter().any(|parameter| parameter.when.is_some());
        Some(if has_conditions { self.grid_numbers(product).count() } else { product })
    }

    /// The point of the grid with this number, which must be below [`Self::grid_size`]; the last parameter changes fastest.
    pub fn grid_point(&self, number: usize) -> Vec<f64> {
        let own = self.product().and_then(|product| self.grid_numbers(product).nth(number));
        self.product_point(own.unwrap_or(number))
    }

    /// Groups of points that differ only in the parameter `at`: one point per listed value, or both ends of its
    /// range. Over all groups, every other parameter also takes each of its listed values or both ends, unless `at`
    /// is then not set.
    pub fn contrasts(&self, at: usize) -> impl Iterator<Item = Vec<Vec<f64>>> + '_ {
        let ends = [0.0, 1.0].map(|end| vec![end; self.0.len()]);
        let others = (0..self.0.len()).filter(move |other| *other != at);
        let first = ends[0].clone();
        let around = others.flat_map(move |other| self.variations(&first, other));
        ends.into_iter().chain(around).map(move |around| self.variations(&around, at))
    }

    /// Points around another one that differ only in the parameter `at`. If it is not set there, the parameter that it
    /// depends on has another value.
    fn variations(&self, around: &[f64], at: usize) -> Vec<Vec<f64>> {
        let mut base = around.to_vec();
        if let Some(condition) = self.0[at].when.as_ref().filter(|_| !self.active(around)[at])
            && let Some(other) = self.0.iter().position(|other| condition.is_about(&other.key))
        {
            let count = self.0[other].count().unwrap_or(0);
            let mut coordinates = (0..count).map(|index| middle(index, count));
            let allowed = coordinates.find(|coordinate| condition.allows(&self.0[other].at(*coordinate)));
            base[other] = allowed.unwrap_or(base[other]);
        }
        let varied = |coordinate| {
            let mut point = base.clone();
            point[at] = coordinate;
            point
        };
        self.0[at].probes().into_iter().map(varied).collect()
    }

    fn product(&self) -> Option<usize> {
        self.0.iter().map(Parameter::count).try_fold(1usize, |product, count| product.checked_mul(count?))
    }

    /// The combinations of all values without repetitions: a parameter that is not set has its first value.
    fn grid_numbers(&self, product: usize) -> impl Iterator<Item = usize> + '_ {
        (0..product).filter(|number| {
            let point = self.product_point(*number);
            let is_first = |at: usize| point[at] * self.0[at].count().unwrap_or(1) as f64 <= 0.5;
            self.active(&point).into_iter().enumerate().all(|(at, is_active)| is_active || is_first(at))
        })
    }

    fn product_point(&self, number: usize) -> Vec<f64> {
        let mut rest = number;
        let mut point: Vec<f64> = self
            .0
            .iter()
            .rev()
            .map(|parameter| {
                let count = parameter.count().unwrap_or(1).max(1);
                let index = rest % count;
                rest /= count;
                middle(index, count)
            })
            .collect();
        point.reverse();
        point
    }
}

impl Domain {
    /// Whether a point can have this value, which a condition names. The values of a range are not listed.
    fn has(&self, value: &str) -> bool {
        match self {
            Self::Choices(choices) => choices.iter().any(|choice| bare(choice) == value),
            Self::Whole(low, high) => value.parse().is_ok_and(|value: i64| (*low..=*high).contains(&value)),
            Self::Uniform(..) | Self::Log(..) => false,
        }
    }

    /// The values as a condition names them; a range as one text.
    fn names(&self) -> Vec<String> {
        match self {
            Self::Choices(choices) => choices.iter().map(|choice| bare(choice)).collect(),
            range => vec![range.to_string()],
        }
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let values = &self.domain;
        write!(f, "{}={values}", self.key)?;
        match &self.when {
            Some(condition) => write!(f, " when {}={}", condition.name, condition.values.join("|")),
            None => Ok(()),
        }
    }
}

impl fmt::Display for Domain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Choices(choices) => write!(f, "{}", choices.join(",")),
            Self::Uniform(low, high) => write!(f, "uniform({low:?}, {high:?})"),
            Self::Log(low, high) => write!(f, "log({low:?}, {high:?})"),
            Self::Whole(low, high) => write!(f, "int({low}, {high})"),
        }
    }
}

/// The coordinate in the middle of those that give the value with this index.
fn middle(index: usize, count: usize) -> f64 {
    (index as f64 + 0.5) / count as f64
}

/// The ends of a range: `LOW, HIGH`.
fn ends<T: FromStr>(text: &str) -> Option<(T, T)> {
    let (low, high) = text.split_once(',')?;
    Some((low.trim().parse().ok()?, high.trim().parse().ok()?))
}

/// A value that occurs twice; `0.1` and `0.10` are equal.
fn repeated(choices: &[String]) -> Option<&String> {
    let is_equal = |a: &str, b: &str| a == b || a.parse::<f64>().is_ok_and(|value| b.parse() == Ok(value));
    choices
        .iter()
        .enumerate()
        .find(|(at, choice)| choices[..*at].iter().any(|old| is_equal(old, choice)))
        .map(|it| it.1)
}

/// Splits at commas outside brackets and quotes.
fn split(text: &str) -> Vec<String> {
    let (mut parts, mut depth, mut quote) = (vec![String::new()], 0, None);
    for c in text.chars() {
        match (c, quote) {
            ('"' | '\'', None) => quote = Some(c),
            (_, Some(open)) if c == open => quote = None,
            ('[' | '{', None) => depth += 1,
            (']' | '}', None) => depth -= 1,
            (',', None) if depth == 0 => {
                parts.push(String::new());
                continue;
            }
            _ => (),
        }
        if let Some(last) = parts.last_mut() {
            last.push(c);
        }
    }
    parts.iter().map(|part| part.trim().to_owned()).collect()
}

/// TOML is kept, a number of another form (`.1`, `1.`) is written as TOML, and anything else becomes a string.
fn quoted(choice: &str) -> String {
    let is_toml = format!("value = {choice}").parse::<toml::Table>().is_ok_and(|table| table.len() == 1);
    match choice.parse::<f64>() {
        _ if is_toml => choice.to_owned(),
        Ok(value) => format!("{value:?}"),
        Err(_) => format!("{choice:?}"),
    }
}

/// Six digits are enough for a search, and equal values give equal keys.
fn number(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    format!("{rounded:?}")
}

#[cfg(test)]
#[path = "space_tests.rs"]
mod tests;
