//! Links from names to the results of a run, `results/RECIPE/NODE` in the store.

use std::collections::BTreeMap;
use std::path::PathBuf;

use engine::event::Outcome;
use engine::scheduler::RunSummary;
use engine::store::ActionRecord;
use engine::{Digest, FailureKind, KeyComponents};

use crate::session::Session;

/// Points the links of the recipe's nodes to the results of the run. A link is kept if the run lacked data and the
/// link's result was made from more inputs, e.g. after a mistyped `--data-root`. Returns the nodes whose links are
/// kept, each with the folder of this run's result.
pub(crate) fn update(session: &Session, summary: &RunSummary) -> anyhow::Result<BTreeMap<String, PathBuf>> {
    let contents = || summary.results.iter().filter_map(|(name, result)| Some((name, result.content.as_ref()?)));
    let lacks_data = summary.results.values().any(|result| result.outcome == Outcome::MissingData);
    let records = if lacks_data { session.store.records()? } else { Vec::new() };
    let mut kept = BTreeMap::new();
    for (name, content) in contents() {
        if lacks_data && is_worse(session, &records, (&summary.recipe, name), content) {
            kept.insert(name.clone(), session.store.view(content)?);
        }
    }
    let replaced = contents().filter(|(name, _)| !kept.contains_key(*name));
    session.store.link_results(&summary.recipe, replaced.map(|(name, content)| (name.as_str(), content)))?;
    Ok(kept)
}

/// Whether a result lacks data and was made from fewer inputs than the result that the link of its node leads to.
fn is_worse(session: &Session, records: &[ActionRecord], (recipe, node): (&str, &str), content: &Digest) -> bool {
    let linked = std::fs::read_link(session.store.result_link(recipe, node)).ok();
    let linked = linked.as_deref().and_then(|view| view.file_name()?.to_str());
    // Several jobs may have produced the same bytes.
    let of = |content: &str| {
        records.iter().rfind(|record| {
            let made_by = (&*record.provenance.recipe, &*record.provenance.node);
            record.content.to_string() == content && made_by == (recipe, node)
        })
    };
    match (linked.and_then(of), of(&content.to_string())) {
        (Some(old), Some(new)) => has_more(&old.components, &new.components),
        _ => false,
    }
}

/// Whether `new` lacks data and `old` had more inputs.
fn has_more(old: &KeyComponents, new: &KeyComponents) -> bool {
    lacks_data(new) && inputs(old) > inputs(new)
}

/// Whether a producer of the inputs had no data.
fn lacks_data(components: &KeyComponents) -> bool {
    components.inputs.values().flatten().any(|input| input.failure == Some(FailureKind::MissingData))
}

/// The number of inputs that the job could read.
fn inputs(components: &KeyComponents) -> usize {
    components.inputs.values().flatten().filter(|input| input.content.is_some()).count()
}

#[cfg(test)]
mod tests {
    use engine::KeyInput;

    use super::*;

    /// The components of a table over captures, of which `missing` have no data and the others failed or not.
    fn of_table(present: usize, missing: usize, failed: usize) -> KeyComponents {
        let with = |failure: Option<FailureKind>| KeyInput {
            content: failure.is_none().then(|| "0".to_owned()),
            failure,
            ..KeyInput::default()
        };
        let kinds = [(None, present), (Some(FailureKind::MissingData), missing), (Some(FailureKind::Diverged), failed)];
        let inputs = kinds.into_iter().flat_map(|(kind, count)| vec![with(kind); count]).collect();
        KeyComponents {
            stage: "table-generation".into(),
            code: Default::default(),
            params: serde_json::Value::Null,
            inputs: [("model".to_owned(), inputs)].into(),
            sources: Default::default(),
            output: ("report".into(), 1),
            environment: "cpu".into(),
        }
    }

    #[test]
    fn a_result_with_missing_data_does_not_replace_one_with_more() {
        assert!(has_more(&of_table(4, 0, 0), &of_table(0, 4, 0)));
        assert!(has_more(&of_table(3, 1, 0), &of_table(1, 3, 0)));
        assert!(!has_more(&of_table(1, 3, 0), &of_table(3, 1, 0)), "more data is better");
        assert!(!has_more(&of_table(4, 0, 0), &of_table(2, 0, 2)), "failures are news");
    }
}
