//! `cache`: verify, clean up and measure the store.

use std::path::{Path, PathBuf};

use cluster::program_of;
use engine::{Failure, FailureKind, Store, exit};

use crate::args::GcArgs;
use crate::error::CliError;
use crate::output::{bytes, count, duration, note, print, print_line};

/// Opens the store in `path` for reading; a missing store is an error.
pub(super) fn existing(path: &Path) -> Result<Store, CliError> {
    let store = Store::open_read_only(path)?;
    let none = || CliError::nothing(format!("no store found: {}", path.display()), "name another folder with --store");
    if store.exists() { Ok(store) } else { Err(none()) }
}

pub(crate) fn verify(store: &Path, repair: bool) -> Result<u8, CliError> {
    let store = existing(store)?;
    let _in_use = store.lock_shared()?;
    let damages = store.verify(repair)?;
    for damage in &damages {
        print_line(&format!("{}: {}", damage.message, damage.path.display()))?;
    }
    let files = count(damages.len(), "file");
    match (damages.len(), repair) {
        (0, _) => note("no damage found"),
        (_, true) => note(&format!("moved {files} to quarantine; the next run recomputes the results")),
        (_, false) => note(&format!("{files} damaged\nhint: pipeline cache verify --repair")),
    }
    Ok(if damages.is_empty() || repair { exit::OK } else { exit::DAMAGED })
}

pub(crate) fn gc(store: &Path, args: &GcArgs) -> Result<u8, CliError> {
    let store = existing(store)?;
    let Some(_alone) = store.try_lock_exclusive()? else {
        let busy = Failure::new(FailureKind::World, "a run is using the store").hint("try again after the run");
        return Err(anyhow::Error::from(busy.at(store.root())).into());
    };
    let mut keep = engine::runs::recent(&store, args.keep_runs)?;
    // Batch jobs may still wait for their turn.
    let programs: Vec<PathBuf> = keep.paths.iter().filter_map(|path| program_of(path)).collect();
    keep.paths.extend(programs);
    let report = store.gc(&keep, args.max_age, args.dry_run)?;
    let mut text = String::new();
    for (node, wall_secs, size_bytes) in &report.jobs {
        text += &format!("{node}  {}, took {}\n", bytes(*size_bytes), duration(*wall_secs));
    }
    print(&text)?;
    let verb = if args.dry_run { "would remove" } else { "removed" };
    let (jobs, files) = (count(report.jobs.len(), "job"), count(report.files, "file"));
    note(&format!("{verb} the results of {jobs}: {files}, {}", bytes(report.size_bytes)));
    Ok(exit::OK)
}

pub(crate) fn du(store: &Path) -> Result<u8, CliError> {
    let store = existing(store)?;
    let mut text = String::new();
    for (part, usage) in store.usage()? {
        text += &format!("{part:<14} {:>12} {:>9} files\n", bytes(usage.size_bytes), usage.files);
    }
    print(&text)?;
    Ok(exit::OK)
}
