//! Losses and effects that were inert in earlier runs of a recipe: by the gradients of its trainings, and by what leaving
//! them out changed in its last report.

use std::collections::BTreeMap;

use engine::history::History;
use engine::{Decision, Node};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use table_generation::{Column, Difference, Influence};
use training::{INERT_SHARE, PhaseInfluence, largest_share};

use crate::error::CliError;
use crate::output::count;
use crate::session::{Session, TRAINING};

/// What was inert in earlier runs of a recipe.
#[derive(Debug, Default)]
pub(crate) struct Inert {
    /// By the gradients of trainings.
    pub(crate) losses: Vec<InertLoss>,
    /// By leaving it out; without those that are inert by their gradients.
    pub(crate) left_out: Vec<InertPart>,
}

/// A loss whose gradient was negligible in all measured trainings of its method. Jobs without a result are ignored.
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
    /// Its largest gradient in any group of tensors, relative to that of the photometric loss.
    pub(crate) largest_share: f64,
    /// Measured trainings.
    pub(crate) trainings: usize,
}

/// A loss or an effect of a method that changed nothing when it was left out, in every row of the last report.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct InertPart {
    /// The method.
    pub(crate) method: String,
    /// The loss or the effect.
    pub(crate) part: String,
    /// Whether it is a loss.
    pub(crate) is_loss: bool,
    /// The reason why it is kept anyway.
    pub(crate) stays: Option<String>,
    /// The PSNR without it minus that with it, dB, in the row with the widest interval.
    pub(crate) psnr: Difference,
    /// Its share of the time of the training in that row, if known.
    pub(crate) secs_share: Option<f64>,
}

/// The part of `report.json` that holds the influence of losses and effects.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Reported {
    groups: Vec<ReportedGroup>,
}

/// The rows of one protocol.
#[derive(Default, Deserialize)]
#[serde(default)]
struct ReportedGroup {
    rows: Vec<ReportedRow>,
}

/// One row: a method with the values of further axes.
#[derive(Default, Deserialize)]
#[serde(default)]
struct ReportedRow {
    method: String,
    influence: Vec<Influence>,
}

/// The measurements of a training that hold the influence of its losses.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Influences {
    influence: BTreeMap<String, PhaseInfluence>,
}

/// What was inert, of the trainings among the nodes with these indices. What the plan leaves out is omitted.
pub(crate) fn inert(session: &Session, nodes: impl Iterator<Item = usize>) -> Result<Inert, CliError> {
    let trainings: Vec<&Node> =
        nodes.map(|index| &session.plan.nodes[index]).filter(|node| node.stage == TRAINING).collect();
    if trainings.is_empty() {
        return Ok(Inert::default());
    }
    let history = History::read(&session.store, &session.plan)?;
    let losses = inert_losses(session, &history, &trainings);
    let is_planned = |method: &str, part: &Influence| {
        trainings.iter().any(|node| method_of(node) == method && has_part(&node.params, &node.decisions, part))
    };
    let mut left_out = inert_parts(&reported_rows(session, &history), is_planned);
    left_out.retain(|part| !losses.iter().any(|loss| (&loss.method, &loss.loss) == (&part.method, &part.part)));
    Ok(Inert { losses, left_out })
}

/// The rows of the last reports of the recipe. Reports of other versions of the program may have another format.
fn reported_rows(session: &Session, history: &History) -> Vec<ReportedRow> {
    let read = |index: usize| {
        let record = history.earlier(&session.plan.nodes[index])?;
        serde_json::from_slice(&session.store.read_file(&record.content, "report.json").ok()?).ok()
    };
    let reports = session.reports().into_iter().filter_map(read);
    reports.flat_map(|report: Reported| report.groups).flat_map(|group| group.rows).collect()
}

/// The parts that a training of the plan has, by method and part, and that changed nothing in every row of their method
/// that measured them.
fn inert_parts(rows: &[ReportedRow], is_planned: impl Fn(&str, &Influence) -> bool) -> Vec<InertPart> {
    let mut measured: BTreeMap<(&str, &str), Vec<&Influence>> = BTreeMap::new();
    for row in rows {
        let of_row = row.influence.iter().filter(|part| !part.left_out.is_empty());
        of_row.for_each(|part| measured.entry((row.method.as_str(), part.part.as_str())).or_default().push(part));
    }
    let inert = |((method, part), found): (&(&str, &str), &Vec<&Influence>)| {
        if !is_planned(method, found[0]) || !found.iter().all(|one| one.changes_nothing()) {
            return None;
        }
        let widths = found.iter().filter_map(|one| Some((*one, one.left_out.get(&Column::PSNR)?)));
        let (widest, psnr) = widths.max_by(|(_, a), (_, b)| {
            let width = |difference: &Difference| difference.half_width.unwrap_or(0.0);
            width(a).total_cmp(&width(b))
        })?;
        Some(InertPart {
            method: (*method).into(),
            part: (*part).into(),
            is_loss: widest.is_loss,
            stays: widest.stays.clone(),
            psnr: *psnr,
            secs_share: widest.secs_share,
        })
    };
    measured.iter().filter_map(inert).collect()
}

/// The method of a training.
fn method_of(node: &Node) -> &str {
    node.params.get("method").and_then(Value::as_str).unwrap_or_default()
}

/// Whether a training with these parameters and decisions has a part.
fn has_part(params: &Value, decisions: &[Decision], part: &Influence) -> bool {
    let is_off = |name: &str| decisions.iter().any(|decision| decision.effect == name && !decision.on);
    let is_left_out = params.get("without").and_then(Value::as_str) == Some(part.part.as_str());
    !is_left_out && !is_off(&part.part) && !part.effect.as_deref().is_some_and(is_off)
}

