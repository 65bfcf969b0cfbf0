//! `status`: counts the jobs that are done, running, failed and still to do.

use std::collections::BTreeMap;
use std::path::Path;

use engine::graph::NodeState;
use engine::status::State;

use crate::args::StatusArgs;
use crate::error::CliError;
use crate::output::{print, print_json};
use crate::session::Session;
use crate::verbs::search::note_search;
use crate::verbs::{cluster, plan};

pub(crate) fn status(store: &Path, args: &StatusArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.recipe)?;
    note_search(&args.recipe.recipe)?;
    let predictions = session.predict()?;
    if args.json {
        let named: BTreeMap<&str, _> = predictions
            .iter()
            .map(|(&index, prediction)| (session.plan.nodes[index].name.as_str(), prediction))
            .collect();
        print_json(&named)?;
        return Ok(engine::exit::OK);
    }
    let mut counts: BTreeMap<&str, BTreeMap<&str, usize>> = BTreeMap::new();
    for (&index, prediction) in &predictions {
        let of_template = counts.entry(&session.plan.nodes[index].template).or_default();
        *of_template.entry(prediction.node_state().name()).or_default() += 1;
    }
    let mut text = String::new();
    for (template, states) in counts {
        let states: Vec<String> = states.iter().map(|(state, count)| format!("{count} {state}")).collect();
        text += &format!("{template:<16} {}\n", states.join(", "));
    }
    for (&index, prediction) in &predictions {
        if matches!(prediction.node_state(), NodeState::Failed | NodeState::Running | NodeState::Blocked) {
            text += &plan::line(&session.plan.nodes[index].name, prediction);
        }
        if let State::WillRun { has_checkpoint: true, last_failure: None, .. } = &prediction.state {
            text += &plan::line(&session.plan.nodes[index].name, prediction);
        }
        if let State::WillRun { last_failure: Some(failed), .. } = &prediction.state {
            text += &format!("             log: {}\n", failed.log_dir.display());
        }
    }
    text += &cluster::state(&session.store, &session.plan.recipe)?.unwrap_or_default();
    print(&text)?;
    Ok(engine::exit::OK)
}
