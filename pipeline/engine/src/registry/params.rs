//! From what a recipe says to what a stage's parameter type writes, with every problem on the way.

use std::collections::BTreeSet;

use serde_json::Value;
use serde_path_to_error::Segment;

use crate::recipe::nearest;
use crate::{ParamProblem, Stage};

/// Reads `raw` as the stage's parameters, checks them, and writes them back with defaults filled in.
pub(super) fn canonical<S: Stage>(raw: &Value) -> Result<Value, Vec<ParamProblem>> {
    let (params, mut problems) = deserialize_all::<S::Params>(raw.clone());
    let Some(params) = params else {
        return Err(problems);
    };
    // A check of a value that was repaired above may complain of what nobody wrote, but not of the same key twice.
    let reported: BTreeSet<String> = problems.iter().map(|problem| problem.key.clone()).collect();
    problems.extend(S::check_params(&params).into_iter().filter(|problem| !reported.contains(&problem.key)));
    if !problems.is_empty() {
        return Err(problems);
    }
    written_back(&params).map_err(|problem| vec![problem])
}

/// Writes the parameters and makes sure that they survive being read again: a NaN or an infinity would not.
pub(super) fn written_back<P: serde::Serialize + serde::de::DeserializeOwned>(
    params: &P,
) -> Result<Value, ParamProblem> {
    let lost = |error: serde_json::Error| problem("", format!("parameters do not survive being written: {error}"));
    let value = serde_json::to_value(params).map_err(lost)?;
    let again: P = serde_json::from_value(value.clone()).map_err(lost)?;
    match serde_json::to_value(&again).map_err(lost)? == value {
        true => Ok(value),
        false => Err(problem("", "parameters change when they are written and read again")),
    }
}

/// Reads the value, and after each error goes on without the part that caused it.
pub(super) fn deserialize_all<P: serde::de::DeserializeOwned>(mut raw: Value) -> (Option<P>, Vec<ParamProblem>) {
    let mut problems = Vec::new();
    loop {
        match serde_path_to_error::deserialize::<_, P>(&raw) {
            Ok(params) => return (Some(params), problems),
            Err(error) => {
                let message = error.inner().to_string();
                let told: Vec<String> = error.path().iter().filter_map(segment).collect();
                let (mut path, mut found) = explained(told.clone(), &message);
                // A type that deserialises by hand does not tell where.
                if told.is_empty() && (path.len() != 1 || at(&raw, &path).is_none()) {
                    path = culprit::<P>(&raw, &message);
                    found.key = path.join(".");
                }
                problems.push(found);
                if !remove(&mut raw, &path) {
                    return (None, problems);
                }
            }
        }
    }
}

fn segment(segment: &Segment) -> Option<String> {
    match segment {
        Segment::Seq { index } => Some(index.to_string()),
        Segment::Map { key } => Some(key.clone()),
        // A variant is no key of the file.
        Segment::Enum { .. } | Segment::Unknown => None,
    }
}

/// The path of the culprit and the problem in the user's terms: serde's words for an unknown key name all valid ones.
fn explained(mut path: Vec<String>, message: &str) -> (Vec<String>, ParamProblem) {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let what = ["field", "variant"].iter().position(|word| message.starts_with(&format!("unknown {word} `")));
    let (Some(what), Some((&wrong, allowed))) = (what, quoted.split_first()) else {
        return (path.clone(), problem(&path.join("."), in_words_of_recipes(message)));
    };
    // Depending on the kind of struct the path ends at the unknown key or at the table around it.
    if what == 0 && path.last().is_none_or(|last| last != wrong) {
        path.push(wrong.into());
    }
    let noun = ["key", "value"][what];
    let hint = match (nearest(wrong, allowed.iter().copied()), allowed.is_empty()) {
        (_, true) => "none is allowed here".into(),
        (Some(name), _) => format!("did you mean `{name}`? allowed: {}", allowed.join(", ")),
        (None, _) => format!("allowed: {}", allowed.join(", ")),
    };
    let key = path.join(".");
    (path, ParamProblem { key, message: format!("unknown {noun} `{wrong}`"), hint: Some(hint) })
}

/// Serde's words with the types as recipes have them, in place of Rust's.
fn in_words_of_recipes(message: &str) -> String {
    let Some((found, expected)) = message.split_once(", expected ") else { return message.to_owned() };
    let expected = match expected {
        "usize" | "u64" | "u32" | "u16" | "u8" => "a whole number from 0 on",
        "isize" | "i64" | "i32" | "i16" | "i8" => "a whole number",
        "f64" | "f32" => "a number",
        "a boolean" => "true or false",
        "a map" => "a table",
        "a sequence" => "an array",
        text if text.starts_with("struct ") => "a table",
        text => text,
    };
    let found = found.replace("map", "table").replace("sequence", "array").replace("unit value", "nothing");
    format!("{found}, expected {expected}")
}

/// The deepest value without which an error is no longer `message`; empty if no single one is to blame.
fn culprit<P: serde::de::DeserializeOwned>(raw: &Value, message: &str) -> Vec<String> {
    let is_cause = |path: &[String]| {
        let mut without = raw.clone();
        remove(&mut without, path);
        serde_json::from_value::<P>(without).err().is_none_or(|error| error.to_string() != message)
    };
    let mut path: Vec<String> = Vec::new();
    while let Some(Value::Object(map)) = at(raw, &path) {
        let child = |name: &String| [path.as_slice(), std::slice::from_ref(name)].concat();
        match map.keys().map(child).find(|path| is_cause(path)) {
            Some(deeper) => path = deeper,
            None => break,
        }
    }
    path
}

/// The value at `path`.
fn at<'a>(value: &'a Value, path: &[String]) -> Option<&'a Value> {
    path.iter().try_fold(value, |value, key| value.get(key))
}

/// Removes the value at `path`; an element of an array takes the array with it, since its neighbours would move.
fn remove(value: &mut Value, path: &[String]) -> bool {
    let Some((first, rest)) = path.split_first() else {
        return false;
    };
    let Value::Object(map) = value else {
        return false;
    };
    match map.get_mut(first) {
        None => false,
        Some(inner) if !rest.is_empty() && inner.is_object() => remove(inner, rest),
        Some(_) => map.remove(first).is_some(),
    }
}

pub(super) fn problem(key: &str, message: impl Into<String>) -> ParamProblem {
    ParamProblem { key: key.into(), message: message.into(), hint: None }
}
