//! What the program's exit codes mean. Scripts rely on them: numbers are never reused.

/// Everything that was asked for is there.
pub const OK: u8 = 0;
/// The command line is wrong.
pub const USAGE: u8 = 2;
/// The recipe, or what else the user gave to read (folders of images, a capture, a store), is invalid.
pub const INPUT: u8 = 3;
/// Nothing was selected, or nothing could run.
pub const NOTHING: u8 = 4;
/// With `--frozen`, some job would have had to run.
pub const FROZEN: u8 = 5;
/// Some jobs failed; the others are done.
pub const FAILED: u8 = 10;
/// A table or a check differs from what was expected.
pub const DIFFERS: u8 = 11;
/// The store is damaged and was not repaired.
pub const DAMAGED: u8 = 12;
/// The machine failed us: disk full, store not writable, process not started.
pub const INFRASTRUCTURE: u8 = 13;
/// A job saved its progress and wants to be run again.
pub const CHECKPOINTED: u8 = 75;
/// Whoever read our output went away before the end, as `head` does.
pub const READER_GONE: u8 = 141;
/// Stopped by INT (Ctrl-C).
pub const INTERRUPTED: u8 = 130;
/// Stopped by TERM.
pub const TERMINATED: u8 = 143;