/// The losses that were inert in an earlier result of each training.
fn inert_losses(session: &Session, history: &History, trainings: &[&Node]) -> Vec<InertLoss> {
    let mut found: BTreeMap<(&str, String), InertLoss> = BTreeMap::new();
    for node in trainings {
        let Some(record) = history.earlier(node) else { continue };
        // Unreadable measurements are skipped: the prediction of the job reports the damage.
        let Ok(measured) = session.store.read_measurements(&record.measurements) else { continue };
        // Records of other versions of the program may lack the measurement or have it in another format.
        let Influences { influence } = Influences::deserialize(measured).unwrap_or_default();
        add(&mut found, method_of(node), &node.decisions, &influence);
    }
    found.into_values().filter(|loss| loss.largest_share < INERT_SHARE).collect()
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

/// One line per inert loss or effect, with the next step.
pub(crate) fn render(inert: &Inert) -> String {
    inert.losses.iter().map(loss_line).chain(inert.left_out.iter().map(part_line)).collect()
}

fn part_line(inert: &InertPart) -> String {
    let InertPart { method, part, is_loss, stays, psnr, secs_share } = inert;
    let next = match stays {
        Some(reason) => format!("it is kept: {reason}"),
        None if *is_loss => "a weight of 0 leaves it out".into(),
        None => format!("`effects = [\"-{part}\"]` leaves it out"),
    };
    let kind = if *is_loss { "loss" } else { "effect" };
    let time = secs_share.map(|share| format!(", and it takes {:.1} % of the time", 100.0 * share)).unwrap_or_default();
    format!(
        "warning: the {kind} {part} of {method} changed nothing when it was left out, by the last report of this recipe: \
         {:+.2} ± {:.2} dB ({}){time}; {next}\n",
        psnr.mean,
        psnr.half_width.unwrap_or(0.0),
        count(psnr.seeds, "seed"),
    )
}

fn loss_line(loss: &InertLoss) -> String {
    let InertLoss { method, loss, effect, stays, largest_share, trainings } = loss;
    let next = match stays {
        Some(reason) => format!("it is kept: {reason}"),
        None => "measure what leaving it out changes with an axis `without`".into(),
    };
    let of = effect.as_ref().map(|effect| format!(" (effect {effect})")).unwrap_or_default();
    let share = if *largest_share == 0.0 { "0".into() } else { format!("{largest_share:.0e}") };
    format!(
        "warning: the loss {loss}{of} of {method} was inert in {} of this recipe: its gradient was at most \
         {share} of the photometric one; {next}\n",
        count(*trainings, "earlier training"),
    )
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
        let inert = Inert { losses: after([1e-9, 2e-9], true), left_out: Vec::new() };
        insta::assert_snapshot!(render(&inert), @r"
        warning: the loss flow (effect flow) of phys4dgs was inert in 2 earlier trainings of this recipe: its gradient was at most 2e-9 of the photometric one; measure what leaving it out changes with an axis `without`
        ");
        let zero = render(&Inert { losses: after([0.0; 2], true), left_out: Vec::new() });
        assert!(zero.contains("its gradient was at most 0 of the photometric one"), "{zero}");
        assert_eq!(after([1e-9, 0.5], true), [], "it moves something in one of them");
        assert_eq!(after([1e-9, 1e-9], false), [], "the plan leaves it out already");
    }

    /// A row of `mcgs` in which leaving out `attention` changed the PSNR by `mean`, and one that did not measure it.
    fn rows(mean: f64, stays: Option<&str>) -> Vec<ReportedRow> {
        let part = |left_out: Value| {
            json!({ "part": "attention", "effect": null, "stays": stays, "is_loss": false, "shares": {}, "samples": 0,
                    "left_out": left_out, "secs": 33.0, "secs_share": 0.33, "is_inert": true })
        };
        let measured = part(json!({ "psnr": { "mean": mean, "half_width": 0.16, "seeds": 3 } }));
        let row = |part: Value| json!({ "method": "mcgs", "influence": [part] });
        let report = json!({ "title": "t", "groups": [{ "rows": [row(measured), row(part(json!({})))] }] });
        let Reported { groups } = Reported::deserialize(report).expect("the form of the report");
        groups.into_iter().flat_map(|group| group.rows).collect()
    }

    /// The parts that are inert by these rows, for a plan that simulates `attention` or not.
    fn parts(rows: &[ReportedRow], on: bool) -> Vec<InertPart> {
        let params = json!({ "without": "nothing" });
        let decisions = [Decision { effect: "attention".into(), on, reason: String::new() }];
        inert_parts(rows, |method, part| method == "mcgs" && has_part(&params, &decisions, part))
    }

    #[test]
    fn an_effect_that_changed_nothing_when_left_out_is_named() {
        let warned =
            |stays: Option<&str>| render(&Inert { losses: Vec::new(), left_out: parts(&rows(0.01, stays), true) });
        insta::assert_snapshot!(warned(None), @r#"
        warning: the effect attention of mcgs changed nothing when it was left out, by the last report of this recipe: +0.01 ± 0.16 dB (3 seeds), and it takes 33.0 % of the time; `effects = ["-attention"]` leaves it out
        "#);
        assert!(warned(Some("equation 14")).ends_with("; it is kept: equation 14\n"));
        assert_eq!(parts(&rows(-0.5, None), true), [], "leaving it out costs half a decibel");
        assert_eq!(parts(&rows(0.01, None), false), [], "the plan leaves it out already");
    }
}
