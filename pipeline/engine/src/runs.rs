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

/// The last `count` runs, with the plan ids of all jobs in their plans, the action keys of all results that they made or
/// found in the store, and the checkpoints of all jobs that they started.
pub fn recent(store: &Store, count: usize) -> io::Result<Keep> {
    let runs: Vec<PathBuf> = run_dirs(store)?.into_iter().rev().take(count).collect();
    let mut keep = Keep { paths: runs.iter().cloned().collect(), ..Keep::default() };
    for dir in &runs {
        for file in event_files(dir) {
            keep.keys.extend(results(&file).into_iter().map(|(_, key)| key));
            keep.paths.extend(started(&file).iter().map(|key| store.checkpoint_dir(key)));
        }
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

/// The action keys of the results in an event file, each with its node.
pub(crate) fn results(file: &Path) -> Vec<(String, String)> {
    events(file, "finished", |event| match event {
        Event::Finished { node, result: NodeResult { key: Some(key), content: Some(_), .. } } => Some((node, key)),
        _ => None,
    })
}

/// The action keys of the jobs that an event file saw starting.
fn started(file: &Path) -> Vec<String> {
    events(file, "started", |event| if let Event::Started { key, .. } = event { Some(key) } else { None })
}

/// What `read` finds in the events whose lines contain `word`. The last line of a killed process may be torn.
fn events<T>(file: &Path, word: &str, read: impl Fn(Event) -> Option<T>) -> Vec<T> {
    let bytes = std::fs::read(file).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    // Most lines report progress; parsing them would take most of the time.
    text.lines().filter(|line| line.contains(word)).filter_map(|line| read(serde_json::from_str(line).ok()?)).collect()
}
