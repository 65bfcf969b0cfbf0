//! Fake commands of Slurm, for tests: shell scripts in `PATH`.

use std::os::unix::fs::PermissionsExt;
use std::process::Command;

/// The variable that distinguishes the process in which the body of a test runs.
const INSIDE: &str = "CLUSTER_TEST_WITH_FAKES";

/// Whether this process has the fake commands. If not, runs the test named `test` in a process that has them, with
/// `prepare` applied to it, and returns `false`. Variables of one process are shared by all its tests.
pub(crate) fn has_fakes(test: &str, scripts: &[(&str, &str)], prepare: impl FnOnce(&mut Command)) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let bin = tempfile::tempdir().unwrap();
    for (name, script) in scripts {
        let path = bin.path().join(name);
        std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
    let path = format!("{}:{}", bin.path().display(), std::env::var("PATH").unwrap_or_default());
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", test, "--nocapture"]).env("PATH", path).env(INSIDE, bin.path());
    prepare(&mut command);
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
    false
}

/// A file that the fake commands share; they have its folder in `$CLUSTER_TEST_WITH_FAKES`.
pub(crate) fn shared(name: &str) -> std::path::PathBuf {
    std::path::Path::new(&std::env::var_os(INSIDE).unwrap()).join(name)
}
