//! The folders of earlier runs.

use std::io;
use std::path::PathBuf;

use crate::store::Keep;
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

/// The last `count` runs, with the plan ids of all jobs in their plans.
pub fn recent(store: &Store, count: usize) -> io::Result<Keep> {
    let mut keep = Keep { runs: run_dirs(store)?.into_iter().rev().take(count).collect(), ..Keep::default() };
    for dir in &keep.runs {
        // A run without a readable plan was killed before it started any job.
        let Ok(bytes) = std::fs::read(dir.join("plan.json")) else { continue };
        let Ok(plan) = serde_json::from_slice::<Plan>(&bytes) else { continue };
        keep.plan_ids.extend(plan.nodes.into_iter().map(|node| node.plan_id));
    }
    Ok(keep)
}
