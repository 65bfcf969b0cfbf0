//! The results of all trials of a search.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Context;
use fs_err as fs;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::halving::Reached;

/// The result of one trial at one rung.
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
    /// The objective, larger is better (negated if lower values are better); `None` if the trial failed or violated a
    /// limit.
    pub objective: Option<f64>,
    /// The measured values of the objective's and the limits' columns, by name.
    pub values: BTreeMap<String, f64>,
    /// Seconds of training up to this rung.
    pub secs: f64,
    /// Steps up to this rung.
    pub steps: u64,
    /// Steps that this search computed for the rung; fewer if a checkpoint or a cached result had them.
    pub computed_steps: u64,
    /// Why there is no objective.
    pub failure: Option<String>,
    /// When the entry was added, in seconds since 1970.
    pub ended_at_secs: f64,
}

/// The trials of a search: one file per point and one per trial and rung, which appear once and never change. Processes
/// of several machines share them: a file is created once, and never appended to.
#[derive(Debug)]
pub struct History {
    dir: PathBuf,
    /// The results of the trials, oldest first.
    pub entries: Vec<Entry>,
    /// The point of each trial that was started: one coordinate in [0, 1) per parameter.
    pub points: BTreeMap<usize, Vec<f64>>,
    known: BTreeSet<PathBuf>,
}

impl History {
    /// Reads the history in the folder `dir`; a missing folder is an empty one.
    pub fn open(dir: &Path) -> anyhow::Result<Self> {
        let mut history =
            Self { dir: dir.to_owned(), entries: Vec::new(), points: BTreeMap::new(), known: BTreeSet::new() };
        history.refresh()?;
        Ok(history)
    }

    /// Reads what other processes have added.
    pub fn refresh(&mut self) -> anyhow::Result<()> {
        for path in self.unknown("points")? {
            let number = path.file_stem().and_then(|name| name.to_str()?.parse().ok());
            if let (Some(number), Some(point)) = (number, read(&path)) {
                self.points.insert(number, point);
                self.known.insert(path);
            }
        }
        for path in self.unknown("trials")? {
            if let Some(entry) = read(&path) {
                self.entries.push(entry);
                self.known.insert(path);
            }
        }
        let order = |entry: &Entry| (entry.trial, entry.rung);
        self.entries.sort_by(|a, b| a.ended_at_secs.total_cmp(&b.ended_at_secs).then(order(a).cmp(&order(b))));
        Ok(())
    }

    fn unknown(&self, folder: &str) -> anyhow::Result<Vec<PathBuf>> {
        let folder = self.dir.join(folder);
        if !folder.exists() {
            return Ok(Vec::new());
        }
        let mut paths = fs::read_dir(folder)?.map(|file| Ok(file?.path())).collect::<std::io::Result<Vec<_>>>()?;
        paths
            .retain(|path| path.extension().is_some_and(|extension| extension == "json") && !self.known.contains(path));
        Ok(paths)
    }

    /// Starts a trial at a point. Returns `false` if another process has started a trial of this number.
    pub fn start(&mut self, number: usize, point: &[f64]) -> anyhow::Result<bool> {
        let is_new = self.publish(&format!("points/{number:05}.json"), &point)?;
        self.refresh()?;
        Ok(is_new)
    }

    /// Adds an entry durably. An earlier entry for the same trial and rung is kept.
    pub fn add(&mut self, mut entry: Entry) -> anyhow::Result<()> {
        entry.ended_at_secs =
            SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        self.publish(&format!("trials/{:05}-{}.json", entry.trial, entry.rung), &entry)?;
        self.refresh()
    }

    /// Writes content to a new file; returns `false` if the file exists.
    fn publish(&self, name: &str, content: &impl Serialize) -> anyhow::Result<bool> {
        let path = self.dir.join(name);
        let folder = path.parent().unwrap_or(&self.dir);
        fs::create_dir_all(folder)?;
        let mut file = tempfile::NamedTempFile::new_in(folder).context("cannot keep the history of the search")?;
        file.write_all(&serde_json::to_vec_pretty(content)?)?;
        file.as_file().sync_data()?;
        match file.persist_noclobber(&path) {
            Ok(_) => Ok(true),
            Err(error) if error.error.kind() == ErrorKind::AlreadyExists => Ok(false),
            Err(error) => Err(error.error).context("cannot keep the history of the search"),
        }
    }

