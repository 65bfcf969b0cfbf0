//! From what a recipe says to a list of effects, each with the reason for it.

use std::collections::{BTreeMap, BTreeSet};

use engine::{Decision, Facts, ParamProblem};

use super::evidence::{CAPTURE, Evidence, SUPPLEMENTS};
use super::{Effect, Effects, Need};

/// What is known of the artifacts on the ports, by port; a port that is not in here is not wired.
pub type KnownInputs<'a> = BTreeMap<&'a str, &'a Facts>;

/// The effects that a training simulates, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// The names of those that are on.
    pub on: BTreeSet<String>,
    /// One per effect of the method, in its order.
    pub decisions: Vec<Decision>,
    /// Optional ports that none of them needs.
    pub unread: BTreeSet<&'static str>,
}

impl Effects {
    /// Names that a method does not have, and lists that are neither names nor changes.
    pub fn problems(&self, effects: &[Effect]) -> Vec<ParamProblem> {
        let Self::Named(names) = self else { return Vec::new() };
        let known = effects.iter().map(|effect| effect.name).collect::<Vec<_>>().join(", ");
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
                    "" => "this method has no effects".into(),
                    known => format!("it has: {known}"),
                };
                problems.push(problem(format!("the method has no effect `{bare}`"), hint));
            }
            if name.starts_with('+') && names.contains(&format!("-{bare}")) {
                let hint = "remove one of the two".to_owned();
                problems.push(problem(format!("`{bare}` is both added and removed"), hint));
            }
        }
        problems
    }

    /// The effects to simulate, given what is known of the inputs. An effect that is asked for by name is simulated
    /// even where the scene does not call for it, but what it reads must be there: else it is a problem.
    pub fn choose(&self, effects: &[Effect], known: &KnownInputs<'_>) -> Result<Choice, Vec<ParamProblem>> {
        let (mut on, mut decisions, mut problems) = (BTreeSet::new(), Vec::new(), Vec::new());
        for effect in effects {
            let asked = self.asks_for(effect);
            match decide(effect, asked, known, &on) {
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

    /// Whether the recipe itself switches an effect on or off.
    fn asks_for(&self, effect: &Effect) -> Option<bool> {
        let Self::Named(names) = self else { return None };
        if names.iter().all(|name| change(name).is_none()) {
            return Some(names.contains(effect.name));
        }
        names.iter().filter(|name| bare(name) == effect.name).find_map(|name| change(name))
    }
}

/// `+x` switches on, `-x` off, `x` is a name.
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

/// Whether an effect is on, given what the recipe asks for, what is known, and the effects before it that are on.
fn decide(
    effect: &Effect,
    asked: Option<bool>,
    known: &KnownInputs<'_>,
    on: &BTreeSet<String>,
) -> Result<Decision, ParamProblem> {
    let decision = |on, reason| Decision { effect: effect.name.into(), on, reason };
    let evidence: Vec<Evidence> = effect.needs.iter().map(|need| evidence(*need, known, on)).collect();
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
            let hint = Some("give the node that input, or leave the effect to \"auto\"".into());
            Err(ParamProblem { key: "effects".into(), message, hint })
        }
        (Some(true), None, Some(idle)) => Ok(decision(true, format!("asked for, although {idle}"))),
        (Some(true), None, None) => Ok(decision(true, "asked for".into())),
        (None, Some(reason), _) | (None, None, Some(reason)) => Ok(decision(false, reason)),
        (None, None, None) if !effect.by_default => Ok(decision(false, "only where asked for".into())),
        (None, None, None) => Ok(decision(true, reasons(&evidence))),
    }
}

fn evidence(need: Need, known: &KnownInputs<'_>, on: &BTreeSet<String>) -> Evidence {
    match need {
        Need::Effect(name) if on.contains(name) => Evidence::Met(format!("{name} is on")),
        Need::Effect(name) => Evidence::Missing(format!("{name} is off")),
        need => need.evidence(|port| known.get(port).copied()),
    }
}

/// Why an effect whose needs are met is on.
fn reasons(evidence: &[Evidence]) -> String {
    let said = evidence.iter().map(|found| match found {
        Evidence::Met(reason) | Evidence::Unknown(reason) | Evidence::Idle(reason) | Evidence::Missing(reason) => {
            reason
        }
    });
    let said: Vec<&str> = said.map(String::as_str).collect();
    if said.is_empty() { "needs nothing".into() } else { said.join(", ") }
}

/// What a resolved list comes to once the data is there, in words that depend on the list and the data alone: equal
/// trainings write equal models, whoever chose their effects and why.
pub fn outcomes(on: &Effects, effects: &[Effect], known: &KnownInputs<'_>) -> Vec<Decision> {
    let names: BTreeSet<String> =
        effects.iter().filter(|effect| on.has(effect.name)).map(|effect| effect.name.to_owned()).collect();
    let outcome = |effect: &Effect| {
        let found: Vec<Evidence> = effect.needs.iter().map(|need| evidence(*need, known, &names)).collect();
        let is_on = names.contains(effect.name);
        let idle = found.iter().find_map(|found| match found {
            Evidence::Idle(reason) => Some(reason.clone()),
            _ => None,
        });
        let told: Vec<Evidence> = found.into_iter().filter(|found| matches!(found, Evidence::Met(_))).collect();
        let reason = match (is_on, idle) {
            (true, Some(reason)) => format!("asked for, although {reason}"),
            (true, None) if told.is_empty() => "simulated".into(),
            (true, None) => reasons(&told),
            (false, Some(reason)) => reason,
            (false, None) => "left out".into(),
        };
        Decision { effect: effect.name.into(), on: is_on, reason }
    };
    effects.iter().map(outcome).collect()
}

/// The facts of `context` by port, of ports with one producer that is known.
pub fn known_inputs<'a>(context: &'a engine::PlanContext<'_>) -> KnownInputs<'a> {
    let ports = [CAPTURE].into_iter().chain(SUPPLEMENTS);
    ports.filter_map(|port| Some((port, context.facts(port)?))).collect()
}
