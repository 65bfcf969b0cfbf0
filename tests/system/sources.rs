//! A copy of the workspace's sources to edit, hashed like the program's build script hashes the sources.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{CodeTable, CrateCode};
use tempfile::TempDir;
use walkdir::WalkDir;

use crate::product::root;

// Only the build script uses the functions that write Rust.
#[allow(dead_code)]
#[path = "../../pipeline/engine/src/fingerprint/scan/mod.rs"]
mod scan;

pub(crate) use scan::{ScannedCrate, tokens};

/// A temporary copy of the program's sources.
pub(crate) struct Sources {
    dir: TempDir,
}

impl Sources {
    /// Copies the current sources.
    pub(crate) fn copy() -> Self {
        let dir = TempDir::new().expect("a folder for the copy");
        for part in ["Cargo.toml", "Cargo.lock", "pipeline", "stages", "shaders"] {
            for entry in WalkDir::new(root().join(part)).into_iter().filter_entry(|entry| entry.file_name() != "target")
            {
                let entry = entry.expect("sources are readable");
                let to = dir.path().join(entry.path().strip_prefix(root()).expect("a path below the root"));
                if entry.file_type().is_dir() {
                    std::fs::create_dir_all(to).expect("a folder in the copy");
                } else {
                    std::fs::copy(entry.path(), to).expect("a file in the copy");
                }
            }
        }
        Self { dir }
    }

    /// A path in the copy.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// All files of the copy with this extension.
    pub(crate) fn files(&self, extension: &str) -> Vec<PathBuf> {
        let entries = WalkDir::new(self.dir.path()).into_iter().map(|entry| entry.expect("readable").into_path());
        entries.filter(|path| path.extension().is_some_and(|it| it == extension)).collect()
    }

    /// All crates of the program, hashed.
    pub(crate) fn scan(&self) -> BTreeMap<String, ScannedCrate> {
        scan::scan_workspace(self.dir.path(), &self.path("pipeline/cli")).expect("the sources are sound")
    }

    /// The code table that the build script would write.
    pub(crate) fn code(&self) -> CodeTable {
        let crates: Vec<CrateCode> = self.scan().into_values().map(crate_code).collect();
        CodeTable { crates: crates.leak() }
    }

    /// The code table after an edit of one file. The file is restored.
    pub(crate) fn code_with(&self, file: &str, edit: impl Fn(&str) -> String) -> CodeTable {
        let path = self.path(file);
        let before = read(&path);
        let after = edit(&before);
        assert_ne!(before, after, "nothing was edited in {file}");
        std::fs::write(&path, after).expect("the copy is writable");
        let code = self.code();
        std::fs::write(&path, before).expect("the copy is writable");
        code
    }
}

/// The text of a file.
///
/// # Panics
///
/// If the file cannot be read.
pub(crate) fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{error}: {}", path.display()))
}

/// The scanned crate as an entry of a code table, whose texts are static: they are leaked.
fn crate_code(scanned: ScannedCrate) -> CrateCode {
    let text = |text: String| -> &'static str { text.leak() };
    let names = |names: std::collections::BTreeSet<String>| names.into_iter().map(text).collect::<Vec<_>>().leak();
    CrateCode {
        name: text(scanned.name),
        files: scanned.files.into_iter().map(|(path, hash)| (text(path), text(hash))).collect::<Vec<_>>().leak(),
        dependencies: names(scanned.dependencies),
        reads_artifacts_of: names(scanned.reads_artifacts_of),
        external: text(scanned.external),
    }
}
