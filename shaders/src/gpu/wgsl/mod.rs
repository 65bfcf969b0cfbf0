//! Assembles the WGSL of a kernel from the files that it imports.
//!
//! Below its header comment, a file declares what it needs, one directive per line:
//!
//! ```wgsl
//! #import gpu::row_sum              // another file: its path below `shaders/src`, written like a Rust path
//! #const LANES, COLUMNS             // u32 constants for which a launch specialises the kernel
//! #extern fn term(at: u32) -> f32   // a declaration that the importing file or Rust provides
//! ```
//!
//! A kernel names one file, its entry. [`assemble`] puts the constants first, then every imported file once, depth first
//! in the order of the `#import` lines, then the entry. The other directives produce no text: a test uses them to validate
//! every file on its own, and to report declarations that are missing or unused.
//!
//! Editors: wgsl-analyzer resolves `#import` lines by its setting `wgsl-analyzer.customImports`, e.g.
//! `"gpu::row_sum": "file:///path/to/shaders/src/gpu/row_sum.wgsl"`. It does not know `#const` and `#extern`.

#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

/// Path, e.g. `gpu::row_sum`, and content of WGSL files, sorted by path.
type Files = &'static [(&'static str, &'static str)];

include!(concat!(env!("OUT_DIR"), "/wgsl_files.rs"));

/// The complete WGSL of an entry file, specialised for these constants.
pub(crate) fn assemble(entry: &str, constants: &[(&str, u32)]) -> String {
    let lines = constants.iter().map(|(name, value)| format!("const {name}: u32 = {value}u;\n"));
    lines.collect::<String>() + &with_imports(FILES, entry)
}

/// The text of all files that an entry file imports, then its own.
fn with_imports(files: Files, entry: &str) -> String {
    let (mut assembled, mut imported) = (String::new(), BTreeSet::new());
    append(files, entry, &mut imported, &mut assembled);
    assembled
}

fn append(files: Files, text: &str, imported: &mut BTreeSet<String>, assembled: &mut String) {
    for path in directives(text, "import") {
        if imported.insert(path.to_owned()) {
            append(files, content(files, path), imported, assembled);
        }
    }
    let code = text.lines().filter(|line| !line.trim_start().starts_with('#'));
    assembled.extend(code.flat_map(|line| [line, "\n"]));
}

/// The arguments of all directives of a name, in order and without comments.
fn directives<'a>(text: &'a str, name: &str) -> impl Iterator<Item = &'a str> {
    let arguments = move |line: &'a str| line.trim_start().strip_prefix('#')?.strip_prefix(name)?.strip_prefix(' ');
    text.lines().filter_map(arguments).map(|line| line.split("//").next().unwrap_or_default().trim())
}

/// The content of the file at a path.
fn content(files: Files, path: &str) -> &'static str {
    let found = files.binary_search_by_key(&path, |(name, _)| name);
    files[found.unwrap_or_else(|_| panic!("no WGSL file {path:?}"))].1
}
