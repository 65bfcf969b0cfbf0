//! The choice of effects, with a reason for each.

use std::collections::{BTreeMap, BTreeSet};

use engine::{Decision, Facts, ParamProblem};

use super::evidence::{CAPTURE, Evidence, SUPPLEMENTS};
use super::{Effect, Effects, Need};

/// Static facts of the artifacts by port; missing ports are not wired.
pub(crate) type KnownInputs<'a> = BTreeMap<&'a str, &'a Facts>;

/// The effects that a training simulates, with reasons.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Choice {
    /// Names of the effects that are on.
    pub on: BTreeSet<String>,
    /// One decision per effect of the method, in its order.
    pub decisions: Vec<Decision>,
    /// Optional ports that no active effect reads.
    pub unread: BTreeSet<&'static str>,
}

impl Effects {
    /// Problems of the list for a method with these effects: unknown names, and lists that mix names with changes.
    pub(crate) fn problems(&self, method: &str, effects: &[Effect]) -> Vec<ParamProblem> {
        let Self::Named(names) = self else { return Vec::new() };
        let described = |effect: &Effect| format!("{} ({})", effect.name, effect.about);
        let known = effects.iter().map(described).collect::<Vec<_>>().join(", ");
        let problem = |message: String, hint: String| ParamProblem { key: "effects".into(), message, hint: Some(hint) };
        let mut problems = Vec::new();
        let changes = names.iter().filter(|name| change(name).is_some()).count();
        if changes > 0 && changes < names.len() {
            let hint = "write names, or begin every entry with + or - to change the automatic choice";
            problems.push(problem("a list of names cannot also change the automatic choice".into(), hint.into()));
        }
        for name in names {
            let bare = bare(name);
            if !effects.iter().any(|effect| effect.name == bare) {
                let hint = match known.as_str() {
                    "" => format!("{method} has no effects"),
                    known => format!("it has: {known}"),
                };
                problems.push(problem(format!("{method} has no effect `{bare}`"), hint));
            }
            if name.starts_with('+') && names.contains(&format!("-{bare}")) {
                let hint = "remove one of the two".to_owned();
                problems.push(problem(format!("`{bare}` is both added and removed"), hint));
            }
        }
        problems
    }

    /// The effects to simulate, given the facts of the inputs. An effect that the recipe names is simulated even if the
    /// scene does not justify it; a missing input is then a problem.
    pub(crate) fn choose(&self, effects: &[Effect], known: &KnownInputs<'_>) -> Result<Choice, Vec<ParamProblem>> {
        let (mut on, mut decisions, mut problems) = (BTreeSet::new(), Vec::new(), Vec::new());
        for effect in effects {
            let asked = self.asks_for(effect);
            match decide(effect, asked, known, &on, effects) {
                Ok(decision) => {
                    on.extend(decision.on.then(|| effect.name.to_owned()));
                    decisions.push(decision);
                }
                Err(problem) => problems.push(problem),
            }
        }
        let is_on = |effect: &&Effect| on.contains(effect.name);
        let needed: BTreeSet<&str> =
            effects.iter().filter(is_on).flat_map(|effect| effect.needs).filter_map(|need| need.port()).collect();
        let unread = SUPPLEMENTS.into_iter().filter(|port| !needed.contains(port)).collect();
        if problems.is_empty() { Ok(Choice { on, decisions, unread }) } else { Err(problems) }
    }

    /// Whether the recipe explicitly enables or disables an effect; `None` if it does neither.
    fn asks_for(&self, effect: &Effect) -> Option<bool> {
        let Self::Named(names) = self else { return None };
        if names.iter().all(|name| change(name).is_none()) {
            return Some(names.contains(effect.name));
        }
        names.iter().filter(|name| bare(name) == effect.name).find_map(|name| change(name))
    }
}

/// `+x` enables, `-x` disables; `None` for a plain name.
fn change(name: &str) -> Option<bool> {
    match name.as_bytes().first() {
        Some(b'+') => Some(true),
        Some(b'-') => Some(false),
        _ => None,
    }
}

fn bare(name: &str) -> &str {
    if change(name).is_some() { &name[1..] } else { name }
}

