//! The program's exit codes. Scripts rely on them, so a number is never reused. A wrong command line exits with 2, the
//! code of the command-line parser.

/// All requested results exist.
pub const OK: u8 = 0;
/// The recipe or another input of the user (image folders, a capture, a store) is invalid.
pub const INPUT: u8 = 3;
/// Nothing was selected, or nothing could run.
pub const NOTHING: u8 = 4;
/// With `--frozen`, some job would have to run.
pub const FROZEN: u8 = 5;
/// Some jobs failed, were interrupted or were not run, or data is missing under `--require-data`.
pub const FAILED: u8 = 10;
/// A table or a check differs from the expected values.
pub const DIFFERS: u8 = 11;
/// The store is damaged and was not repaired.
pub const DAMAGED: u8 = 12;
/// The machine failed, in this process or in a job: a full disk, a store that is not writable, a process that cannot be
/// started.
pub const INFRASTRUCTURE: u8 = 13;
/// All requested results exist, but some run is degenerate: its renders are no better than an image that needs no model.
pub const DEGENERATE: u8 = 14;
/// A job saved its progress and must be run again.
pub const CHECKPOINTED: u8 = 75;
/// The reader of the program's output closed it early, e.g. `head`.
pub const READER_GONE: u8 = 141;
/// Stopped by INT (Ctrl-C).
pub const INTERRUPTED: u8 = 130;
/// Stopped by TERM.
pub const TERMINATED: u8 = 143;
