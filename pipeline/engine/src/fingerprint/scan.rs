//! Hashes the sources of a workspace: used by the build script of the binary, which includes this file, and by tests.
//!
//! An edit that cannot change what the code does (a comment, a line break, a test) must not change a hash; when in
//! doubt the hash changes, and a job reruns in vain.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};
use toml::{Table, Value};

use super::tokens::{rust_tokens, wgsl_tokens};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// What the code table says of one crate.
#[derive(Debug, PartialEq)]
pub struct ScannedCrate {
    pub name: String,
    /// The crate's folder.
    pub root: PathBuf,
    /// Path relative to the crate, with `/`, → hash.
    pub files: BTreeMap<String, String>,
    /// Workspace crates that it depends on directly.
    pub dependencies: BTreeSet<String>,
    /// Those of them that it uses for nothing but the type of an artifact.
    pub reads_artifacts_of: BTreeSet<String>,
    /// Hash of the manifest's dependencies and features and of all external crates below them.
    pub external: String,
}

/// Scans all workspace crates that the crate in `binary` depends on, of the workspace at `root`.
pub fn scan_workspace(root: &Path, binary: &Path) -> Result<BTreeMap<String, ScannedCrate>> {
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

/// The hashes of all files of a crate that can influence what it does.
pub fn hash_files(crate_root: &Path) -> Result<BTreeMap<String, String>> {
    let (mut open, mut hashes) = (vec![crate_root.to_owned()], BTreeMap::new());
    while let Some(folder) = open.pop() {
        for path in sorted_entries(&folder)? {
            let relative = path.strip_prefix(crate_root)?.to_string_lossy().replace('\\', "/");
            if !counts(&relative) {
                continue;
            }
            if path.is_dir() {
                open.push(path);
            } else {
                let hash = hash_file(&relative, &std::fs::read(&path)?);
                hashes.insert(relative, hash.map_err(|error| format!("{error}: {}", path.display()))?);
            }
        }
    }
    Ok(hashes)
}

/// Whether a file or folder can influence what the crate does: tests and documents cannot, and the manifest counts
/// through its dependencies.
fn counts(relative: &str) -> bool {
    let name = relative.rsplit('/').next().unwrap_or(relative);
    let never = ["tests", "tests.rs", "benches", "examples", "Cargo.toml", "target"];
    !(never.contains(&name)
        || name.starts_with('.')
        || name.ends_with('~')
        || name.ends_with(".md")
        || name.ends_with("_tests.rs"))
}

/// Hashes one file by kind: Rust as tokens, WGSL without comments, anything else (embedded data) byte by byte.
pub fn hash_file(path: &str, content: &[u8]) -> Result<String> {
    match path.rsplit('.').next() {
        Some("rs") => Ok(sha256_hex(rust_tokens(std::str::from_utf8(content)?)?.as_bytes())),
        Some("wgsl") => Ok(sha256_hex(wgsl_tokens(std::str::from_utf8(content)?).as_bytes())),
        _ => Ok(sha256_hex(content)),
    }
}

fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The dependencies of one crate, with what it inherits from the workspace filled in.
struct Manifest {
    /// Kind and target (`"dependencies"`, `"target.'cfg(unix)'.dependencies"`) → name → entry.
    dependencies: BTreeMap<String, BTreeMap<String, Table>>,
    features: Value,
    /// Workspace crates that this one uses for nothing but the type of an artifact.
    reads_artifacts_of: BTreeSet<String>,
}

impl Manifest {
    fn read(crate_root: &Path, shared: &Table) -> Result<Self> {
        let manifest = read_toml(&crate_root.join("Cargo.toml"))?;
        let mut dependencies = BTreeMap::new();
        add_dependencies(&mut dependencies, "", &manifest, shared);
        for (target, table) in manifest.get("target").and_then(Value::as_table).into_iter().flatten() {
            table.as_table().into_iter().for_each(|table| add_dependencies(&mut dependencies, target, table, shared));
        }
        let features = manifest.get("features").cloned().unwrap_or(Value::Boolean(false));
        let readings = table_at(&manifest, &["package", "metadata", "pipeline"]);
        let names = readings.and_then(|table| table.get("reads-artifacts-of")?.as_array()).into_iter().flatten();
        let reads_artifacts_of = names.filter_map(Value::as_str).map(str::to_owned).collect();
        Ok(Self { dependencies, features, reads_artifacts_of })
    }

    fn entries(&self) -> impl Iterator<Item = (&String, &Table)> {
        self.dependencies.values().flatten()
    }

    fn workspace_crates(&self, paths: &BTreeMap<&str, &str>) -> BTreeSet<String> {
        self.entries().map(|(name, _)| name.clone()).filter(|name| paths.contains_key(name.as_str())).collect()
    }

    /// Hash of dependencies, features, and name, version and checksum of all external crates below.
    fn hash(&self, paths: &BTreeMap<&str, &str>, lock: &Lock) -> String {
        let external = self.entries().filter(|(name, _)| !paths.contains_key(name.as_str()));
        let packages = external.map(|(name, entry)| entry.get("package").and_then(Value::as_str).unwrap_or(name));
        sha256_hex(format!("{:?}\n{}\n{:?}", self.dependencies, self.features, lock.closure(packages)).as_bytes())
    }
}

/// Adds what the crate itself is built with (not what its tests are) from one table of a manifest.
fn add_dependencies(
    found: &mut BTreeMap<String, BTreeMap<String, Table>>,
    target: &str,
    manifest: &Table,
    shared: &Table,
) {
    for kind in ["dependencies", "build-dependencies"] {
        for (name, entry) in manifest.get(kind).and_then(Value::as_table).into_iter().flatten() {
            let entries = found.entry(format!("{target} {kind}")).or_default();
            entries.insert(name.clone(), full_entry(name, entry, shared));
        }
    }
}

/// The entry with the workspace's part merged in, and without what Cargo.lock says better (version and path).
fn full_entry(name: &str, entry: &Value, shared: &Table) -> Table {
    let table = |entry: &Value| entry.as_table().cloned().unwrap_or_default();
    let mut full = table(entry);
    if full.remove("workspace").is_some() {
        let own_features = full.remove("features");
        let mut inherited = shared.get(name).map(table).unwrap_or_default();
        inherited.extend(full);
        full = inherited;
        if let Some(Value::Array(own)) = own_features {
            let features = full.entry("features").or_insert(Value::Array(Vec::new()));
            features.as_array_mut().into_iter().for_each(|all| all.extend(own.clone()));
        }
    }
    full.remove("version");
    full.remove("path");
    full
}

/// The packages of Cargo.lock.
struct Lock {
    /// "name version" → (checksum, dependencies as "name" or "name version").
    packages: BTreeMap<String, (String, Vec<String>)>,
}

impl Lock {
    fn new(lock: &Table) -> Self {
        let text = |package: &Value, key: &str| package.get(key).and_then(Value::as_str).unwrap_or("").to_owned();
        let read = |package: &Value| {
            let dependencies = package.get("dependencies").and_then(Value::as_array).into_iter().flatten();
            let names = dependencies.filter_map(Value::as_str).map(str::to_owned).collect();
            (format!("{} {}", text(package, "name"), text(package, "version")), (text(package, "checksum"), names))
        };
        let packages = lock.get("package").and_then(Value::as_array).into_iter().flatten().map(read).collect();
        Self { packages }
    }

    /// "name version" → checksum of the named packages and all below them.
    fn closure<'a>(&self, names: impl Iterator<Item = &'a str>) -> BTreeMap<&str, &str> {
        let mut open: Vec<&str> = names.collect();
        let mut found = BTreeMap::new();
        while let Some(name) = open.pop() {
            // Where several versions are locked, a bare name (from a manifest) takes them all.
            let is_named = |id: &str| id == name || id.strip_prefix(name).is_some_and(|rest| rest.starts_with(' '));
            for (id, (checksum, dependencies)) in self.packages.iter().filter(|(id, _)| is_named(id)) {
                if found.insert(id.as_str(), checksum.as_str()).is_none() {
                    open.extend(dependencies.iter().map(String::as_str));
                }
            }
        }
        found
    }
}

/// The code table as Rust source: `pub const CODE: engine::CodeTable`.
pub fn code_table(crates: &BTreeMap<String, ScannedCrate>) -> String {
    let mut source = String::from("/// The hashed sources that this binary was built from.\n");
    source += "pub const CODE: engine::CodeTable = engine::CodeTable { crates: &[\n";
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

fn read_toml(path: &Path) -> Result<Table> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{error}: {}", path.display()))?;
    text.parse::<Table>().map_err(|error| format!("{error}: {}", path.display()).into())
}

fn table_at<'a>(table: &'a Table, path: &[&str]) -> Option<&'a Table> {
    path.iter().try_fold(table, |table, key| table.get(*key)?.as_table())
}
