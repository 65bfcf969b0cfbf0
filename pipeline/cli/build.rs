//! Hashes the sources of this binary into a table, which enters the action keys, and embeds the recipes and the data
//! manifests.

#[path = "../engine/src/fingerprint/scan/mod.rs"]
mod scan;

use std::collections::BTreeMap;
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let binary = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR")?);
    let root = binary.join("../..").canonicalize()?;
    let crates = scan::scan_workspace(&root, &binary)?;
    let watched = crates.values().map(|scanned| scanned.root.clone());
    for path in watched.chain([root.join("Cargo.toml"), root.join("Cargo.lock"), binary.join("Cargo.toml")]) {
        println!("cargo:rerun-if-changed={}", path.display());
    }
    let table = scan::code_table(&crates) + &compiler()?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("code.rs"), table)?;
    let manifests = texts(&[root.join("data-manifests")], |text| text)?;
    let recipes = texts(&[root.join("recipes"), root.join("recipes/common")], extending_built_in)?;
    std::fs::write(
        out.join("texts.rs"),
        format!(
            "/// The recipes of the repository.\nconst RECIPES: engine::Builtins = &{recipes:?};\n\
         /// The descriptions of data sets.\nconst MANIFESTS: engine::Builtins = &{manifests:?};\n"
        ),
    )?;
    Ok(())
}

/// The TOML files of some folders: file stem and text, ordered by stem.
fn texts(folders: &[PathBuf], edit: impl Fn(String) -> String) -> Result<Vec<(String, String)>, Box<dyn Error>> {
    let mut texts = BTreeMap::new();
    for folder in folders {
        println!("cargo:rerun-if-changed={}", folder.display());
        for entry in std::fs::read_dir(folder)? {
            let path = entry?.path();
            let Some(name) = path.file_name().and_then(|name| name.to_str()?.strip_suffix(".toml")) else { continue };
            println!("cargo:rerun-if-changed={}", path.display());
            if texts.insert(name.to_owned(), edit(std::fs::read_to_string(&path)?)).is_some() {
                return Err(format!("two recipes are called {name}").into());
            }
        }
    }
    Ok(texts.into_iter().collect())
}

/// The recipe with built-in recipes in the place of the files that its line `extends` names.
fn extending_built_in(text: String) -> String {
    let built_in = |line: &str| match line.strip_prefix("extends = ") {
        Some(files) => {
            let stems = files.split('"').skip(1).step_by(2).map(|file| {
                let name = file.rsplit('/').next().unwrap_or(file);
                format!("\"builtin:{}\"", name.strip_suffix(".toml").unwrap_or(name))
            });
            format!("extends = [{}]\n", stems.collect::<Vec<_>>().join(", "))
        }
        None => format!("{line}\n"),
    };
    text.lines().map(built_in).collect()
}

/// Rust source of a constant that names the compiler.
fn compiler() -> Result<String, Box<dyn Error>> {
    let output = std::process::Command::new(std::env::var("RUSTC")?).arg("--version").output()?;
    let version = String::from_utf8(output.stdout)?;
    Ok(format!("/// The compiler that built this program.\nconst COMPILER: &str = {:?};\n", version.trim()))
}
