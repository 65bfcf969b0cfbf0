//! The child's side of a job: reads the inputs, runs the stage, publishes the artifact, writes a status.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

use anyhow::Context;
use fs_err as fs;
use serde_json::{Value, json};

use super::{InputSpec, JobSpec, JobStatus, Line, failure, log, machine, signals};
use crate::digest::SourceDigests;
use crate::store::{ActionRecord, Lookup, Provenance, Publication, Store};
use crate::{ActionKey, AnyStage, Failure, FailureKind, InputRecord, JobContext, Progress, Registry, exit};

/// The minimum time between two progress reports.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(100);
/// The minimum time between two lines about progress in the log.
const LOG_INTERVAL: Duration = Duration::from_secs(10);
/// The time that a job has to save its progress after its scheduler died.
const ORPHAN_GRACE: Duration = Duration::from_secs(30);

/// Runs the job described in `spec_file` and returns the process's exit code (see [`exit`]).
///
/// The outcome is in `status.json` next to the specification. An error means that it could not be written.
pub fn execute(spec_file: &Path, registry: &Registry) -> anyhow::Result<u8> {
    let spec: JobSpec = serde_json::from_slice(&fs::read(spec_file).context("cannot read the job")?)?;
    let stop = signals::stop_flag().context("cannot install signal handlers")?;
    stop_with_parent(spec.parent_pid, &stop)?;
    log::init(&spec.dir, &spec.log_filter)?;
    log_panics();
    let JobSpec { node, components, threads, device, .. } = &spec;
    tracing::info!("started {node}: stage {}, {threads} threads, device {device}", components.stage);
    let run = AssertUnwindSafe(|| run_and_publish(&spec, registry, stop));
    let status = match std::panic::catch_unwind(run) {
        Ok(Ok(status)) => status,
        Ok(Err(error)) => {
            error.chain().skip(1).for_each(|cause| tracing::debug!("caused by: {cause}"));
            JobStatus::Failed(failure::of_error(&error))
        }
        Err(payload) => JobStatus::Failed(failure::of_panic(payload.as_ref())),
    };
    log_end(&status);
    Store::open(&spec.store)?.write_over(&spec.dir.join("status.json"), &serde_json::to_vec_pretty(&status)?)?;
    Ok(match status {
        JobStatus::Published { .. } => exit::OK,
        JobStatus::Failed(failure) if failure.kind == FailureKind::Interrupted => exit::CHECKPOINTED,
        JobStatus::Failed(_) => exit::FAILED,
    })
}

/// Logs the end of the job in words.
fn log_end(status: &JobStatus) {
    match status {
        JobStatus::Published { content, note, .. } => {
            tracing::info!(
                "published {}{}",
                content.short(),
                note.iter().map(|note| format!(" ({note})")).collect::<String>()
            );
        }
        JobStatus::Failed(failure) if failure.kind == FailureKind::Interrupted => tracing::info!("{failure}"),
        JobStatus::Failed(failure) => tracing::error!("failed ({}): {failure}", failure.kind.words()),
    }
}

fn run_and_publish(spec: &JobSpec, registry: &Registry, stop: Arc<AtomicBool>) -> anyhow::Result<JobStatus> {
    let store = Store::open(&spec.store)?;
    // Held until the end, so that no other process removes the scratch folder.
    let _in_use = store.lock_shared()?;
    let key = ActionKey::new(&spec.components);
    let scratch = store.scratch("job").context("cannot create a scratch folder")?;
    let context = job_context(spec, &store, &key, scratch.path(), stop)?;
    let stage = registry.get(&spec.components.stage);
    let stage = stage.with_context(|| format!("this program has no stage {}", spec.components.stage))?;
    check_code(spec, registry, stage)?;

    // The remaining time of an interrupted job is not the time of the whole job.
    let work = spec.work.clone().filter(|_| !store.has_checkpoint(&key));
    let (started_at, clock) = (SystemTime::now(), Instant::now());
    stage.run(&context, &spec.components.params)?;
    let wall_secs = clock.elapsed().as_secs_f64();

    let peak_rss_bytes = peak_rss_bytes();
    let mut measurements = context.measurements.take();
    measurements.insert("job".into(), json!({ "wall_secs": wall_secs, "peak_rss_bytes": peak_rss_bytes }));
    measurements.insert("machine".into(), machine::card(registry));
    let publication = store.publish(&context.output_dir, &Value::Object(measurements))?;
    let provenance = Provenance {
        recipe: spec.recipe.clone(),
        node: spec.node.clone(),
        plan_id: spec.plan_id.clone(),
        run: spec.run.clone(),
        device: spec.device_of_run,
        host: crate::process::host_name(),
        threads: spec.threads,
        work,
        started_at_secs: started_at.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64(),
        wall_secs,
        peak_rss_bytes,
        checkpoint_secs: context.checkpoint_secs.get(),
    };
    let status = commit(spec, &store, &key, &publication, provenance)?;
    match fs::remove_dir_all(&context.checkpoint_dir) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error).context("cannot remove checkpoints"),
        _ => Ok(status),
    }
}

/// Refuses to run if the code differs from the key's: the program may have been rebuilt since the plan was made.
fn check_code(spec: &JobSpec, registry: &Registry, stage: &dyn AnyStage) -> anyhow::Result<()> {
    if registry.code(stage.id(), &spec.unused_sources) == spec.components.code {
        return Ok(());
    }
    let changed = Failure::new(FailureKind::World, "the pipeline binary was rebuilt during this run");
    Err(changed.hint("run again").into())
}

