//! The fingerprint of a stage's code: hashes of sources without comments and tests, over the crate graph.

// The build script of the binary includes the scan; here it is only tested.
#[cfg(test)]
mod scan;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use crate::canonical;

/// The hashed sources of the workspace. The build script of the binary generates it.
#[derive(Clone, Copy, Debug)]
pub struct CodeTable {
    /// The crates, sorted by name.
    pub crates: &'static [CrateCode],
}

/// The hashed sources of one workspace crate.
#[derive(Clone, Copy, Debug)]
pub struct CrateCode {
    /// The crate's name.
    pub name: &'static str,
    /// The path (relative to the crate, with `/`) and the hash of every source that can influence a result; sorted.
    pub files: &'static [(&'static str, &'static str)],
    /// The names of the crate's direct dependencies in the workspace.
    pub dependencies: &'static [&'static str],
    /// The dependencies of which it uses only the artifact type, from its manifest's
    /// `package.metadata.pipeline.reads-artifacts-of`.
    pub reads_artifacts_of: &'static [&'static str],
    /// A hash of the manifest's dependencies and features, and of the name, version and checksum of every direct and
    /// indirect external dependency.
    pub external: &'static str,
}

impl CodeTable {
    /// The crate called `name`.
    pub fn get(&self, name: &str) -> Option<&'static CrateCode> {
        self.crates.iter().find(|code| code.name == name)
    }
}

/// The fingerprint of a stage's code. It has one hash per part, e.g. `"shaders"` for the crate's sources and
/// `"shaders dependencies"` for its external dependencies, so that a change can name the crate.
pub type Code = BTreeMap<String, String>;

/// The files of this crate that can influence a stage's result. All others plan, schedule and store: they decide
/// whether and where a job runs, but not the bytes that the stage reads.
const ENGINE_API: [&str; 4] = ["src/artifact.rs", "src/context.rs", "src/failure.rs", "src/stage.rs"];

/// The files of a stage's crate that readers of its artifact run: the type, and the exports that lead to it.
const ARTIFACT: [&str; 3] = ["src/artifact.rs", "src/artifact", "src/lib.rs"];

/// The part of a crate that a dependent crate runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Extent {
    /// Only the artifact type.
    Artifact,
    /// Any code.
    Whole,
}

/// The sources that a job provably does not use: crate → files and folders, relative to the crate.
pub type UnusedSources = BTreeMap<String, Vec<String>>;

/// The fingerprint of the stage with the crate `stage`: its sources and those of all direct and indirect dependencies
/// in the workspace, without the `unused` ones.
pub(crate) fn stage_code(table: &CodeTable, stage: &str, unused: &UnusedSources) -> Code {
    let mut code = Code::new();
    for (name, extent) in closure(table, stage) {
        let Some(part) = table.get(name) else {
            continue;
        };
        let used = |path: &str| match (name, extent) {
            ("engine", _) => ENGINE_API.contains(&path),
            (_, Extent::Artifact) => ARTIFACT.iter().any(|kept| lies_in(path, kept)),
            _ => !unused.get(name).is_some_and(|unused| unused.iter().any(|unused| lies_in(path, unused))),
        };
        code.insert(name.into(), hash_files(part.files.iter().filter(|(path, _)| used(path))));
        // The engine's external dependencies serve its scheduler; a stage that uses one of them declares it.
        if name != "engine" {
            code.insert(format!("{name} dependencies"), part.external.into());
        }
    }
    code
}

/// The crate and all of its direct and indirect dependencies in the workspace. The dependencies of a crate that is used
/// only for its artifact type are left out: the type uses only `scene` and the engine, which its reader uses as well.
fn closure<'a>(table: &CodeTable, stage: &'a str) -> BTreeMap<&'a str, Extent> {
    let (mut found, mut open) = (BTreeMap::new(), vec![(stage, Extent::Whole)]);
    while let Some((name, extent)) = open.pop() {
        let known = found.get(name).is_some_and(|known| *known >= extent);
        if !known {
            found.insert(name, extent);
            let below = table.get(name).filter(|_| extent == Extent::Whole);
            open.extend(below.into_iter().flat_map(|code| {
                let extent_of = |name| match code.reads_artifacts_of.contains(&name) {
                    true => Extent::Artifact,
                    false => Extent::Whole,
                };
                code.dependencies.iter().map(move |&name| (name, extent_of(name)))
            }));
        }
    }
    found
}

fn lies_in(path: &str, folder: &str) -> bool {
    let folder = folder.trim_end_matches('/');
    path.strip_prefix(folder).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

fn hash_files<'a>(files: impl Iterator<Item = &'a (&'a str, &'a str)>) -> String {
    let files: BTreeMap<&str, &str> = files.copied().collect();
    canonical::sha256_hex("pipeline/code/1", &serde_json::json!(files))
}
