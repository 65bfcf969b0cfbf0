//! The `pipeline` program, built as a binary of this crate so that the tests can find it.

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
