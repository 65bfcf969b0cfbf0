//! `worker`: takes part in a run that several processes share.

use std::path::Path;

use anyhow::Context;
use cluster::{Process, RunFile};
use engine::job::StopRequests;
use engine::scheduler::{self, Share};
use engine::{Failure, FailureKind, Store};

use super::once::own_program;
use crate::args::WorkerArgs;
use crate::device::ChosenDevice;
use crate::display::{Display, lines::Lines};
use crate::error::CliError;
use crate::session::Session;

pub(crate) fn worker(store: &Path, args: &WorkerArgs) -> Result<u8, CliError> {
    end_with(args.parent)?;
    let store = Store::open(store)?;
    let run = named_or_newest(&store, args.run.as_deref())?;
    let (file, plan) = RunFile::read(&store, &run)?;
    let device = ChosenDevice::choose(args.device.as_deref().unwrap_or(&file.device))?;
    refuse_other_class(device, plan.device)?;
    let session = Session::of_run(store, &file, plan, device);
    if session.needs_device()? {
        device.check()?;
    }
    let (part, of) = args.part;
    let process = process(args, device)?;
    let share = Share {
        run,
        name: format!("worker-{part}"),
        begin: (part - 1) as f64 / of as f64,
        following: None,
        only: None,
        missing: None,
        idle: args.idle,
    };
    let options = file.options(&process, share);
    let mut display = Lines::default();
    // Lines go to standard error, where a reader that left does not matter.
    let watch = &mut |event: &engine::event::Event| _ = display.show(event);
    let summary = scheduler::run(&session.plan, &session.store, &options, watch)?;
    Ok(summary.exit_code(false))
}

/// Stops this process when its parent dies, which may have happened already.
fn end_with(parent: Option<u32>) -> Result<(), CliError> {
    let Some(parent) = parent else { return Ok(()) };
    #[cfg(target_os = "linux")]
    rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))
        .context("cannot follow the parent process")?;
    if std::os::unix::process::parent_id() != parent {
        let gone = Failure::new(FailureKind::World, "the process that started this worker has ended");
        return Err(CliError::Other(gone.into()));
    }
    Ok(())
}

/// The run of that name, or the newest shared run.
pub(super) fn named_or_newest(store: &Store, name: Option<&str>) -> Result<String, CliError> {
    let shared = |dir: &std::path::PathBuf| RunFile::exists(dir);
    let found = match name {
        Some(name) => Some(store.run_dir(name)).filter(shared),
        None => engine::runs::run_dirs(store)?.into_iter().rev().find(shared),
    };
    let dir = found.ok_or_else(|| {
        let hint = "start one with `pipeline run RECIPE --workers N`";
        CliError::nothing(name.map_or("no run is shared".into(), |name| format!("{name} is no shared run")), hint)
    })?;
    Ok(dir.file_name().unwrap_or_default().to_string_lossy().into_owned())
}

fn refuse_other_class(device: ChosenDevice, planned: engine::DeviceClass) -> Result<(), CliError> {
    if device.class() == planned {
        return Ok(());
    }
    let message = format!("the run was planned for a {}, not for {}", planned.as_str(), device.id());
    let hint = format!("add --device {}", planned.as_str());
    Err(CliError::Input(Failure::new(FailureKind::BadInput, message).hint(hint).into()))
}

fn process(args: &WorkerArgs, device: ChosenDevice) -> Result<Process, CliError> {
    let threads = args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    Ok(Process {
        jobs: args.jobs.unwrap_or(threads),
        threads,
        device: device.id(),
        command: vec![own_program()?.into(), "exec-job".into()],
        stop: StopRequests::listen().context("cannot listen to signals")?,
    })
}
