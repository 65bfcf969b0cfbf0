#![doc = include_str!("../README.md")]

pub mod slurm;

mod attendance;
mod batches;
mod cells;
mod crew;
mod element;
mod file;
mod follow;
mod needs;
mod probe;
mod program;
mod run_file;
mod wave;

#[cfg(test)]
mod fakes;

pub use batches::{After, Batch};
pub use cells::{Cell, Cells, Class};
pub use crew::{EarlyEnd, Worker, log_file, run_with_workers, wait};
pub use element::{Role, requeue};
pub use file::{ClassOptions, ClusterFile};
pub use probe::probe_file_system;
pub use program::{keep_program, program_of};
pub use run_file::{Process, RunFile};
pub use wave::{ClusterRun, Site, Wave};
