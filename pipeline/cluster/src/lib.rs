#![doc = include_str!("../README.md")]

mod crew;
mod run_file;

pub use crew::{Worker, log_file, run_with_workers};
pub use run_file::{Process, RunFile};
