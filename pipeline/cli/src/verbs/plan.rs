//! `plan`: which jobs a run would execute, and why.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use engine::Plan;
use engine::estimate::Estimate;
use engine::explain::{Change, RootCause, root_causes};
use engine::status::Prediction;
use serde_json::json;

use crate::args::PlanArgs;
use crate::error::CliError;
use crate::output::{count, duration, note, print, print_json};
use crate::session::{Session, describe};
use crate::verbs::search::note_search;
use crate::verbs::{decisions, inert};

pub(crate) fn plan(store: &Path, args: &PlanArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.recipe)?.select(&args.selection)?;
    note_search(&args.recipe.recipe)?;
    if args.threads.is_some() {
        note("--threads does not change a plan: times are predicted from measured jobs, whatever threads those had");
    }
    let predictions = session.predict()?;
    let causes = causes(&session.plan, &predictions);
    let inert = inert::inert(&session, predictions.keys().copied())?;
    if args.json {
        let name = |index: &usize| &session.plan.nodes[*index].name;
        let jobs: BTreeMap<&String, &Prediction> =
            predictions.iter().map(|(index, prediction)| (name(index), prediction)).collect();
        let causes: Vec<_> = causes
            .iter()
            .map(|cause| {
                let nodes: Vec<&String> = cause.nodes.iter().map(name).collect();
                json!({ "nodes": nodes, "changes": cause.changes, "consequences": cause.consequences })
            })
            .collect();
        let effects: BTreeMap<&String, _> = predictions
            .keys()
            .map(|&index| (name(&index), &session.plan.nodes[index].decisions))
            .filter(|(_, decisions)| !decisions.is_empty())
            .collect();
        let plan = &session.plan;
        print_json(&json!({
            "recipe": plan.recipe, "jobs": jobs, "causes": causes, "effects": effects, "left_out": plan.left_out,
            "inert": inert.losses, "inert_when_left_out": inert.left_out,
        }))?;
        return Ok(engine::exit::OK);
    }
    let mut text = String::new();
    for (&index, prediction) in &predictions {
        text += &line(&session.plan.nodes[index].name, prediction);
    }
    text += &totals(&predictions);
    text += &args.within.map(|within| fitting(&session.plan, &predictions, within)).unwrap_or_default();
    text += &render_causes(&session.plan, &causes);
    text += &decisions::render(&session.plan, predictions.keys().copied());
    text += &inert::render(&inert);
    print(&text)?;
    Ok(engine::exit::OK)
}

/// The root causes of all jobs that would run.
pub(crate) fn causes(plan: &Plan, predictions: &BTreeMap<usize, Prediction>) -> Vec<RootCause> {
    let changes: BTreeMap<usize, Vec<Change>> =
        predictions.iter().map(|(&index, prediction)| (index, prediction.changes().to_vec())).collect();
    root_causes(plan, &changes)
}

/// One line for a job: state, name, reason, and expected time.
pub(crate) fn line(name: &str, prediction: &Prediction) -> String {
    let secs = prediction.expected_secs.filter(|_| prediction.may_run());
    let secs = secs.map(|secs| format!("  (about {})", duration(secs))).unwrap_or_default();
    let (word, reason) = describe(prediction);
    format!("{word:<12} {name}{}{reason}{secs}\n", if reason.is_empty() { "" } else { ": " })
}

fn totals(predictions: &BTreeMap<usize, Prediction>) -> String {
    let mut words: BTreeMap<&str, usize> = BTreeMap::new();
    for prediction in predictions.values() {
        *words.entry(describe(prediction).0).or_default() += 1;
    }
    let words: Vec<String> = words.iter().map(|(word, count)| format!("{count} {word}")).collect();
    let to_run = predictions.values().filter(|prediction| prediction.may_run());
    let known: Vec<f64> = to_run.clone().filter_map(|prediction| prediction.expected_secs).collect();
    let about =
        duration(known.iter().sum()) + &range(&predictions.values().filter_map(|one| one.estimate).collect::<Vec<_>>());
    let time = match (known.len(), to_run.count() - known.len()) {
        (0, 0) => String::new(),
        (_, 0) => format!("; about {about} of work"),
        (0, _) => "; time unknown: nothing comparable was measured".to_owned(),
        (_, unknown) => {
            format!(
                "; time unknown: nothing comparable to {} was measured; the others take about {about}",
                count(unknown, "job")
            )
        }
    };
    format!("\n{}: {}{time}\n", count(predictions.len(), "job"), words.join(", "))
}

/// A line with the number of jobs that are likely to be done within a time if they run one after another in the order
/// of launching. The count ends at a job of unknown time.
fn fitting(plan: &Plan, predictions: &BTreeMap<usize, Prediction>, within: Duration) -> String {
    let ranks = plan.depth_first_ranks();
    let mut to_run: Vec<usize> =
        predictions.iter().filter(|(_, prediction)| prediction.may_run()).map(|(&index, _)| index).collect();
    to_run.sort_by_key(|&index| ranks[index]);
    let (mut secs, mut done) = (0.0, 0);
    for index in &to_run {
        let Some(one) = predictions[index].expected_secs else { break };
        secs += one;
        if secs > within.as_secs_f64() {
            break;
        }
        done += 1;
    }
    let time = humantime::format_duration(within);
    let next = to_run.get(done).map(|&index| match predictions[&index].expected_secs {
        Some(_) => format!("; {} does not fit", plan.nodes[index].name),
        None => format!("; nothing comparable to {} was measured", plan.nodes[index].name),
    });
    format!("within {time}: {done} of {}{}\n", count(to_run.len(), "job"), next.unwrap_or_default())
}

/// ` (8 min to 15 min; 3 jobs, each predicted from up to 14 measurements)`: the range of the sum of independent
/// predictions, the number of jobs, and the largest number of measurements behind one of them.
fn range(estimates: &[Estimate]) -> String {
    if estimates.is_empty() {
        return String::new();
    }
    let secs: f64 = estimates.iter().map(|one| one.secs).sum();
    let spread = |end: usize| estimates.iter().map(|one| (one.range_secs[end] - one.secs).powi(2)).sum::<f64>().sqrt();
    let [low, high] = [(secs - spread(0)).max(0.0), secs + spread(1)].map(duration);
    let measurements = estimates.iter().map(|one| one.measurements).max().unwrap_or(0);
    let foreign = estimates.iter().filter(|one| one.is_foreign).count();
    let elsewhere = if foreign > 0 { format!(", {foreign} of them on other machines only") } else { String::new() };
    let jobs = count(estimates.len(), "job");
    format!(" ({low} to {high}; {jobs}, each predicted from up to {}{elsewhere})", count(measurements, "measurement"))
}

fn render_causes(plan: &Plan, causes: &[RootCause]) -> String {
    let mut text = String::new();
    for cause in causes {
        let first = plan.nodes[cause.nodes[0]].name.as_str();
        let others = if cause.nodes.len() > 1 { format!(" and {} more", cause.nodes.len() - 1) } else { String::new() };
        let sentences: Vec<&str> = cause.changes.iter().map(|change| change.sentence.as_str()).collect();
        let after = if cause.consequences > 0 {
            format!(" → {} in consequence", count(cause.consequences, "job"))
        } else {
            String::new()
        };
        text += &format!("because {first}{others}: {}{after}\n", sentences.join("; "));
    }
    text
}
