//! Hashes the sources that this binary is built from into a table, which enters the action keys.

#[path = "../engine/src/fingerprint/scan/mod.rs"]
mod scan;

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
    std::fs::write(PathBuf::from(std::env::var("OUT_DIR")?).join("code.rs"), table)?;
    Ok(())
}

/// Rust source of a constant that names the compiler.
fn compiler() -> Result<String, Box<dyn Error>> {
    let output = std::process::Command::new(std::env::var("RUSTC")?).arg("--version").output()?;
    let version = String::from_utf8(output.stdout)?;
    Ok(format!("/// The compiler that built this program.\nconst COMPILER: &str = {:?};\n", version.trim()))
}
