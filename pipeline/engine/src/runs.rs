//! The folders of earlier runs.

use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;

use crate::{Plan, Store};

/// The folders of all runs, oldest first. Their names begin with the time.
pub fn run_dirs(store: &Store) -> io::Result<Vec<PathBuf>> {
    if !store.exists() {
        return Ok(Vec::new());
    }
    let entries = fs_err::read_dir(store.root().join("runs"))?;
    let mut dirs: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
    dirs.sort();
    Ok(dirs)
}

/// The plan ids of all jobs in the plans of the last `count` runs.
pub fn recent_plan_ids(store: &Store, count: usize) -> io::Result<BTreeSet<String>> {
    let mut ids = BTreeSet::new();
    for dir in run_dirs(store)?.iter().rev().take(count) {
        // A run without a readable plan was killed before it started any job.
        let Ok(bytes) = std::fs::read(dir.join("plan.json")) else { continue };
        let Ok(plan) = serde_json::from_slice::<Plan>(&bytes) else { continue };
        ids.extend(plan.nodes.into_iter().map(|node| node.plan_id));
    }
    Ok(ids)
}
