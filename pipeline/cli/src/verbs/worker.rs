//! `worker`: takes part in a run that several processes share.

use std::path::Path;

use ::cluster::{Role, RunFile};
use anyhow::Context;
use engine::scheduler::{self, RunSummary, Share};
use engine::{DeviceClass, Failure, FailureKind};

use super::cluster;
use super::process::{named_or_newest, process};
use crate::args::WorkerArgs;
use crate::device::ChosenDevice;
use crate::display::{Display, lines::Lines};
use crate::error::CliError;
use crate::session::Session;

pub(crate) fn worker(store: &Path, args: &WorkerArgs) -> Result<u8, CliError> {
    end_with(args.parent)?;
    let store = cluster::existing_store(store)?;
    let run = named_or_newest(&store, args.run.as_deref())?;
    if args.wave.is_none() && has_ended(&store.run_dir(&run)) {
        // Its forced jobs would run again and replace the results of newer runs.
        let hint = "start a run with `pipeline run RECIPE --workers N`";
        return Err(CliError::nothing(format!("the shared run {run} has ended"), hint));
    }
    let (file, plan) = RunFile::read(&store, &run)?;
    let device = ChosenDevice::choose_granted(args.device.as_deref().unwrap_or(&file.device))?;
    refuse_other_class(device, plan.device)?;
    let session = Session::of_run(store, &file, plan, device);
    if device.class() != DeviceClass::Cpu {
        session.check_device(&session.predict()?)?;
    }
    let process = process(device, args.jobs, args.threads)?;
    let mut display = Lines::default();
    // Lines go to standard error, where a closed pipe is harmless.
    let watch = &mut |event: &engine::event::Event| _ = display.show(event);
    let (part, of) = args.part;
    if let Some(number) = args.wave {
        let element = std::env::var("SLURM_ARRAY_TASK_ID").ok().and_then(|text| text.parse().ok());
        let role = match (args.batch, element) {
            _ if args.report => Role::Report,
            (Some(batch), Some(number)) => Role::Cell { batch, number },
            _ => Role::Pilot { part, of, idle: args.idle },
        };
        return cluster::batch_job(&session, &run, &file, &process, (number, role), watch);
    }
    let share = Share {
        run,
        name: format!("worker-{part}{}", by_hand(args.parent)),
        begin: (part - 1) as f64 / of as f64,
        following: None,
        only: None,
        missing: None,
        idle: args.idle,
    };
    let summary = scheduler::run(&session.plan, &session.store, &file.options(&process, share), watch)?;
    Ok(summary.exit_code(false))
}

/// Whether every job of a shared run has an outcome, by the summary of the process that reports it.
fn has_ended(dir: &Path) -> bool {
    let summary = || serde_json::from_slice::<RunSummary>(&std::fs::read(dir.join("summary.json")).ok()?).ok();
    summary().is_some_and(|summary| summary.counts.interrupted + summary.counts.not_run == 0)
}

/// What distinguishes the name of a worker without a parent: several may be started on different machines.
fn by_hand(parent: Option<u32>) -> String {
    if parent.is_some() { String::new() } else { format!("-{}-{}", engine::host_name(), std::process::id()) }
}

/// Stops this process when its parent dies; the parent may have died already.
pub(super) fn end_with(parent: Option<u32>) -> Result<(), CliError> {
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

fn refuse_other_class(device: ChosenDevice, planned: engine::DeviceClass) -> Result<(), CliError> {
    if device.class() == planned {
        return Ok(());
    }
    let message = format!("the run was planned for a {}, not for {}", planned.as_str(), device.id());
    let hint = format!("add --device {}", planned.as_str());
    Err(CliError::Input(Failure::new(FailureKind::BadInput, message).hint(hint).into()))
}
