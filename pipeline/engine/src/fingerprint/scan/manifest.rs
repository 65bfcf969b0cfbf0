//! The build inputs of a crate: its dependencies and features, and the external crates that `Cargo.lock` pins.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use toml::{Table, Value};

use super::{Result, sha256_hex};

/// The dependencies of one crate, with what it inherits from the workspace filled in.
pub(super) struct Manifest {
    /// Kind and target (`"dependencies"`, `"target.'cfg(unix)'.dependencies"`) → name → entry.
    dependencies: BTreeMap<String, BTreeMap<String, Table>>,
    features: Value,
    /// Workspace crates of which this one uses only the artifact type.
    pub(super) reads_artifacts_of: BTreeSet<String>,
}

impl Manifest {
    /// Reads the manifest in the folder `crate_root`; `shared` is the workspace's `[workspace.dependencies]`.
    pub(super) fn read(crate_root: &Path, shared: &Table) -> Result<Self> {
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

    /// The dependencies that `paths` maps to a folder of the workspace.
    pub(super) fn workspace_crates(&self, paths: &BTreeMap<&str, &str>) -> BTreeSet<String> {
        self.entries().map(|(name, _)| name.clone()).filter(|name| paths.contains_key(name.as_str())).collect()
    }

    /// A hash of the dependencies, the features, and the name, version and checksum of all external crates below.
    pub(super) fn hash(&self, paths: &BTreeMap<&str, &str>, lock: &Lock) -> String {
        let external = self.entries().filter(|(name, _)| !paths.contains_key(name.as_str()));
        let packages = external.map(|(name, entry)| entry.get("package").and_then(Value::as_str).unwrap_or(name));
        sha256_hex(format!("{:?}\n{}\n{:?}", self.dependencies, self.features, lock.closure(packages)).as_bytes())
    }
}

/// Adds the dependencies and build dependencies of one table of a manifest. Development dependencies do not count, nor
/// do workspace crates below `tests/`, which hold helpers for tests.
fn add_dependencies(
    found: &mut BTreeMap<String, BTreeMap<String, Table>>,
    target: &str,
    manifest: &Table,
    shared: &Table,
) {
    for kind in ["dependencies", "build-dependencies"] {
        for (name, entry) in manifest.get(kind).and_then(Value::as_table).into_iter().flatten() {
            let path = shared.get(name).and_then(|entry| entry.get("path")?.as_str());
            if path.is_some_and(|path| path.starts_with("tests/")) {
                continue;
            }
            let entries = found.entry(format!("{target} {kind}")).or_default();
            entries.insert(name.clone(), full_entry(name, entry, shared));
        }
    }
}

/// The entry with the workspace's part merged in, and without version and path, which `Cargo.lock` states exactly.
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
pub(super) struct Lock {
    /// "name version" → (checksum, dependencies as "name" or "name version").
    packages: BTreeMap<String, (String, Vec<String>)>,
}

impl Lock {
    /// Reads the parsed `Cargo.lock`.
    pub(super) fn new(lock: &Table) -> Self {
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
            // A bare name (from a manifest) selects every locked version of the package.
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

pub(super) fn read_toml(path: &Path) -> Result<Table> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{error}: {}", path.display()))?;
    text.parse::<Table>().map_err(|error| format!("{error}: {}", path.display()).into())
}

pub(super) fn table_at<'a>(table: &'a Table, path: &[&str]) -> Option<&'a Table> {
    path.iter().try_fold(table, |table, key| table.get(*key)?.as_table())
}
