//! One function per verb. Each returns the exit code.

pub(crate) mod attach;
pub(crate) mod cache;
pub(crate) mod cluster;
pub(crate) mod compare;
pub(crate) mod data;
pub(crate) mod decisions;
pub(crate) mod doctor;
pub(crate) mod explain;
pub(crate) mod graph;
mod inert;
pub(crate) mod library;
mod once;
pub(crate) mod plan;
pub(crate) mod prepare;
mod process;
pub(crate) mod results;
pub(crate) mod run;
mod search;
pub(crate) mod status;
pub(crate) mod table;
pub(crate) mod tools;
pub(crate) mod worker;
mod workers;