/// Decides one effect, given the recipe's choice, the facts, and the preceding effects that are on.
fn decide(
    effect: &Effect,
    asked: Option<bool>,
    known: &KnownInputs<'_>,
    on: &BTreeSet<String>,
    effects: &[Effect],
) -> Result<Decision, ParamProblem> {
    let decision = |on, reason| Decision { effect: effect.name.into(), on, reason };
    let evidence = all_evidence(effect, known, on, effects);
    let missing = evidence.iter().find_map(|found| match found {
        Evidence::Missing(reason) => Some(reason.clone()),
        _ => None,
    });
    let idle = evidence.iter().find_map(|found| match found {
        Evidence::Idle(reason) => Some(reason.clone()),
        _ => None,
    });
    match (asked, missing, idle) {
        (Some(false), ..) => Ok(decision(false, "left out by the recipe".into())),
        (Some(true), Some(missing), _) => {
            let message = format!("the effect `{}` cannot be simulated: {missing}", effect.name);
            let hint = Some("give the node what the effect needs, or leave the effect to \"auto\"".into());
            Err(ParamProblem { key: "effects".into(), message, hint })
        }
        (Some(true), None, Some(idle)) => Ok(decision(true, format!("requested, although {idle}"))),
        (Some(true), None, None) => Ok(decision(true, "requested".into())),
        (None, Some(reason), _) | (None, None, Some(reason)) => Ok(decision(false, reason)),
        (None, None, None) if !effect.by_default => Ok(decision(false, "off unless named in the recipe".into())),
        (None, None, None) => Ok(decision(true, reasons(&evidence))),
    }
}

/// The evidence for the needs that decide about an effect.
fn all_evidence(effect: &Effect, known: &KnownInputs<'_>, on: &BTreeSet<String>, effects: &[Effect]) -> Vec<Evidence> {
    let needs = effect.needs.iter().filter(|need| need.decides());
    needs.map(|need| evidence(*need, known, on, effects)).collect()
}

fn evidence(need: Need, known: &KnownInputs<'_>, on: &BTreeSet<String>, effects: &[Effect]) -> Evidence {
    match need {
        Need::Effect(name) if on.contains(name) => Evidence::Met(format!("{name} is on")),
        Need::Effect(name) => Evidence::Missing(format!("{name} is off")),
        Need::NoMaps => {
            let reads_maps =
                |effect: &&Effect| on.contains(effect.name) && effect.needs.iter().any(|need| need.reads_maps());
            match effects.iter().find(reads_maps) {
                Some(reader) => Evidence::Missing(format!("`{}` compares maps of the images' full size", reader.name)),
                None => Evidence::Met("renders are compared with images only".into()),
            }
        }
        need => need.evidence(|port| known.get(port).copied()),
    }
}

/// The reasons for an effect whose needs are met.
fn reasons(evidence: &[Evidence]) -> String {
    let reasons = evidence.iter().map(|found| match found {
        Evidence::Met(reason) | Evidence::Unknown(reason) | Evidence::Idle(reason) | Evidence::Missing(reason) => {
            reason
        }
    });
    let reasons: Vec<&str> = reasons.map(String::as_str).collect();
    if reasons.is_empty() { "needs nothing".into() } else { reasons.join(", ") }
}

/// The outcome of a resolved list for the loaded data. The reasons depend only on the list and the data, so equal
/// trainings write equal models, no matter how their effects were chosen.
pub(crate) fn outcomes(on: &Effects, effects: &[Effect], known: &KnownInputs<'_>) -> Vec<Decision> {
    let names: BTreeSet<String> =
        effects.iter().filter(|effect| on.has(effect.name)).map(|effect| effect.name.to_owned()).collect();
    let outcome = |effect: &Effect| {
        let found = all_evidence(effect, known, &names, effects);
        let is_on = names.contains(effect.name);
        let idle = found.iter().find_map(|found| match found {
            Evidence::Idle(reason) => Some(reason.clone()),
            _ => None,
        });
        let met: Vec<Evidence> = found.into_iter().filter(|found| matches!(found, Evidence::Met(_))).collect();
        let reason = match (is_on, idle) {
            (true, Some(reason)) => format!("requested, although {reason}"),
            (true, None) if met.is_empty() => "simulated".into(),
            (true, None) => reasons(&met),
            (false, Some(reason)) => reason,
            (false, None) => "left out".into(),
        };
        Decision { effect: effect.name.into(), on: is_on, reason }
    };
    effects.iter().map(outcome).collect()
}

/// The facts of `context` by port, for ports with a single known producer.
pub(crate) fn known_inputs<'a>(context: &'a engine::PlanContext<'_>) -> KnownInputs<'a> {
    let ports = [CAPTURE].into_iter().chain(SUPPLEMENTS);
    ports.filter_map(|port| Some((port, context.facts(port)?))).collect()
}
