//! Earlier runs, as their folders tell.

use std::collections::BTreeSet;
use std::path::PathBuf;

use crate::scheduler::RunSummary;
use crate::store::naming;
use crate::{Plan, Store};

/// Folders of all runs, oldest first (their names begin with the time).
pub fn run_dirs(store: &Store) -> anyhow::Result<Vec<PathBuf>> {
    if !store.exists() {
        return Ok(Vec::new());
    }
    let folder = store.root().join("runs");
    let entries = std::fs::read_dir(&folder).map_err(naming(&folder))?;
    let mut dirs: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<std::io::Result<_>>()?;
    dirs.sort();
    Ok(dirs)
}

/// The plan ids of everything that the last `count` runs planned.
pub fn recent_plan_ids(store: &Store, count: usize) -> anyhow::Result<BTreeSet<String>> {
    let mut ids = BTreeSet::new();
    for dir in run_dirs(store)?.iter().rev().take(count) {
        // A run that was killed while it wrote its plan has started nothing.
        let Ok(bytes) = std::fs::read(dir.join("plan.json")) else { continue };
        let Ok(plan) = serde_json::from_slice::<Plan>(&bytes) else { continue };
        ids.extend(plan.nodes.into_iter().map(|node| node.plan_id));
    }
    Ok(ids)
}

/// What the last finished run of a recipe came to.
pub fn last_summary(store: &Store, recipe: &str) -> anyhow::Result<Option<RunSummary>> {
    let read = |dir: &PathBuf| {
        let summary: RunSummary = serde_json::from_slice(&std::fs::read(dir.join("summary.json")).ok()?).ok()?;
        (summary.recipe == recipe).then_some(summary)
    };
    Ok(run_dirs(store)?.iter().rev().find_map(read))
}
