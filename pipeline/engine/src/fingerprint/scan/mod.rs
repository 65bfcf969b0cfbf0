//! Hashes the sources of a workspace. The build script of the binary includes this module; here it is only tested.
//!
//! An edit that cannot change what the code does (a comment, a line break, a test) must not change a hash. In doubt the
//! hash changes, and a job reruns without need.

mod manifest;
mod modules;
pub(crate) mod tokens;

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use manifest::{Lock, Manifest, read_toml, table_at};
use modules::References;
use tokens::{rust_tokens, wgsl_tokens};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// One crate's entry in the code table.
#[derive(Debug, PartialEq)]
pub(crate) struct ScannedCrate {
    /// The crate's name.
    pub(crate) name: String,
    /// The crate's folder.
    pub(crate) root: PathBuf,
    /// Path relative to the crate, with `/`, → hash.
    pub(crate) files: BTreeMap<String, String>,
    /// Workspace crates that it depends on directly.
    pub(crate) dependencies: BTreeSet<String>,
    /// The dependencies of which it uses only the artifact type.
    pub(crate) reads_artifacts_of: BTreeSet<String>,
    /// Hash of the manifest's dependencies and features and of all external crates below them.
    pub(crate) external: String,
}

/// Scans all workspace crates that the crate in `binary` depends on, of the workspace at `root`.
pub(crate) fn scan_workspace(root: &Path, binary: &Path) -> Result<BTreeMap<String, ScannedCrate>> {
    let manifest = read_toml(&root.join("Cargo.toml"))?;
    let shared = table_at(&manifest, &["workspace", "dependencies"]).cloned().unwrap_or_default();
    let lock = Lock::new(&read_toml(&root.join("Cargo.lock"))?);
    // Workspace crates are the shared dependencies that have a path.
    let paths: BTreeMap<&str, &str> =
        shared.iter().filter_map(|(name, entry)| Some((name.as_str(), entry.get("path")?.as_str()?))).collect();
    let (mut open, mut found) = (Manifest::read(binary, &shared)?.workspace_crates(&paths), BTreeMap::new());
    while let Some(name) = open.pop_first() {
        let crate_root = root.join(paths[name.as_str()]);
        let manifest = Manifest::read(&crate_root, &shared)?;
        let dependencies = manifest.workspace_crates(&paths);
        let reads_artifacts_of = manifest.reads_artifacts_of.clone();
        if let Some(stranger) = reads_artifacts_of.difference(&dependencies).next() {
            return Err(format!("reads-artifacts-of names {stranger}, which {name} does not depend on").into());
        }
        open.extend(dependencies.iter().filter(|name| !found.contains_key(*name)).cloned());
        let external = manifest.hash(&paths, &lock);
        let files = hash_files(&crate_root)?;
        let scanned = ScannedCrate { name, root: crate_root, files, dependencies, reads_artifacts_of, external };
        found.insert(scanned.name.clone(), scanned);
    }
    Ok(found)
}

/// The hashes of all files of a crate that can influence its behaviour. Files that only the crate's tests contain are
/// left out, by their names and by following `#[cfg(test)] mod name;`.
pub(crate) fn hash_files(crate_root: &Path) -> Result<BTreeMap<String, String>> {
    let (mut hashes, mut references) = (BTreeMap::new(), BTreeMap::new());
    for relative in counted_files(crate_root)? {
        let path = crate_root.join(&relative);
        let named = |error: Box<dyn Error>| format!("{error}: {}", path.display());
        let content = std::fs::read(&path).map_err(|error| named(error.into()))?;
        hashes.insert(relative.clone(), hash_file(&relative, &content).map_err(named)?);
        if relative.ends_with(".rs") {
            let found = References::of(Path::new(&relative), std::str::from_utf8(&content)?).map_err(named)?;
            references.insert(relative, found);
        }
    }
    for path in modules::test_only(&references, hashes.keys()) {
        hashes.remove(&path);
    }
    Ok(hashes)
}

/// The files of a crate whose names do not rule them out, relative to the crate.
fn counted_files(crate_root: &Path) -> Result<Vec<String>> {
    let (mut open, mut found) = (vec![crate_root.to_owned()], Vec::new());
    while let Some(folder) = open.pop() {
        for path in sorted_entries(&folder)? {
            let relative = path.strip_prefix(crate_root)?.to_string_lossy().replace('\\', "/");
            match (counts(&relative), path.is_dir()) {
                (true, true) => open.push(path),
                (true, false) => found.push(relative),
                (false, _) => (),
            }
        }
    }
    Ok(found)
}

/// Whether the name of a file or folder lets it influence the crate's behaviour. Tests, their snapshots and documents
/// do not; the manifest counts through its dependencies.
fn counts(relative: &str) -> bool {
    let name = relative.rsplit('/').next().unwrap_or(relative);
    let never = ["tests", "tests.rs", "benches", "examples", "snapshots", "Cargo.toml", "target"];
    !(never.contains(&name)
        || name.starts_with('.')
        || name.ends_with('~')
        || name.ends_with(".md")
        || name.ends_with("_tests.rs"))
}

/// Hashes one file by kind: Rust as tokens, WGSL without comments, any other file (embedded data) byte by byte.
pub(crate) fn hash_file(path: &str, content: &[u8]) -> Result<String> {
    match path.rsplit('.').next() {
        Some("rs") => Ok(sha256_hex(rust_tokens(std::str::from_utf8(content)?)?.as_bytes())),
        Some("wgsl") => Ok(sha256_hex(wgsl_tokens(std::str::from_utf8(content)?).as_bytes())),
        _ => Ok(sha256_hex(content)),
    }
}

fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The code table as Rust source: `const CODE: engine::CodeTable`.
pub(crate) fn code_table(crates: &BTreeMap<String, ScannedCrate>) -> String {
    let mut source = String::from("/// The hashed sources that this binary was built from.\n");
    source += "const CODE: engine::CodeTable = engine::CodeTable { crates: &[\n";
    for ScannedCrate { name, root: _, files, dependencies, reads_artifacts_of, external } in crates.values() {
        let files: Vec<(&String, &String)> = files.iter().collect();
        let dependencies: Vec<&String> = dependencies.iter().collect();
        let artifacts: Vec<&String> = reads_artifacts_of.iter().collect();
        source += &format!(
            "    engine::CrateCode {{ name: {name:?}, files: &{files:?}, dependencies: &{dependencies:?}, \
             reads_artifacts_of: &{artifacts:?}, external: {external:?} }},\n"
        );
    }
    source + "] };\n"
}

fn sorted_entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|error| format!("{error}: {}", folder.display()))?;
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<PathBuf>>>()?;
    paths.sort();
    Ok(paths)
}
