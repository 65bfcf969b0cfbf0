#![doc = include_str!("../README.md")]

mod fetch;
mod files;
mod layout;
mod manifest;
mod records;
#[cfg(test)]
mod tests;
mod verify;

pub use fetch::{Event, Fetched, Request, SILENCE, fetch};
pub use manifest::{Access, Archive, Manifest, Scene};
pub use records::Record;
pub use verify::{Finding, compare, verify, verify_file};
