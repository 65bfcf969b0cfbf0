//! One function per verb, returning the exit code.

pub mod cache;
pub mod compare;
pub mod decisions;
pub mod doctor;
pub mod explain;
pub mod graph;
pub mod plan;
pub mod results;
pub mod run;
pub mod status;
pub mod table;
pub mod tools;
