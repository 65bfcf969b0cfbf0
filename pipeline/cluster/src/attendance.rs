//! Which elements began on which machine, and which of them ended properly: a machine on which elements vanish is suspect.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use fs_err as fs;
use serde::{Deserialize, Serialize};

use crate::run_file::read_json;

/// Elements that must vanish on a machine before it is avoided: one may have been killed by hand.
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
    /// Notes the start of the element `name` of a wave.
    pub(crate) fn begin(folder: &Path, wave: usize, name: &str) -> anyhow::Result<Self> {
        let dir = folder.join(format!("wave-{wave}"));
        fs::create_dir_all(&dir)?;
        let own = Self { path: dir.join(format!("{name}.json")) };
        own.write(false)?;
        Ok(own)
    }

    /// Notes that the element ended on its own, well or not.
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
        let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
        name.split('.').next().unwrap_or_default().to_owned()
    })
}

/// The machines on which several elements of a wave began and never ended.
pub(crate) fn suspects(folder: &Path, wave: usize) -> anyhow::Result<BTreeSet<String>> {
    let dir = folder.join(format!("wave-{wave}"));
    let mut vanished: BTreeMap<String, usize> = BTreeMap::new();
    if dir.exists() {
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
    fn a_machine_is_suspect_after_two_vanished_elements() {
        let folder = tempfile::tempdir().unwrap();
        let ended = Attendance::begin(folder.path(), 1, "a").unwrap();
        ended.end().unwrap();
        Attendance::begin(folder.path(), 1, "b").unwrap();
        assert!(suspects(folder.path(), 1).unwrap().is_empty());
        Attendance::begin(folder.path(), 1, "c").unwrap();
        assert_eq!(suspects(folder.path(), 1).unwrap().len(), 1);
        assert!(suspects(folder.path(), 2).unwrap().is_empty());
    }
}
