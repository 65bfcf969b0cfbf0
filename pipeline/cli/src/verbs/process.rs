//! This process as a part of a run that several processes share.

use std::path::PathBuf;

use ::cluster::{Process, RunFile};
use anyhow::Context;
use engine::Store;

use crate::device::ChosenDevice;
use crate::error::CliError;

/// The path of this program. On Linux it is a link to the running image, which does not change when a build replaces
/// the file, so all jobs of a run execute the code that the plan was made with.
pub(super) fn own_program() -> anyhow::Result<PathBuf> {
    let image = PathBuf::from("/proc/self/exe");
    if image.exists() { Ok(image) } else { std::env::current_exe().context("cannot find the program's own file") }
}

/// The run of that name, or the newest shared run, whether it has ended or not.
pub(super) fn named_or_newest(store: &Store, name: Option<&str>) -> Result<String, CliError> {
    let shared = |dir: &std::path::PathBuf| RunFile::exists(dir);
    let found = match name {
        Some(name) => Some(store.run_dir(name)).filter(shared),
        None => engine::runs::run_dirs(store)?.into_iter().rev().find(shared),
    };
    let dir = found.ok_or_else(|| {
        let hint = "start one with `pipeline run RECIPE --workers N`";
        CliError::nothing(name.map_or("no run is shared".into(), |name| format!("{name} is not a shared run")), hint)
    })?;
    Ok(dir.file_name().unwrap_or_default().to_string_lossy().into_owned())
}

/// This process, as a part of a shared run; in a batch job, USR1 requests a stop.
pub(super) fn process(device: ChosenDevice, jobs: Option<usize>, threads: Option<usize>) -> Result<Process, CliError> {
    // A batch system that does not bind its jobs to processors still reports the number of processors of this job.
    let granted = || std::env::var("SLURM_CPUS_ON_NODE").ok().and_then(|text| text.parse().ok());
    let available = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.or_else(granted).unwrap_or_else(available);
    Ok(Process {
        jobs: jobs.unwrap_or(threads),
        threads,
        device: device.id(),
        command: vec![own_program()?.into(), "exec-job".into()],
        stop: engine::job::StopRequests::listen_in_batch()?,
    })
}
