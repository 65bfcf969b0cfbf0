use std::collections::BTreeMap;
use std::path::Path;

use tempfile::TempDir;

use super::scan::{ScannedCrate, code_table, hash_file, hash_files, scan_workspace};
use super::{Code, CodeTable, CrateCode, stage_code};

fn rust(source: &str) -> String {
    hash_file("src/lib.rs", source.as_bytes()).unwrap()
}

fn wgsl(source: &str) -> String {
    hash_file("src/blend.wgsl", source.as_bytes()).unwrap()
}

const SOURCE: &str = r#"
use std::fmt;
/// Half of x.
#[inline]
pub fn half(x: f64) -> f64 { x * 0.5 }
macro_rules! m { ($(#[$doc:meta])* $x:expr) => { $x && $x }; }
"#;

#[test]
fn comments_docs_and_white_space_do_not_change_the_hash() {
    let edits = [
        SOURCE.replace("/// Half of x.", "/// The half of `x`.\n/** more */"),
        SOURCE.replace("/// Half of x.", "#[doc = \"Half.\"]"),
        format!("//! A module.\n#![doc = \"docs\"]\n// note\n{SOURCE}/* end /* nested */ */"),
        SOURCE.replace("{ x * 0.5 }", "{\n    // half\n    x\n        * 0.5\n}"),
    ];
    for edit in edits {
        assert_eq!(rust(&edit), rust(SOURCE), "{edit}");
    }
}

#[test]
fn test_items_do_not_change_the_hash() {
    let tests = [
        "#[cfg(test)]\nmod tests { #[test] fn half() { assert_eq!(super::half(2.0), 1.0); } }",
        "#[cfg(test)] mod tests;",
        "#[cfg(test)] #[allow(unused)] pub(crate) mod tests;",
        "#[cfg(test)] use std::{io, mem};",
        "#[cfg(test)] const X: Foo = Foo { x: 1 };",
        "#[cfg(test)] const fn x() -> [u8; 3] { [1; 3] }",
        "#[cfg(test)] impl Foo { fn x() {} }",
        "#[cfg( test )] struct Foo(u8);",
        "#[cfg(test)] macro_rules! n { () => {}; }",
    ];
    for test in tests {
        assert_eq!(rust(&format!("{SOURCE}{test}")), rust(SOURCE), "{test}");
        assert_eq!(rust(&SOURCE.replace("#[inline]", &format!("{test} #[inline]"))), rust(SOURCE), "{test}");
    }
}

#[test]
fn edits_of_code_change_the_hash() {
    let edits = [
        SOURCE.replace("0.5", "0.25"),
        SOURCE.replace("0.5", "0.5f64"),
        SOURCE.replace("x * 0.5", "(x * 0.5)"),
        SOURCE.replace("$x && $x", "$x & & $x"),
        SOURCE.replace("half", "halve"),
        SOURCE.replace("#[inline]", ""),
        SOURCE.replace("#[inline]", "#[cfg(not(test))]"),
        format!("{SOURCE}#[cfg(test)] mod tests; fn more() {{}}"),
        format!("{SOURCE}#![cfg(test)] fn more() {{}}"),
        format!("{SOURCE}struct S {{ #[cfg(test)] x: u8, y: u8 }}"),
        format!("{SOURCE}const S: &str = \"// text\";"),
        format!("{SOURCE}const S: &str = \"// other\";"),
    ];
    let mut hashes: Vec<String> = edits.iter().map(|edit| rust(edit)).chain([rust(SOURCE)]).collect();
    hashes.sort();
    hashes.dedup();
    assert_eq!(hashes.len(), edits.len() + 1);
}

#[test]
fn wgsl_counts_without_comments_and_spacing() {
    let source = "fn f(x: f32) -> f32 {\n  return x / 2.0; // half\n}\n";
    assert_eq!(wgsl(source), wgsl("/* a /* b */ c */ fn f(x: f32) -> f32 { return x / 2.0;\n}"));
    assert_eq!(wgsl("a/*x*/b"), wgsl("a b"));
    assert_ne!(wgsl(source), wgsl(&source.replace("2.0", "4.0")));
    assert_ne!(wgsl("a b"), wgsl("ab"));
    assert_ne!(wgsl("a */ b"), wgsl("a b"));
}

/// The files that count in a crate of the files `files`, by path and text.
fn counted(files: &[(&str, &str)]) -> Vec<String> {
    let folder = TempDir::new().unwrap();
    for (path, text) in files {
        let path = folder.path().join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    hash_files(folder.path()).unwrap().into_keys().collect()
}

#[test]
fn names_of_tests_and_documents_are_left_out() {
    let rust = ["src/lib.rs", "src/a/mod.rs", "build.rs", "src/a/tests.rs", "src/tests/x.rs", "benches/b.rs"];
    let other = ["README.md", "Cargo.toml", "src/.lib.rs.swp", "src/lib.rs~", "src/a/data.toml", "src/a/k.wgsl"];
    let more = [("src/run_tests.rs", "fn f() {}"), ("src/snapshots/a.snap", "x")];
    let files: Vec<_> =
        rust.map(|path| (path, "fn f() {}")).into_iter().chain(other.map(|path| (path, "x = 1"))).chain(more).collect();
    assert_eq!(counted(&files), ["build.rs", "src/a/data.toml", "src/a/k.wgsl", "src/a/mod.rs", "src/lib.rs"]);
}

#[test]
fn a_file_that_does_not_parse_is_named() {
    let folder = TempDir::new().unwrap();
    std::fs::write(folder.path().join("lib.rs"), "fn f( {}").unwrap();
    assert!(hash_files(folder.path()).unwrap_err().to_string().contains("lib.rs"));
}

#[test]
fn modules_that_only_tests_contain_are_left_out() {
    let lib = "#[cfg(test)] mod probe;\n#[cfg(test)] #[allow(unused)] pub(crate) mod grid;\nmod a;\nmod b;";
    let files = [
        ("src/lib.rs", lib),
        ("src/probe.rs", "mod inner; include_str!(\"data.txt\");"),
        ("src/probe/inner.rs", ""),
        ("src/probe/data.txt", ""),
        ("src/grid/mod.rs", "mod cell;"),
        ("src/grid/cell.rs", ""),
        ("src/a.rs", "#[cfg(test)] mod help;\n#[cfg(test)]\n#[path = \"elsewhere.rs\"]\nmod moved;"),
        ("src/a/help.rs", ""),
        ("src/help.rs", "fn not_the_module_of_a() {}"),
        ("src/elsewhere.rs", ""),
        ("src/b/mod.rs", "mod c { #[cfg(test)] mod deep; }"),
        ("src/b/c/deep.rs", ""),
    ];
    assert_eq!(counted(&files), ["src/a.rs", "src/b/mod.rs", "src/help.rs", "src/lib.rs"]);
}

/// In doubt a file counts: anything outside of tests that refers to it keeps it.
#[test]
fn a_test_module_that_other_code_refers_to_counts() {
    let keeps = |lib: &str| {
        let lib = format!("#[cfg(test)] mod probe;\n{lib}");
        counted(&[("src/lib.rs", &lib), ("src/probe.rs", "mod inner;"), ("src/probe/inner.rs", "")]).len() == 3
    };
    assert!(!keeps(""));
    assert!(keeps("#[cfg(not(test))] mod probe;"));
    assert!(keeps("#[path = \"probe.rs\"] mod other;"));
    assert!(keeps("const TEXT: &str = include_str!(r#\"probe.rs\"#);"));
    assert!(keeps("const TEXT: &str = include_str!(concat!(env!(\"CARGO_MANIFEST_DIR\"), \"/src/probe.rs\"));"));
    assert!(!keeps("#[cfg(test)] const TEXT: &str = include_str!(\"probe.rs\");"));
    assert!(!keeps("// mod probe;\n/// include_str!(\"probe.rs\")\nfn f() {}"));
}

const fn crate_code(
    name: &'static str,
    files: &'static [(&'static str, &'static str)],
    dependencies: &'static [&'static str],
    external: &'static str,
) -> CrateCode {
    CrateCode { name, files, dependencies, reads_artifacts_of: &[], external }
}

const ENGINE: CrateCode = crate_code("engine", &[("src/stage.rs", "1"), ("src/store.rs", "2")], &[], "3");
const SHADERS: CrateCode = crate_code("shaders", &[("src/lib.rs", "4")], &[], "5");
const TRAINING: CrateCode = crate_code(
    "training",
    &[("src/lib.rs", "6"), ("src/methods/mcgs/mod.rs", "7"), ("src/methods/mcgs2.rs", "8")],
    &["engine", "shaders"],
    "9",
);

fn code(crates: &[CrateCode], unused: &[&str]) -> Code {
    let unused = [("training".to_owned(), unused.iter().map(|path| path.to_string()).collect())].into();
    stage_code(&CodeTable { crates: Box::leak(crates.into()) }, "training", &unused)
}

/// The parts of the fingerprint that differ from the fingerprint of the three crates above.
fn changed(crates: &[CrateCode], unused: &[&str]) -> Vec<String> {
    let (before, after) = (code(&[ENGINE, SHADERS, TRAINING], unused), code(crates, unused));
    before.into_iter().filter(|(part, hash)| after.get(part) != Some(hash)).map(|(part, _)| part).collect()
}

#[test]
fn a_fingerprint_covers_the_crate_and_its_dependencies() {
    let parts: Vec<String> = code(&[ENGINE, SHADERS, TRAINING], &[]).into_keys().collect();
    assert_eq!(parts, ["engine", "shaders", "shaders dependencies", "training", "training dependencies"]);
    let shaders = CrateCode { files: &[("src/lib.rs", "x")], ..SHADERS };
    assert_eq!(changed(&[ENGINE, shaders, TRAINING], &[]), ["shaders"]);
    let external = CrateCode { external: "x", ..TRAINING };
    assert_eq!(changed(&[ENGINE, SHADERS, external], &[]), ["training dependencies"]);
    let moved = CrateCode { files: &[("src/moved.rs", "4")], ..SHADERS };
    assert_eq!(changed(&[ENGINE, moved, TRAINING], &[]), ["shaders"]);
    let other = crate_code("rendering", &[("src/lib.rs", "x")], &["training"], "x");
    assert!(changed(&[ENGINE, SHADERS, TRAINING, other], &[]).is_empty());
}

#[test]
fn the_files_of_the_stage_api_exist() {
    for path in super::ENGINE_API {
        assert!(Path::new(env!("CARGO_MANIFEST_DIR")).join(path).is_file(), "{path}");
    }
}

#[test]
fn only_the_stage_api_of_the_engine_counts() {
    let store = CrateCode { files: &[("src/stage.rs", "1"), ("src/store.rs", "x")], external: "x", ..ENGINE };
    assert!(changed(&[store, SHADERS, TRAINING], &[]).is_empty());
    let api = CrateCode { files: &[("src/stage.rs", "x"), ("src/store.rs", "2")], ..ENGINE };
    assert_eq!(changed(&[api, SHADERS, TRAINING], &[]), ["engine"]);
}

#[test]
fn edits_of_unused_sources_do_not_count() {
    let edited = CrateCode {
        files: &[("src/lib.rs", "6"), ("src/methods/mcgs/mod.rs", "x"), ("src/methods/mcgs2.rs", "8")],
        ..TRAINING
    };
    assert!(changed(&[ENGINE, SHADERS, edited], &["src/methods/mcgs"]).is_empty());
    assert!(changed(&[ENGINE, SHADERS, edited], &["src/methods/mcgs/"]).is_empty());
    assert_eq!(changed(&[ENGINE, SHADERS, edited], &[]), ["training"]);
    assert_eq!(changed(&[ENGINE, SHADERS, edited], &["src/methods/mc", "src/methods/mcgs2.rs"]), ["training"]);
}

#[test]
fn of_a_crate_read_for_its_artifact_only_the_type_counts() {
    const TABLES: CrateCode = crate_code("tables", &[("src/lib.rs", "t")], &["engine", "training"], "t");
    const READER: CrateCode = CrateCode { reads_artifacts_of: &["training"], ..TABLES };
    const TRAINER: CrateCode = CrateCode { files: &[("src/artifact.rs", "a"), ("src/run.rs", "r")], ..TRAINING };
    let code = |crates: &[CrateCode]| {
        stage_code(&CodeTable { crates: Box::leak(crates.into()) }, "tables", &Default::default())
    };
    let before = code(&[ENGINE, SHADERS, TRAINER, READER]);
    let parts: Vec<&String> = before.keys().collect();
    assert_eq!(parts, ["engine", "tables", "tables dependencies", "training", "training dependencies"]);
    let body = CrateCode { files: &[("src/artifact.rs", "a"), ("src/run.rs", "x")], ..TRAINER };
    assert_eq!(code(&[ENGINE, SHADERS, body, READER]), before);
    for path in ["src/artifact.rs", "src/artifact/tensors.rs", "src/lib.rs"] {
        let files: &'static [(&str, &str)] = Box::leak(Box::new([(path, "x")]));
        assert_ne!(code(&[ENGINE, SHADERS, CrateCode { files, ..TRAINER }, READER]), before, "{path}");
    }
    // All of the crate counts if another dependency runs it.
    const PLAYER: CrateCode = crate_code("player", &[], &["training"], "p");
    const BOTH: CrateCode = CrateCode { dependencies: &["engine", "training", "player"], ..READER };
    assert_ne!(
        code(&[ENGINE, SHADERS, body, BOTH, PLAYER])["training"],
        code(&[ENGINE, SHADERS, TRAINER, BOTH, PLAYER])["training"]
    );
    assert!(code(&[ENGINE, SHADERS, TRAINER, BOTH, PLAYER]).contains_key("shaders"));
}

/// A workspace of a binary and two crates, with an external crate and its dependency.
fn workspace(edits: &[(&str, &str, &str)]) -> BTreeMap<String, ScannedCrate> {
    let mut files: BTreeMap<&str, String> = [
        (
            "Cargo.toml",
            "[workspace]\nmembers = [\"crates/*\"]\n[workspace.dependencies]\nlow = { path = \"crates/low\" }\n\
             high = { path = \"crates/high\" }\nglam = { version = \"1\", features = [\"a\"] }\n",
        ),
        (
            "Cargo.lock",
            "[[package]]\nname = \"glam\"\nversion = \"1.0.1\"\nchecksum = \"c1\"\ndependencies = [\"libm\"]\n\
             [[package]]\nname = \"libm\"\nversion = \"2.0.0\"\nchecksum = \"c2\"\n\
             [[package]]\nname = \"proptest\"\nversion = \"3.0.0\"\nchecksum = \"c3\"\n",
        ),
        ("crates/bin/Cargo.toml", "[package]\nname = \"bin\"\n[dependencies]\nhigh.workspace = true\n"),
        ("crates/high/Cargo.toml", "[package]\nname = \"high\"\n[dependencies]\nlow.workspace = true\n"),
        ("crates/high/lib.rs", "fn high() {}"),
        (
            "crates/low/Cargo.toml",
            "[package]\nname = \"low\"\n[dependencies]\nglam = { workspace = true, features = [\"b\"] }\n\
             [dev-dependencies]\nproptest = \"3\"\n",
        ),
        ("crates/low/lib.rs", "fn low() {}"),
    ]
    .map(|(path, text)| (path, text.to_owned()))
    .into();
    for (path, from, to) in edits {
        let text = files.get_mut(path).unwrap();
        assert!(text.contains(from), "{path} lacks {from}");
        *text = text.replace(from, to);
    }
    let folder = TempDir::new().unwrap();
    for (path, text) in files {
        let path = folder.path().join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    let mut crates = scan_workspace(folder.path(), &folder.path().join("crates/bin")).unwrap();
    crates.values_mut().for_each(|scanned| scanned.root = Path::new("").into());
    crates
}

#[test]
fn a_workspace_is_scanned_with_its_external_crates() {
    let plain = workspace(&[]);
    assert_eq!(plain.keys().collect::<Vec<_>>(), ["high", "low"]);
    assert!(plain["high"].dependencies.contains("low") && plain["low"].dependencies.is_empty());
    let reader = "[package.metadata.pipeline]\nreads-artifacts-of = [\"low\"]\n[dependencies]";
    let reading = workspace(&[("crates/high/Cargo.toml", "[dependencies]", reader)]);
    assert!(plain["high"].reads_artifacts_of.is_empty() && reading["high"].reads_artifacts_of.contains("low"));
    let changed = |path: &str, from: &str, to: &str| -> Vec<String> {
        let edited = workspace(&[(path, from, to)]);
        plain.keys().filter(|name| plain[*name] != edited[*name]).cloned().collect()
    };
    assert_eq!(changed("crates/low/lib.rs", "low", "lower"), ["low"]);
    assert!(changed("crates/low/lib.rs", "fn", "// note\nfn").is_empty());
    assert_eq!(changed("Cargo.lock", "c2", "x"), ["low"]);
    assert_eq!(changed("Cargo.lock", "1.0.1", "1.0.2"), ["low"]);
    assert!(changed("Cargo.lock", "c3", "x").is_empty());
    assert_eq!(changed("Cargo.toml", "\"a\"", "\"c\""), ["low"]);
    assert!(changed("Cargo.toml", "version = \"1\"", "version = \"1.0\"").is_empty());
    assert_eq!(changed("crates/low/Cargo.toml", "\"b\"", "\"c\""), ["low"]);
    assert!(changed("crates/low/Cargo.toml", "\"3\"", "\"4\"").is_empty());
}

#[test]
fn helper_crates_of_tests_do_not_count() {
    let helped = workspace(&[
        ("Cargo.toml", "glam = {", "support = { path = \"tests/support\" }\nglam = {"),
        ("crates/high/Cargo.toml", "[dependencies]\n", "[dependencies]\nsupport.workspace = true\n"),
    ]);
    assert_eq!(helped, workspace(&[]));
}

#[test]
fn the_code_table_is_rust() {
    let table = code_table(&workspace(&[]));
    let parsed: proc_macro2::TokenStream = table.parse().unwrap();
    assert!(!parsed.is_empty());
    assert!(table.contains("name: \"high\"") && table.contains("dependencies: &[\"low\"]"), "{table}");
}
