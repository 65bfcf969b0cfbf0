//! Losses that were inert in earlier runs of a recipe.

use std::collections::BTreeMap;

use engine::history::History;
use engine::{Decision, Node};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use training::{INERT_SHARE, PhaseInfluence, largest_share};

use crate::error::CliError;
use crate::output::count;
use crate::session::{Session, TRAINING};

/// A loss whose gradient was negligible in an earlier training of every job that has it.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct InertLoss {
    /// The method.
    pub(crate) method: String,
    /// The loss.
    pub(crate) loss: String,
    /// The effect that it belongs to.
    pub(crate) effect: Option<String>,
    /// The reason why it is kept anyway.
    pub(crate) stays: Option<String>,
    /// The largest share of its gradient in any group of tensors, relative to the photometric loss.
    pub(crate) largest_share: f64,
    /// Measured trainings.
    pub(crate) trainings: usize,
}

/// The measurements of a training that hold the influence of its losses.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Influences {
    influence: BTreeMap<String, PhaseInfluence>,
}

/// The inert losses of the trainings among the nodes with these indices, from an earlier result of each. A loss whose
/// effect the plan leaves out is omitted.
pub(crate) fn inert_losses(session: &Session, nodes: impl Iterator<Item = usize>) -> Result<Vec<InertLoss>, CliError> {
    let trainings: Vec<&Node> =
        nodes.map(|index| &session.plan.nodes[index]).filter(|node| node.stage == TRAINING).collect();
    if trainings.is_empty() {
        return Ok(Vec::new());
    }
    let history = History::read(&session.store, &session.plan)?;
    let mut found: BTreeMap<(&str, String), InertLoss> = BTreeMap::new();
    for node in trainings {
        let Some(record) = history.earlier(node) else { continue };
        // The prediction names damage.
        let Ok(measured) = session.store.read_measurements(&record.measurements) else { continue };
        // Records of other versions of the program may lack the measurement or have it in another format.
        let Influences { influence } = Influences::deserialize(measured).unwrap_or_default();
        let method = node.params.get("method").and_then(Value::as_str).unwrap_or_default();
        add(&mut found, method, &node.decisions, &influence);
    }
    Ok(found.into_values().filter(|loss| loss.largest_share < INERT_SHARE).collect())
}

/// Adds the losses of one measured training of a method, except those whose effects are off by these decisions.
fn add<'n>(
    found: &mut BTreeMap<(&'n str, String), InertLoss>,
    method: &'n str,
    decisions: &[Decision],
    influence: &BTreeMap<String, PhaseInfluence>,
) {
    let is_off = |effect: &str| decisions.iter().any(|decision| decision.effect == effect && !decision.on);
    for (name, loss) in influence.values().flat_map(|phase| &phase.losses) {
        let (Some(share), false) = (largest_share(influence, name), loss.effect.as_deref().is_some_and(is_off)) else {
            continue;
        };
        let known = found.entry((method, name.clone())).or_insert_with(|| InertLoss {
            method: method.into(),
            loss: name.clone(),
            effect: loss.effect.clone(),
            stays: loss.stays.clone(),
            largest_share: 0.0,
            trainings: 0,
        });
        known.largest_share = known.largest_share.max(share);
        // A loss that acts in several phases counts once, in the first of them.
        let first = influence.values().find(|phase| phase.losses.contains_key(name));
        known.trainings += usize::from(first.is_some_and(|phase| std::ptr::eq(&phase.losses[name], loss)));
    }
}

/// One line per inert loss, with the next step.
pub(crate) fn render(losses: &[InertLoss]) -> String {
    let line = |loss: &InertLoss| {
        let InertLoss { method, loss, effect, stays, largest_share, trainings } = loss;
        let next = match stays {
            Some(reason) => format!("it is kept: {reason}"),
            None => "measure what leaving it out changes with an axis `without`".into(),
        };
        let of = effect.as_ref().map(|effect| format!(" (effect {effect})")).unwrap_or_default();
        format!(
            "warning: the loss {loss}{of} of {method} was inert in {} of this recipe: its gradient was at most \
             {largest_share:.0e} of the photometric one; {next}\n",
            count(*trainings, "earlier training"),
        )
    };
    losses.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Measurements in which `flow` has `norm` times the gradient of the photometric loss.
    fn measured(norm: f64) -> BTreeMap<String, PhaseInfluence> {
        let loss = |effect: Option<&str>, norm: f64| json!({ "effect": effect, "acted": 8, "iterations": [2, 6], "norms": { "positions": [norm, norm] } });
        let losses = json!({ "photometric": loss(None, 1.0), "flow": loss(Some("flow"), norm) });
        let influence = json!({ "influence": { "fine": { "steps": 8, "losses": losses } } });
        Influences::deserialize(influence).expect("the form of the measurement").influence
    }

    /// The losses after trainings with these norms, where the plan simulates `flow` or not.
    fn after(norms: [f64; 2], on: bool) -> Vec<InertLoss> {
        let decisions = [Decision { effect: "flow".into(), on, reason: String::new() }];
        let mut found = BTreeMap::new();
        norms.into_iter().for_each(|norm| add(&mut found, "phys4dgs", &decisions, &measured(norm)));
        found.into_values().filter(|loss| loss.largest_share < INERT_SHARE).collect()
    }

    #[test]
    fn a_loss_that_moved_nothing_in_any_training_is_named() {
        insta::assert_snapshot!(render(&after([1e-9, 2e-9], true)), @r"
        warning: the loss flow (effect flow) of phys4dgs was inert in 2 earlier trainings of this recipe: its gradient was at most 2e-9 of the photometric one; measure what leaving it out changes with an axis `without`
        ");
        assert_eq!(after([1e-9, 0.5], true), [], "it moves something in one of them");
        assert_eq!(after([1e-9, 1e-9], false), [], "the plan leaves it out already");
    }
}
