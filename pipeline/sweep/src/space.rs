//! The parameters of a search, and the values that they may take.

use std::fmt;
use std::str::FromStr;

/// A parameter with its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// The dotted key in the recipe, e.g. `nodes.train.params.schedule_scale`.
    pub key: String,
    domain: Domain,
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

impl Parameter {
    /// A parameter from its key and the text of its values: `0.1,0.2`, `log(1e-4, 1e-2)`, `uniform(0, 1)` or `int(1, 8)`.
    /// The error says what is wrong with the text.
    pub fn new(key: &str, values: &str) -> Result<Self, String> {
        let range = |name: &str| values.trim().strip_prefix(name)?.trim_start().strip_prefix('(')?.strip_suffix(')');
        let ends = |text: &str| -> Option<(f64, f64)> {
            let (low, high) = text.split_once(',')?;
            Some((low.trim().parse().ok()?, high.trim().parse().ok()?))
        };
        let wrong = |form: &str| format!("{key}: expected {form} with LOW < HIGH, not {values}");
        let domain = if let Some(text) = range("log") {
            let (low, high) =
                ends(text).filter(|(low, high)| 0.0 < *low && low < high).ok_or_else(|| wrong("log(LOW, HIGH)"))?;
            Domain::Log(low, high)
        } else if let Some(text) = range("uniform") {
            let (low, high) = ends(text).filter(|(low, high)| low < high).ok_or_else(|| wrong("uniform(LOW, HIGH)"))?;
            Domain::Uniform(low, high)
        } else if let Some(text) = range("int") {
            let (low, high) = ends(text).filter(|(low, high)| low < high).ok_or_else(|| wrong("int(LOW, HIGH)"))?;
            Domain::Whole(low as i64, high as i64)
        } else {
            let choices: Vec<String> = split(values).into_iter().filter(|choice| !choice.is_empty()).collect();
            if choices.is_empty() {
                return Err(format!("{key}: no values"));
            }
            Domain::Choices(choices.iter().map(|choice| quoted(choice)).collect())
        };
        if key.trim().is_empty() {
            return Err(format!("a parameter has no key: ={values}"));
        }
        Ok(Self { key: key.trim().into(), domain })
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
    /// The assignments of a point, e.g. `nodes.train.params.seed=1`.
    pub fn assignments(&self, point: &[f64]) -> Vec<String> {
        self.0.iter().zip(point).map(|(parameter, at)| format!("{}={}", parameter.key, parameter.at(*at))).collect()
    }

    /// The number of points of the grid over all values; `None` if some parameter is continuous.
    pub fn grid_size(&self) -> Option<usize> {
        self.0.iter().map(Parameter::count).try_fold(1usize, |product, count| product.checked_mul(count?))
    }

    /// The point of the grid with this number; the last parameter changes fastest.
    pub fn grid_point(&self, number: usize) -> Vec<f64> {
        let mut rest = number;
        let mut point: Vec<f64> = self
            .0
            .iter()
            .rev()
            .map(|parameter| {
                let count = parameter.count().unwrap_or(1).max(1);
                let index = rest % count;
                rest /= count;
                (index as f64 + 0.5) / count as f64
            })
            .collect();
        point.reverse();
        point
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.domain {
            Domain::Choices(choices) => write!(f, "{}={}", self.key, choices.join(",")),
            Domain::Uniform(low, high) => write!(f, "{}=uniform({low:?}, {high:?})", self.key),
            Domain::Log(low, high) => write!(f, "{}=log({low:?}, {high:?})", self.key),
            Domain::Whole(low, high) => write!(f, "{}=int({low}, {high})", self.key),
        }
    }
}

/// Splits at commas outside of brackets and quotes.
fn split(text: &str) -> Vec<String> {
    let (mut parts, mut depth, mut is_quoted) = (vec![String::new()], 0, false);
    for c in text.chars() {
        match c {
            '"' => is_quoted = !is_quoted,
            '[' | '{' if !is_quoted => depth += 1,
            ']' | '}' if !is_quoted => depth -= 1,
            ',' if depth == 0 && !is_quoted => {
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

/// A bare word becomes a string; numbers, booleans, strings, arrays and tables stay what they are.
fn quoted(choice: &str) -> String {
    let is_value = choice.parse::<f64>().is_ok()
        || ["true", "false"].contains(&choice)
        || choice.starts_with(['"', '[', '{', '\'']);
    if is_value { choice.to_owned() } else { format!("{choice:?}") }
}

/// Six digits: a search does not resolve more, and equal values give equal keys.
fn number(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    format!("{rounded:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_and_written_as_toml() {
        let parameter = |text: &str| text.parse::<Parameter>().unwrap();
        let choices = parameter("a.b=0.1, true,word,[1,2],\"x,y\"");
        assert_eq!(choices.count(), Some(5));
        let all: Vec<String> = (0..5).map(|at| choices.at((f64::from(at) + 0.5) / 5.0)).collect();
        assert_eq!(all, ["0.1", "true", "\"word\"", "[1,2]", "\"x,y\""]);
        let log = parameter("lr=log(1e-4, 1e-2)");
        assert_eq!((log.at(0.0).as_str(), log.at(0.5).as_str()), ("0.0001", "0.001"));
        let whole = parameter("n=int(1, 3)");
        assert_eq!([0.0, 0.34, 0.999, 1.0].map(|at| whole.at(at)), ["1", "2", "3", "3"]);
        assert_eq!(parameter("n=uniform(0, 1)").at(0.25), "0.25");
        for text in [choices.to_string(), log.to_string(), whole.to_string()] {
            assert_eq!(parameter(&text).to_string(), text);
        }
        for wrong in ["", "a", "=1", "a=", "a=log(0, 1)", "a=log(1)", "a=uniform(2, 1)", "a=int(x, 2)"] {
            assert!(wrong.parse::<Parameter>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_grid_has_each_combination_once() {
        let space = Space(vec!["a=1,2".parse().unwrap(), "b=int(1, 3)".parse().unwrap()]);
        assert_eq!(space.grid_size(), Some(6));
        let all: std::collections::BTreeSet<Vec<String>> =
            (0..6).map(|number| space.assignments(&space.grid_point(number))).collect();
        assert_eq!(all.len(), 6);
        assert_eq!(space.assignments(&space.grid_point(1)), ["a=1", "b=2"]);
        assert_eq!(Space(vec!["a=log(1, 2)".parse().unwrap()]).grid_size(), None);
    }
}
