//! What all trials of a search reached: one line of JSON per trial and rung, appended as they come.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use fs_err as fs;
use serde::{Deserialize, Serialize};

use crate::halving::Reached;

/// What one trial reached at one rung.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The trial's number.
    pub trial: usize,
    /// Its coordinates, one in [0, 1) per parameter.
    pub point: Vec<f64>,
    /// Its assignments, e.g. `nodes.train.params.schedule_scale=0.1`.
    pub assignments: Vec<String>,
    /// The rung.
    pub rung: usize,
    /// The objective, larger is better; `None` if the trial failed or broke a constraint.
    pub objective: Option<f64>,
    /// The values behind it by name, e.g. of each scene.
    pub values: BTreeMap<String, f64>,
    /// Seconds of training up to this rung.
    pub secs: f64,
    /// Steps up to this rung.
    pub steps: u64,
    /// Steps that this search computed for the rung; fewer if a checkpoint or a cached result had them.
    pub computed_steps: u64,
    /// Why there is no objective.
    pub failure: Option<String>,
}

/// The entries of a search, oldest first.
#[derive(Debug)]
pub struct History {
    path: PathBuf,
    /// The entries.
    pub entries: Vec<Entry>,
}

impl History {
    /// Reads the history at `path`; a missing file is an empty one. A torn last line, of a search that was killed, is left
    /// out.
    pub fn open(path: &Path) -> anyhow::Result<Self> {
        let text = if path.exists() { fs::read_to_string(path)? } else { String::new() };
        let entries: Vec<Entry> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        let history = Self { path: path.to_owned(), entries };
        if !text.is_empty() && !text.ends_with('\n') {
            history.rewrite()?;
        }
        Ok(history)
    }

    /// Appends an entry durably.
    pub fn add(&mut self, entry: Entry) -> anyhow::Result<()> {
        if let Some(folder) = self.path.parent() {
            fs::create_dir_all(folder)?;
        }
        let mut file = fs::OpenOptions::new().create(true).append(true).open(&self.path)?;
        file.write_all(format!("{}\n", serde_json::to_string(&entry)?).as_bytes())?;
        file.file().sync_data().context("cannot keep the history of the search")?;
        self.entries.push(entry);
        Ok(())
    }

    fn rewrite(&self) -> anyhow::Result<()> {
        let lines: Vec<String> = self.entries.iter().map(serde_json::to_string).collect::<Result<_, _>>()?;
        let text: String = lines.into_iter().map(|line| line + "\n").collect();
        let new = self.path.with_extension("new");
        fs::write(&new, text)?;
        Ok(fs::rename(new, &self.path)?)
    }

    /// What each trial reached.
    pub fn reached(&self) -> Reached {
        let mut reached = Reached::new();
        for entry in &self.entries {
            reached.entry(entry.trial).or_default().insert(entry.rung, entry.objective);
        }
        reached
    }

    /// The point and the assignments of a trial.
    pub fn trial(&self, trial: usize) -> Option<&Entry> {
        self.entries.iter().rev().find(|entry| entry.trial == trial)
    }

    /// The points and objectives at the highest rung that at least `enough` trials reached, for comparisons between trials.
    pub fn compared(&self, enough: usize) -> Vec<(Vec<f64>, f64)> {
        let mut by_rung: BTreeMap<usize, Vec<(Vec<f64>, f64)>> = BTreeMap::new();
        for entry in &self.entries {
            if let Some(objective) = entry.objective {
                by_rung.entry(entry.rung).or_default().push((entry.point.clone(), objective));
            }
        }
        let chosen = by_rung.iter().rev().find(|(_, points)| points.len() >= enough).or(by_rung.first_key_value());
        chosen.map(|(_, points)| points.clone()).unwrap_or_default()
    }

    /// The entry with the largest objective at this rung.
    pub fn best(&self, rung: usize) -> Option<&Entry> {
        let at_rung = self.entries.iter().filter(|entry| entry.rung == rung);
        at_rung.filter(|entry| entry.objective.is_some()).max_by(|a, b| {
            a.objective.partial_cmp(&b.objective).unwrap_or(std::cmp::Ordering::Equal).then(b.trial.cmp(&a.trial))
        })
    }

    /// The share of steps that checkpoints and cached results saved, beside training every rung of every trial from the
    /// beginning.
    pub fn saved_share(&self) -> f64 {
        let all: u64 = self.entries.iter().map(|entry| entry.steps).sum();
        let computed: u64 = self.entries.iter().map(|entry| entry.computed_steps).sum();
        if all == 0 { 0.0 } else { 1.0 - computed as f64 / all as f64 }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn entry(trial: usize, rung: usize, point: f64, objective: Option<f64>, secs: f64) -> Entry {
        Entry {
            trial,
            point: vec![point],
            assignments: vec![format!("a={point}")],
            rung,
            objective,
            values: BTreeMap::new(),
            secs,
            steps: 10,
            computed_steps: 5,
            failure: None,
        }
    }

    #[test]
    fn a_history_continues_after_a_kill() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/history.jsonl");
        let mut history = History::open(&path).unwrap();
        history.add(entry(0, 0, 0.1, Some(1.0), 1.0)).unwrap();
        history.add(entry(1, 0, 0.2, None, 1.0)).unwrap();
        let mut file = fs::OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"trial\": 2, \"poi").unwrap();
        let mut again = History::open(&path).unwrap();
        assert_eq!(again.entries, history.entries);
        again.add(entry(1, 1, 0.2, Some(2.0), 3.0)).unwrap();
        let last = History::open(&path).unwrap();
        assert_eq!(last.entries.len(), 3);
        assert_eq!(last.reached()[&1], BTreeMap::from([(0, None), (1, Some(2.0))]));
        assert_eq!(last.best(0).unwrap().trial, 0);
        assert_eq!(last.saved_share(), 0.5);
        assert_eq!((last.compared(1).len(), last.compared(2).len()), (1, 1));
    }
}
