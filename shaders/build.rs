//! Embeds every WGSL file of this crate, so that kernels find the files that they import (`src/gpu/wgsl`).

use std::path::{Path, PathBuf};

fn main() -> std::io::Result<()> {
    println!("cargo:rerun-if-changed=src");
    let sources = PathBuf::from(std::env::var("CARGO_MANIFEST_DIR").expect("Cargo sets it")).join("src");
    let mut files = Vec::new();
    collect(&sources, &mut files)?;
    let entry = |file: &PathBuf| {
        let name = file.strip_prefix(&sources).expect("a file below src").with_extension("");
        let name = name.to_string_lossy().replace(['/', '\\'], "::");
        (name, file.to_string_lossy().into_owned())
    };
    let mut entries: Vec<(String, String)> = files.iter().map(entry).collect();
    entries.sort();
    let line = |(name, file): &(String, String)| format!("    ({name:?}, include_str!({file:?})),\n");
    let lines: String = entries.iter().map(line).collect();
    let table = format!("const FILES: Files = &[\n{lines}];\n");
    std::fs::write(PathBuf::from(std::env::var("OUT_DIR").expect("Cargo sets it")).join("wgsl_files.rs"), table)
}

/// Collects the WGSL files of a folder and of all folders below it.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(&path, files)?;
        } else if path.extension().is_some_and(|extension| extension == "wgsl") {
            files.push(path);
        }
    }
    Ok(())
}
