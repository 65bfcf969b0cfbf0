//! Links from names to the results of a run, `results/RECIPE/NODE` in the store.

use std::collections::BTreeMap;
use std::path::PathBuf;

use engine::event::NodeResult;
use engine::history::{is_lack_of_data, loses_data};
use engine::scheduler::RunSummary;
use engine::store::ActionRecord;

use crate::session::Session;

/// Points the links of the recipe's nodes to the results of the run. A link is kept if the run's result lacks data that
/// the link's result was made from, e.g. after a mistyped `--data-root` or with a damaged image. Returns the nodes whose
/// links are kept, each with the folder of this run's result.
pub(crate) fn update(session: &Session, summary: &RunSummary) -> anyhow::Result<BTreeMap<String, PathBuf>> {
    let lacks_data = |result: &NodeResult| result.failure.as_ref().is_some_and(|failure| is_lack_of_data(failure.kind));
    let lacks_data = summary.results.values().any(lacks_data);
    let records = if lacks_data { session.store.records()? } else { Vec::new() };
    let (mut kept, mut replaced) = (BTreeMap::new(), Vec::new());
    for (name, result) in &summary.results {
        let Some(content) = &result.content else { continue };
        if is_worse(session, &records, (&summary.recipe, name), result) {
            kept.insert(name.clone(), session.store.view(content)?);
        } else {
            replaced.push((name.as_str(), content));
        }
    }
    session.store.link_results(&summary.recipe, replaced)?;
    Ok(kept)
}

/// Whether a result lacks data that the result at the link of its node was made from.
fn is_worse(session: &Session, records: &[ActionRecord], (recipe, node): (&str, &str), result: &NodeResult) -> bool {
    let is_new = |record: &&ActionRecord| result.key.as_deref() == Some(record.key.as_str());
    let Some(new) = records.iter().find(is_new) else { return false };
    let linked = std::fs::read_link(session.store.result_link(recipe, node)).ok();
    let linked = linked.as_deref().and_then(|view| view.file_name()?.to_str());
    // Jobs of any recipe may have produced the linked bytes.
    let is_old = |record: &&ActionRecord| {
        Some(record.content.to_string().as_str()) == linked && record.components.stage == new.components.stage
    };
    records.iter().rfind(is_old).is_some_and(|old| loses_data(&old.components, &new.components))
}
