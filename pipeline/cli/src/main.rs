//! The `pipeline` binary; the library of this crate holds the program.

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