/// Writes the action record, unless a source changed during the job or another process's record was first.
fn commit(
    spec: &JobSpec,
    store: &Store,
    key: &ActionKey,
    publication: &Publication,
    provenance: Provenance,
) -> anyhow::Result<JobStatus> {
    let Publication { content, measurements, .. } = *publication;
    for source in spec.sources.values() {
        if SourceDigests::stat_digest(&source.path).ok() != Some(source.stat) {
            let note = format!("not recorded: the source changed while the job ran: {}", source.path.display());
            return Ok(JobStatus::Published { content, measurements, note: Some(note) });
        }
    }
    if spec.replace && !matches!(store.lookup(key), Lookup::Hit(first) if first.provenance.run == spec.run) {
        store.retire_record(key)?;
    }
    let record = ActionRecord::new(spec.components.clone(), provenance, publication);
    if store.put_record(&record)? {
        store.clear_failure(key);
        return Ok(JobStatus::Published { content, measurements, note: None });
    }
    match store.lookup(key) {
        Lookup::Hit(first) => Ok(JobStatus::Published {
            content: first.content,
            measurements: first.measurements,
            note: (first.content != content)
                .then(|| "another run finished first with a different result; the first one is kept".into()),
        }),
        _ => anyhow::bail!("the store has an unusable record of this job; run again"),
    }
}

fn job_context(
    spec: &JobSpec,
    store: &Store,
    key: &ActionKey,
    scratch: &Path,
    stop: Arc<AtomicBool>,
) -> anyhow::Result<JobContext> {
    let output_dir = scratch.join("output");
    let checkpoint_dir = store.checkpoint_dir(key.as_str());
    for dir in [&output_dir, &checkpoint_dir] {
        fs::create_dir_all(dir).with_context(|| format!("cannot make {}", dir.display()))?;
    }
    let mut inputs = BTreeMap::new();
    for (port, producers) in &spec.inputs {
        let records: anyhow::Result<_> = producers.iter().map(|input| input_record(store, input)).collect();
        inputs.insert(port.clone(), records.with_context(|| format!("cannot read what port {port} reads"))?);
    }
    let sources = spec.sources.iter().map(|(name, source)| (name.clone(), source.path.clone())).collect();
    Ok(JobContext {
        name: spec.node.clone(),
        threads: spec.threads,
        device: spec.device.clone(),
        profile: spec.profile,
        pause_at: spec.pause_at,
        inputs,
        sources,
        output_dir,
        checkpoint_dir,
        stop,
        on_progress: Box::new(progress_printer()),
        measurements: Default::default(),
        checkpoint_secs: Default::default(),
    })
}

fn input_record(store: &Store, input: &InputSpec) -> anyhow::Result<InputRecord> {
    let artifact: Result<PathBuf, _> = match &input.artifact {
        Ok(content) => Ok(store.view(content)?),
        Err(failure) => Err(failure.clone()),
    };
    let measurements = input.measurements.map(|digest| store.read_measurements(&digest)).transpose()?;
    Ok(InputRecord {
        producer: input.producer.clone(),
        coordinates: input.coordinates.clone(),
        artifact,
        measurements: measurements.unwrap_or(Value::Null),
        action_key: input.action_key.clone(),
    })
}

/// Writes progress as JSON lines to standard output and, more rarely, to the log; the last step is always written.
fn progress_printer() -> impl Fn(Progress) + Send + Sync {
    let last: Mutex<[Option<Instant>; 2]> = Mutex::default();
    move |progress| {
        let [printed, logged] = &mut *last.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let is_last = progress.done >= progress.total;
        let is_due = |last: &mut Option<Instant>, interval| {
            let due = is_last || last.is_none_or(|time| time.elapsed() >= interval);
            *last = if due { Some(Instant::now()) } else { *last };
            due
        };
        if is_due(logged, LOG_INTERVAL) {
            tracing::info!("step {}/{}: {}", progress.done, progress.total, progress.message);
        }
        if !is_due(printed, PROGRESS_INTERVAL) {
            return;
        }
        if let Ok(line) = serde_json::to_string(&Line::Progress(progress)) {
            // Fails if the scheduler is gone; the job continues.
            let _ = writeln!(io::stdout().lock(), "{line}");
        }
    }
}

/// Sets the stop flag when the scheduler dies, and ends the process if it still runs after [`ORPHAN_GRACE`].
fn stop_with_parent(parent_pid: u32, stop: &Arc<AtomicBool>) -> anyhow::Result<()> {
    #[cfg(target_os = "linux")]
    rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))?;
    let stop = Arc::clone(stop);
    let orphaned = move || std::os::unix::process::parent_id() != parent_pid;
    let watch = move || {
        while !orphaned() {
            std::thread::sleep(Duration::from_millis(500));
        }
        stop.store(true, Ordering::Relaxed);
        std::thread::sleep(ORPHAN_GRACE);
        std::process::exit(exit::CHECKPOINTED.into());
    };
    std::thread::Builder::new().name("parent watch".into()).spawn(watch).context("cannot start a thread")?;
    Ok(())
}

/// Logs panics with a backtrace, in addition to the message on standard error.
fn log_panics() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        tracing::error!("{info}\n{}", std::backtrace::Backtrace::force_capture());
        usual(info);
    }));
}

/// The peak resident memory of this process in bytes; `None` on systems without `/proc`.
fn peak_rss_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let kibibytes = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix("kB")?;
    Some(kibibytes.trim().parse::<u64>().ok()? * 1024)
}