    /// The result of each trial.
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

    /// The points and objectives at the highest rung with at least `enough` objectives or, without such a rung, at
    /// the lowest one, for comparisons between trials.
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

    /// The number of latest trials in a row that failed with the same message before anything was measured, with that message.
    /// A trial beyond a limit has measured values.
    pub fn equal_failures(&self) -> Option<(usize, &str)> {
        let failure = |entry: &&Entry| entry.failure.is_some() && entry.values.is_empty();
        let message = self.entries.last().filter(failure)?.failure.as_deref()?;
        let is_equal = |entry: &&Entry| failure(entry) && entry.failure.as_deref() == Some(message);
        Some((self.entries.iter().rev().take_while(is_equal).count(), message))
    }

    /// The share of steps that checkpoints and cached results saved, compared with training every rung of every trial
    /// from the beginning.
    pub fn saved_share(&self) -> f64 {
        let all: u64 = self.entries.iter().map(|entry| entry.steps).sum();
        let computed: u64 = self.entries.iter().map(|entry| entry.computed_steps).sum();
        if all == 0 { 0.0 } else { 1.0 - computed as f64 / all as f64 }
    }
}

/// The content of a file; `None` if it cannot be read, e.g. because it is not visible yet.
fn read<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
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
            ended_at_secs: 0.0,
        }
    }

    #[test]
    fn processes_share_a_history_and_first_entries_stay() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("deep");
        let [mut one, mut other] = [(); 2].map(|()| History::open(&dir).unwrap());
        assert!(one.start(0, &[0.1]).unwrap() && !other.start(0, &[0.9]).unwrap());
        assert_eq!(other.points, BTreeMap::from([(0, vec![0.1])]));
        assert!(other.start(1, &[0.2]).unwrap());
        one.add(entry(0, 0, 0.1, Some(1.0), 1.0)).unwrap();
        one.add(entry(1, 0, 0.2, None, 1.0)).unwrap();
        // A killed process leaves a temporary file, or an incomplete one if the disk was full.
        fs::write(dir.join("trials/00002-0.json"), "{\"trial\": 2, \"poi").unwrap();
        other.add(entry(0, 0, 0.1, Some(9.0), 1.0)).unwrap();
        assert_eq!((other.entries.len(), other.reached()[&0][&0]), (2, Some(1.0)), "the first entry stays");
        other.add(entry(1, 1, 0.2, Some(2.0), 3.0)).unwrap();
        one.refresh().unwrap();
        assert_eq!(one.entries, other.entries);
        assert_eq!(one.reached()[&1], BTreeMap::from([(0, None), (1, Some(2.0))]));
        assert_eq!(one.best(0).unwrap().trial, 0);
        assert_eq!(one.saved_share(), 0.5);
        assert_eq!((one.compared(1).len(), one.compared(2).len()), (1, 1));
    }

    #[test]
    fn equal_failures_are_counted_from_the_latest() {
        let folder = tempfile::tempdir().unwrap();
        let mut history = History::open(folder.path()).unwrap();
        let mut add = |trial, failure: Option<&str>| {
            history.add(Entry { failure: failure.map(str::to_owned), ..entry(trial, 0, 0.0, None, 1.0) }).unwrap();
            history.equal_failures().map(|(count, message)| (count, message.to_owned()))
        };
        assert_eq!(add(0, Some("a")), Some((1, "a".into())));
        assert_eq!(add(1, None), None);
        assert_eq!(add(2, Some("out of memory")), Some((1, "out of memory".into())));
        assert_eq!(add(3, Some("out of memory")), Some((2, "out of memory".into())));
        assert_eq!(add(4, Some("a")), Some((1, "a".into())));
        let beyond = Entry { values: BTreeMap::from([("psnr".into(), 1.0)]), ..entry(5, 0, 0.0, None, 1.0) };
        history.add(Entry { failure: Some("a".into()), ..beyond }).unwrap();
        assert_eq!(history.equal_failures(), None, "a trial beyond a limit has worked");
    }
}
