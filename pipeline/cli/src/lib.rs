#![doc = include_str!("../README.md")]

mod amount;
mod args;
mod best;
mod checked;
mod comparison;
mod device;
mod display;
mod error;
mod links;
mod measured;
mod named_methods;
mod output;
mod partial;
mod session;
mod stages;
mod verbs;
mod warnings;

use std::process::ExitCode;

use clap::Parser;

use args::{CacheVerb, Cli, Verb};
use error::CliError;

pub use stages::{stages, stages_of};

/// Keeps freed pages: a training step allocates and frees tens of megabytes. The system allocator would return them to
/// the kernel and fault them in again, which takes half of the step's time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Runs the program: parses the command line, dispatches the verb, and returns its exit code.
pub fn main() -> ExitCode {
    quiet_drivers();
    unset_empty_variables();
    let cli = Cli::parse();
    engine::estimate::ship(measured_times());
    match dispatch(cli) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            if !error.reader_is_gone() {
                output::note(&error.to_string());
            }
            ExitCode::from(error.exit_code())
        }
    }
}

/// Sets `XDG_RUNTIME_DIR` if it is unset. Otherwise Vulkan drivers print warnings about the folder of a desktop's
/// sockets, which this program never opens.
fn quiet_drivers() {
    const SOCKETS: &str = "XDG_RUNTIME_DIR";
    if std::env::var_os(SOCKETS).is_none() {
        // SAFETY: no other thread has been started yet.
        unsafe { std::env::set_var(SOCKETS, std::env::temp_dir()) };
    }
}

/// Removes empty environment variables, because scripts clear a variable by setting it to the empty string.
fn unset_empty_variables() {
    for name in args::VARIABLES.iter().filter(|name| std::env::var_os(name).is_some_and(|value| value.is_empty())) {
        // SAFETY: no other thread has been started yet.
        unsafe { std::env::remove_var(name) };
    }
}

/// Measured times of a few jobs of each stage and kind on the benchmark machine (two EPYC cores; see "Predicted times"
/// in ci/README.md). Written by `ci/ship-times STORE…`.
fn measured_times() -> Vec<engine::estimate::Shipped> {
    serde_json::from_str(include_str!("measured_times.json")).expect("the shipped times are valid")
}

fn dispatch(cli: Cli) -> Result<u8, CliError> {
    let store = cli.store;
    match cli.verb {
        Verb::Run(args) => verbs::run::run(&store, &args),
        Verb::Worker(args) => verbs::worker::worker(&store, &args),
        Verb::Attach(args) => verbs::attach::attach(&store, &args),
        Verb::Cancel { run } => verbs::cluster::cancel(&store, run.as_deref()),
        Verb::Plan(args) => verbs::plan::plan(&store, &args),
        Verb::Explain(args) => verbs::explain::explain(&store, &args),
        Verb::Status(args) => verbs::status::status(&store, &args),
        Verb::Graph(args) => verbs::graph::graph(&store, &args),
        Verb::Show(args) => verbs::results::show(&store, &args),
        Verb::Table(args) => verbs::table::table(&store, &args),
        Verb::Compare(args) => verbs::compare::compare(&store, &args),
        Verb::Export(args) => verbs::results::export(&store, &args),
        Verb::Render(args) => verbs::results::render(&store, &args),
        Verb::Prepare(args) => verbs::prepare::prepare(&args),
        Verb::Inspect { dir, recipe, format } => verbs::tools::inspect(&dir, format, recipe),
        Verb::Recipes(verb) => verbs::library::recipes(&verb),
        Verb::Data(verb) => verbs::data::data(&verb),
        Verb::Eval(args) => verbs::tools::eval(&args),
        Verb::Cache(CacheVerb::Verify { repair }) => verbs::cache::verify(&store, repair),
        Verb::Cache(CacheVerb::Gc(args)) => verbs::cache::gc(&store, &args),
        Verb::Cache(CacheVerb::Du) => verbs::cache::du(&store),
        Verb::Doctor(args) => verbs::doctor::doctor(&store, &args),
        Verb::Completions { shell } => verbs::tools::completions(shell),
        Verb::ExecJob { job } => Ok(engine::job::execute(&job, &stages())?),
    }
}

#[cfg(test)]
mod tests;
