//! `prepare.json`: the inputs, commands and outputs of each step.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::{Result, bad, io};

/// Name of the file in the capture.
pub(crate) const NAME: &str = "prepare.json";

/// The state of a capture. `pipeline inspect --recipe` reads `fps` and `import`.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Manifest {
    /// Frames per second of the images, if they are known.
    pub(crate) fps: Option<f64>,
    /// Parameters of the importers, by kind of estimator.
    pub(crate) import: BTreeMap<String, toml::Table>,
    /// Files and folders that steps created or began to create, relative to the capture.
    pub(crate) owned: BTreeSet<String>,
    /// Steps by name.
    pub(crate) steps: BTreeMap<String, Record>,
}

/// A step that has ended.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Record {
    /// SHA-256 of the inputs, the command lines that ran, and the tool's version.
    pub(crate) key: String,
    /// The command lines, relative to the capture.
    pub(crate) commands: Vec<String>,
    /// The tool with its version.
    pub(crate) tool: String,
    /// SHA-256 of the inputs by name.
    pub(crate) inputs: BTreeMap<String, String>,
    /// SHA-256 of the outputs by path.
    pub(crate) outputs: BTreeMap<String, String>,
    /// The result in words.
    pub(crate) summary: String,
    /// Seconds that it took.
    pub(crate) secs: f64,
}

impl Manifest {
    /// The manifest of a capture; a new one if there is none.
    pub(crate) fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(NAME);
        let text = match std::fs::read_to_string(&path) {
            // Without its manifest, a step would refuse to replace the results of earlier runs.
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(io(&error, &path)),
            Err(_) => return Ok(Self::default()),
            Ok(text) => text,
        };
        serde_json::from_str(&text)
            .map_err(|error| bad(format!("damaged: {error}")).hint("delete it; all steps then run again").at(&path))
    }

    /// Writes the manifest by a rename, so that a killed run leaves the old or the new one.
    pub(crate) fn write(&self, dir: &Path) -> Result<()> {
        let (path, new) = (dir.join(NAME), dir.join(".prepare/prepare.json.new"));
        let text = serde_json::to_string_pretty(self).expect("a manifest is JSON") + "\n";
        if std::fs::read_to_string(&path).is_ok_and(|old| old == text) {
            return Ok(());
        }
        std::fs::write(&new, text).and_then(|()| std::fs::rename(&new, &path)).map_err(|error| io(&error, &path))
    }
}
