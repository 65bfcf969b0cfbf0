//! Canonical parameters: a recipe's values, read as the stage's type and written back, with all problems on the way.

use std::collections::BTreeSet;

use serde_json::Value;
use serde_path_to_error::Segment;

use crate::suggest::names_hint;
use crate::{ParamProblem, Stage};

/// Reads `raw` as the stage's parameters, checks them, and writes them back with all defaults.
pub(super) fn canonical<S: Stage>(raw: &Value) -> Result<Value, Vec<ParamProblem>> {
    let (params, mut problems) = deserialize_all::<S::Params>(raw.clone());
    let Some(params) = params else {
        return Err(problems);
    };
    // `deserialize_all` replaced bad values by defaults. Skip problems of `check_params` with keys that are already
    // reported.
    let reported: BTreeSet<String> = problems.iter().map(|problem| problem.key.clone()).collect();
    problems.extend(S::check_params(&params).into_iter().filter(|problem| !reported.contains(&problem.key)));
    if !problems.is_empty() {
        return Err(problems);
    }
    written_back(&params).map_err(|problem| vec![problem])
}

/// Writes the parameters, and checks that reading them again gives equal parameters: NaN and infinity would not.
pub(super) fn written_back<P: serde::Serialize + serde::de::DeserializeOwned>(
    params: &P,
) -> Result<Value, ParamProblem> {
    let lost =
        |error: serde_json::Error| problem("", format!("the parameters cannot be written and read back: {error}"));
    let value = serde_json::to_value(params).map_err(lost)?;
    let again: P = P::deserialize(&value).map_err(lost)?;
    match serde_json::to_value(&again).map_err(lost)? == value {
        true => Ok(value),
        false => Err(problem("", "the parameters change when they are written and read back")),
    }
}

/// Reads the value. After each error it continues without the part that caused the error.
pub(super) fn deserialize_all<P: serde::de::DeserializeOwned>(mut raw: Value) -> (Option<P>, Vec<ParamProblem>) {
    let mut problems = Vec::new();
    loop {
        match serde_path_to_error::deserialize::<_, P>(&raw) {
            Ok(params) => return (Some(params), problems),
            Err(error) => {
                let message = error.inner().to_string();
                let reported: Vec<String> = error.path().iter().filter_map(segment).collect();
                let (mut path, mut found) = explained(reported.clone(), &message);
                // A hand-written `Deserialize` loses the path.
                if reported.is_empty() && (path.len() != 1 || at(&raw, &path).is_none()) {
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
        // A variant is not a key of the file.
        Segment::Enum { .. } | Segment::Unknown => None,
    }
}

/// The path of the cause, and the problem in terms of recipes. Serde's message for an unknown key lists all valid ones.
fn explained(mut path: Vec<String>, message: &str) -> (Vec<String>, ParamProblem) {
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let what = ["field", "variant"].iter().position(|word| message.starts_with(&format!("unknown {word} `")));
    let (Some(what), Some((&wrong, allowed))) = (what, quoted.split_first()) else {
        return (path.clone(), problem(&path.join("."), in_recipe_terms(message)));
    };
    // Depending on the kind of struct, the path ends at the unknown key or at the table around it.
    if what == 0 && path.last().is_none_or(|last| last != wrong) {
        path.push(wrong.into());
    }
    let noun = ["key", "value"][what];
    let hint = names_hint(wrong, allowed.iter().copied());
    let key = path.join(".");
    (path, ParamProblem { key, message: format!("unknown {noun} `{wrong}`"), hint: Some(hint) })
}

/// Serde's message with the types of recipes instead of Rust's.
fn in_recipe_terms(message: &str) -> String {
    let Some((found, expected)) = message.split_once(", expected ") else { return message.to_owned() };
    // A stage may add which of its tables it was.
    let (expected, table) = expected.split_at(expected.find(" in the table ").unwrap_or(expected.len()));
    let expected = match expected {
        "usize" | "u64" | "u32" | "u16" | "u8" => "a non-negative whole number",
        "isize" | "i64" | "i32" | "i16" | "i8" => "a whole number",
        "f64" | "f32" => "a number",
        "a boolean" => "true or false",
        "a map" => "a table",
        "a sequence" => "an array",
        text if text.starts_with("struct ") => "a table",
        text => text,
    };
    let found = found.replace("map", "table").replace("sequence", "array").replace("unit value", "nothing");
    format!("{found}, expected {expected}{table}")
}

/// The path of the deepest value whose removal changes the error `message`; empty if no single value causes it.
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

/// Removes the value at `path`. For an element of an array it removes the array, since the other elements would move.
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
