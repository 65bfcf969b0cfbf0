//! Finds the bounds of a numeric key by probing the stage's checks.

use serde_json::{Value, json};

use super::Listing;

/// Beyond this magnitude a key counts as unbounded.
const HUGE: f64 = 1e18;

/// Values to start from where the default is unset.
const TYPICAL: [f64; 4] = [1.0, 0.5, 10.0, 100.0];

/// The bounds of a key, e.g. `> 0` or `≥ 1, ≤ 3`; empty where the stage accepts all numbers.
pub(super) fn of(listing: &Listing<'_>, key: &str, default: &Value, is_integer: bool) -> String {
    let accepts = |value: f64| {
        let value = if is_integer { json!(value as i64) } else { json!(value) };
        listing.accepts(key, value)
    };
    let start = default.as_f64().into_iter().chain(TYPICAL).find(|value| accepts(*value));
    let Some(start) = start else { return String::new() };
    let lower = if is_integer && accepts(0.0) { None } else { bound(&accepts, start, -HUGE, is_integer) };
    let upper = bound(&accepts, start, HUGE, is_integer);
    let lower = lower.map(|(value, included)| format!("{} {}", if included { "≥" } else { ">" }, text(value)));
    let upper = upper.map(|(value, included)| format!("{} {}", if included { "≤" } else { "<" }, text(value)));
    lower.into_iter().chain(upper).collect::<Vec<_>>().join(", ")
}

/// The last accepted value from `inside` towards `outside`, and whether it is accepted itself; none if all are.
fn bound(accepts: &impl Fn(f64) -> bool, inside: f64, outside: f64, is_integer: bool) -> Option<(f64, bool)> {
    if accepts(outside) {
        return None;
    }
    let (mut inside, mut outside) = (inside, outside);
    // Zero and powers of ten first, so that the bisection below starts between neighbours in magnitude.
    for probe in probes(inside, outside) {
        if accepts(probe) { inside = probe } else { outside = probe }
    }
    for _ in 0..100 {
        let middle = if is_integer { ((inside + outside) / 2.0).trunc() } else { (inside + outside) / 2.0 };
        if middle == inside || middle == outside {
            break;
        }
        if accepts(middle) { inside = middle } else { outside = middle }
    }
    if is_integer {
        return Some((inside, true));
    }
    let limit = rounded(inside);
    Some((limit, accepts(limit)))
}

/// Probes from the inside to the outside, each kept only while it lies between the two.
fn probes(inside: f64, outside: f64) -> Vec<f64> {
    let powers = (-12..18).map(|power| 10.0_f64.powi(power));
    let all = powers.clone().map(|power| -power).chain([0.0]).chain(powers);
    let (low, high) = (inside.min(outside), inside.max(outside));
    let mut between: Vec<f64> = all.filter(|value| (low..high).contains(value) && *value != inside).collect();
    between.sort_by(|a, b| (a - inside).abs().total_cmp(&(b - inside).abs()));
    between
}

/// Six significant digits; 0 for what is closer to 0 than any sensible bound.
fn rounded(value: f64) -> f64 {
    if value.abs() < 1e-11 { 0.0 } else { format!("{value:.5e}").parse().expect("a number") }
}

fn text(value: f64) -> String {
    let plain = value.to_string();
    if plain.len() <= 9 { plain } else { format!("{value:e}") }
}
