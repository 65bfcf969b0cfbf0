//! Hashes the sources that this binary is built from into a table, which becomes part of every key.

#[path = "../engine/src/fingerprint/scan.rs"]
mod scan;
#[path = "../engine/src/fingerprint/tokens.rs"]
mod tokens;

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
    std::fs::write(PathBuf::from(std::env::var("OUT_DIR")?).join("code.rs"), scan::code_table(&crates))?;
    Ok(())
}
