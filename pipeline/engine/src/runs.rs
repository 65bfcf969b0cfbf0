//! The folders of earlier runs.

use std::io;
use std::path::{Path, PathBuf};

use crate::event::{Event, NodeResult};
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

/// The last `count` runs, with the plan ids of all jobs in their plans and the action keys of all results that they made or
/// found in the store.
pub fn recent(store: &Store, count: usize) -> io::Result<Keep> {
    let mut keep = Keep { runs: run_dirs(store)?.into_iter().rev().take(count).collect(), ..Keep::default() };
    for dir in &keep.runs {
        keep.keys.extend(event_files(dir).iter().flat_map(|file| results(file)).map(|(_, key)| key));
        // A run without a readable plan was killed before it started any job.
        let Ok(bytes) = std::fs::read(dir.join("plan.json")) else { continue };
        let Ok(plan) = serde_json::from_slice::<Plan>(&bytes) else { continue };
        keep.plan_ids.extend(plan.nodes.into_iter().map(|node| node.plan_id));
    }
    Ok(keep)
}

/// The event files of a run: `events.jsonl` and, if processes shared it, `events-<process>.jsonl`.
pub(crate) fn event_files(run: &Path) -> Vec<PathBuf> {
    let is_events = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("events") && name.ends_with(".jsonl")
    };
    let entries = std::fs::read_dir(run).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).filter(is_events).collect()
}

/// The action keys of the results in an event file, each with its node. The last line of a killed process may be torn.
pub(crate) fn results(file: &Path) -> Vec<(String, String)> {
    let bytes = std::fs::read(file).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let result = |line: &str| match serde_json::from_str(line).ok()? {
        Event::Finished { node, result: NodeResult { key: Some(key), content: Some(_), .. } } => Some((node, key)),
        _ => None,
    };
    // Most lines report progress; parsing them would take most of the time.
    text.lines().filter(|line| line.contains("finished")).filter_map(result).collect()
}
