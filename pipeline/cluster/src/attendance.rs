//! Records the node on which each element began, and whether it ended properly: a node on which elements vanish is suspect.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use fs_err as fs;
use serde::{Deserialize, Serialize};

use crate::run_file::read_json;

/// Number of elements that must vanish on a node before it is avoided: one may have been killed manually.
const VANISHED: usize = 2;

/// The presence of one element.
#[derive(Debug, Serialize, Deserialize)]
struct Entry {
    host: String,
    ended: bool,
}

/// The presence of this process in a wave; written at its start and its end.
pub(crate) struct Attendance {
    path: PathBuf,
}

impl Attendance {
    /// Records the start of the element `name` of a wave.
    pub(crate) fn begin(folder: &Path, wave: usize, name: &str) -> anyhow::Result<Self> {
        let dir = folder.join(format!("wave-{wave}"));
        fs::create_dir_all(&dir)?;
        // An element that Slurm restarts on another node, because its node failed, leaves an entry for each node.
        let restarts = std::env::var("SLURM_RESTART_COUNT").unwrap_or_else(|_| "0".into());
        let own = Self { path: dir.join(format!("{name}-{restarts}.json")) };
        own.write(false)?;
        Ok(own)
    }

    /// Records that the element ended by itself, successfully or not.
    pub(crate) fn end(&self) -> anyhow::Result<()> {
        self.write(true)
    }

    fn write(&self, ended: bool) -> anyhow::Result<()> {
        Ok(fs::write(&self.path, serde_json::to_vec(&Entry { host: node(), ended })?)?)
    }
}

/// The name of this machine, as Slurm knows it. It may differ from the machine's own name.
fn node() -> String {
    std::env::var("SLURMD_NODENAME").unwrap_or_else(|_| {
        let name = engine::host_name();
        name.split('.').next().unwrap_or_default().to_owned()
    })
}

/// The nodes on which several elements of the waves before this one began and never ended.
pub(crate) fn suspects(folder: &Path, wave: usize) -> anyhow::Result<BTreeSet<String>> {
    let mut vanished: BTreeMap<String, usize> = BTreeMap::new();
    let folders = (1..wave).map(|earlier| folder.join(format!("wave-{earlier}")));
    for dir in folders.filter(|dir| dir.exists()) {
        for file in fs::read_dir(dir)? {
            // A torn entry is of an element that vanished while it wrote; its machine is unknown.
            let Ok(entry) = read_json::<Entry>(&file?.path()) else { continue };
            *vanished.entry(entry.host).or_default() += usize::from(!entry.ended);
        }
    }
    Ok(vanished.into_iter().filter(|(_, count)| *count >= VANISHED).map(|(host, _)| host).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_suspect_after_two_vanished_elements_of_any_waves() {
        let folder = tempfile::tempdir().unwrap();
        let begin = |wave, name| Attendance::begin(folder.path(), wave, name).unwrap();
        let suspects = |wave| suspects(folder.path(), wave).unwrap().len();
        begin(1, "a").end().unwrap();
        begin(1, "b");
        assert_eq!(suspects(2), 0);
        begin(2, "b");
        assert_eq!([1, 2, 3, 4].map(suspects), [0, 0, 1, 1]);
    }
}
