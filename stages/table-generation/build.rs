//! Embeds the TOML files of `claims/papers` and `claims/values`, so that a new file needs no registration.

use std::error::Error;
use std::fmt::Write as _;
use std::path::Path;

/// Folders below `claims/`; each becomes a constant of pairs (file stem, content), sorted by name.
const FOLDERS: [&str; 2] = ["papers", "values"];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=claims");
    let claims = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("claims");
    let mut source = String::new();
    for folder in FOLDERS {
        let entries = claims.join(folder).read_dir()?;
        let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>, std::io::Error>>()?;
        paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
        paths.sort();
        writeln!(source, "const {}: &[(&str, &str)] = &[", folder.to_uppercase())?;
        for path in &paths {
            let stem = path.file_stem().and_then(|stem| stem.to_str()).ok_or("a file name that is not UTF-8")?;
            writeln!(source, "    ({stem:?}, include_str!({path:?})),")?;
        }
        writeln!(source, "];")?;
    }
    std::fs::write(Path::new(&std::env::var("OUT_DIR")?).join("claims.rs"), source)?;
    Ok(())
}
