//! `cache`: looking after the store.

use std::path::Path;

use engine::{Failure, FailureKind, Store, exit};

use crate::args::GcArgs;
use crate::error::CliError;
use crate::output::{bytes, count, duration, print, print_line, tell};

/// The store in `path`; none is made.
fn existing(path: &Path) -> Result<Store, CliError> {
    let store = Store::look(path)?;
    let none = || CliError::nothing(format!("there is no store: {}", path.display()), "name another with --store");
    if store.exists() { Ok(store) } else { Err(none()) }
}

pub fn verify(store: &Path, repair: bool) -> Result<u8, CliError> {
    let store = existing(store)?;
    let _in_use = store.lock_shared()?;
    let damages = store.verify(repair)?;
    for damage in &damages {
        print_line(&format!("{}: {}", damage.message, damage.path.display()))?;
    }
    match (damages.len(), repair) {
        (0, _) => tell("the store is sound"),
        (number, true) => {
            tell(&format!("{} moved to quarantine; the next run makes the results again", count(number, "file")))
        }
        (number, false) => tell(&format!("{} damaged; hint: pipeline cache verify --repair", count(number, "file"))),
    }
    Ok(if damages.is_empty() || repair { exit::OK } else { exit::DAMAGED })
}

pub fn gc(store: &Path, args: &GcArgs) -> Result<u8, CliError> {
    let store = existing(store)?;
    let Some(_alone) = store.try_lock_exclusive()? else {
        let busy = Failure::new(FailureKind::World, "a run is using the store").hint("try again when it is over");
        return Err(anyhow::Error::from(busy.at(store.root())).into());
    };
    let keep = engine::runs::recent_plan_ids(&store, args.keep_runs)?;
    let report = store.gc(&keep, args.max_age, args.dry_run)?;
    let mut text = String::new();
    for (node, wall_secs, size_bytes) in &report.jobs {
        text += &format!("{node}  {}, {} to make again\n", bytes(*size_bytes), duration(*wall_secs));
    }
    print(&text)?;
    let verb = if args.dry_run { "would remove" } else { "removed" };
    let (jobs, files) = (count(report.jobs.len(), "job"), count(report.files, "file"));
    tell(&format!("{verb} the results of {jobs}: {files}, {}", bytes(report.size_bytes)));
    Ok(exit::OK)
}

pub fn du(store: &Path) -> Result<u8, CliError> {
    let store = existing(store)?;
    let mut text = String::new();
    for (part, usage) in store.usage()? {
        text += &format!("{part:<14} {:>12} {:>9} files\n", bytes(usage.size_bytes), usage.files);
    }
    print(&text)?;
    Ok(exit::OK)
}
