//! Complete runs with small stages. This binary contains the tests, and doubles as the scheduler process that is killed
//! and as the child process of every job.

mod crash;
mod outcomes;
mod predict;
mod reuse;
mod share;
#[path = "../../src/test_stages.rs"]
mod test_stages;
mod world;

use std::path::Path;
use std::process::ExitCode;

use libtest_mimic::{Arguments, Failed, Trial};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[1..] {
        ["exec-job", spec] => execute(spec, &world::registry()),
        ["exec-rebuilt-job", spec] => execute(spec, &world::rebuilt_registry()),
        ["work", root, run, part] => world::work(Path::new(root), run, part),
        ["schedule", root] => world::schedule(Path::new(root)),
        _ => libtest_mimic::run(&Arguments::from_args(), trials()).exit_code(),
    }
}

fn execute(spec: &str, registry: &engine::Registry) -> ExitCode {
    match engine::job::execute(Path::new(spec), registry) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("{error:#}");
            ExitCode::from(engine::exit::INFRASTRUCTURE)
        }
    }
}

fn trials() -> Vec<Trial> {
    let tests = [reuse::TESTS, outcomes::TESTS, predict::TESTS, crash::TESTS, share::TESTS].concat();
    let trial = |(name, test): (&'static str, fn())| {
        Trial::test(name, move || {
            test();
            Ok::<(), Failed>(())
        })
    };
    tests.into_iter().map(trial).collect()
}
