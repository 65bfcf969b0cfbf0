//! `explain`: why one job runs, and where each of its parameters comes from.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::json;

use crate::args::NodeArgs;
use crate::error::CliError;
use crate::output::{print, print_json};
use crate::session::Session;
use crate::verbs::{decisions, inert, plan};

pub(crate) fn explain(store: &Path, args: &NodeArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.recipe)?;
    let index = session.node(&args.node)?;
    let node = &session.plan.nodes[index];
    let predictions = session.predict_for(&BTreeSet::from([index]))?;
    let causes = plan::causes(&session.plan, &predictions);
    let own = &predictions[&index];
    let origins = session.plan.origins.get(&node.name);
    let inert = inert::inert(&session, [index].into_iter())?;
    if args.json {
        let name = |index: &usize| session.plan.nodes[*index].name.as_str();
        let causes: Vec<_> = causes
            .iter()
            .map(|cause| json!({ "nodes": cause.nodes.iter().map(name).collect::<Vec<_>>(), "changes": cause.changes }))
            .collect();
        let params = json!({ "values": node.params, "origins": origins });
        print_json(&json!({
            "node": node.name, "prediction": own, "first_causes": causes, "params": params, "effects": node.decisions,
            "inert": inert.losses, "inert_when_left_out": inert.left_out,
        }))?;
        return Ok(engine::exit::OK);
    }
    let mut text = plan::line(&node.name, own);
    for cause in &causes {
        for change in &cause.changes {
            text += &format!("root cause: {}: {}\n", session.plan.nodes[cause.nodes[0]].name, change.sentence);
        }
    }
    for decision in &node.decisions {
        text += &format!("effect {}\n", decisions::sentence(decision));
    }
    text += &inert::render(&inert);
    text += "parameters:\n";
    for (key, origin) in origins.into_iter().flatten() {
        let value = value_at(&node.params, key).map_or_else(|| "–".to_owned(), ToString::to_string);
        text += &format!("  {key} = {value}  ({origin})\n");
    }
    text += &format!("stage {}, plan id {}\n", node.stage, node.plan_id);
    print(&text)?;
    Ok(engine::exit::OK)
}

/// The value at a dotted key.
fn value_at<'a>(params: &'a serde_json::Value, key: &str) -> Option<&'a serde_json::Value> {
    key.split('.').try_fold(params, |value, part| value.get(part))
}
