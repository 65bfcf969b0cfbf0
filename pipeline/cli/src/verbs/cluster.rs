//! Runs on a cluster: `run --on slurm`, `cancel`, and the batch jobs themselves.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use ::cluster::{ClusterFile, ClusterRun, Process, Role, RunFile, Site, Wave, keep_program, probe_file_system, slurm};
use anyhow::Context;
use engine::event::Event;
use engine::scheduler::{self, RunSummary};
use engine::{DeviceClass, Plan, Store, exit};

use super::cache::existing;
use super::workers::run_file;
use crate::args::{AUTO, RecipeArgs, RunArgs};
use crate::error::CliError;
use crate::output::{count, note};
use crate::session::{Session, TRAINING};

/// The size of arrays if Slurm does not report its limit.
const MAX_ARRAY: usize = 1000;

/// Submits the jobs of `session` that have to run. Returns the run's name; none if no job has to run.
pub(super) fn submit(session: &Session, args: &RunArgs, recipe: &RecipeArgs) -> Result<Option<String>, CliError> {
    let predictions = session.predict()?;
    let nodes: BTreeSet<usize> = predictions.iter().filter(|(_, job)| job.may_run()).map(|(&index, _)| index).collect();
    if nodes.is_empty() {
        return Ok(None);
    }
    let computes = nodes.iter().any(|index| session.plan.nodes[*index].on_device);
    if computes && recipe.with.device == AUTO && session.plan.device == DeviceClass::Cpu {
        note("this machine has no hardware GPU, so the jobs are planned for CPUs; --device gpu plans them for GPUs");
    }
    submit_nodes(session, (args, recipe), &nodes, None).map(Some)
}

/// Submits pilots that take part in a search with these arguments; `trained` are the trainings of one trial. Returns the run's
/// name.
pub(super) fn submit_search(
    session: &Session,
    args: &RunArgs,
    arguments: Vec<String>,
    trained: &BTreeSet<usize>,
) -> Result<String, CliError> {
    submit_nodes(session, (args, &args.recipe), trained, Some(arguments))
}

fn submit_nodes(
    session: &Session,
    (args, recipe): (&RunArgs, &RecipeArgs),
    nodes: &BTreeSet<usize>,
    search: Option<Vec<String>>,
) -> Result<String, CliError> {
    let cluster = args.cluster.as_deref().map(ClusterFile::read).transpose()?.unwrap_or_default();
    let root = session.store.root();
    probe_file_system(root).with_context(|| format!("{} cannot be shared among machines", root.display()))?;
    // Slurm numbers elements below this value.
    let max_array = slurm::config("MaxArraySize")?.and_then(|text| text.parse::<usize>().ok());
    let site = Site {
        cluster,
        program: keep_program(&session.store)?,
        training: TRAINING.into(),
        pilots: args.workers,
        search,
        max_array: max_array.map_or(MAX_ARRAY, |size| size.saturating_sub(1).max(1)),
    };
    let run = scheduler::begin(&session.plan, &session.store)?;
    run_file(session, args, recipe)?.write(&session.store, &run)?;
    let cluster_run = ClusterRun { store: &session.store, run: run.clone(), plan: &session.plan, site };
    cluster_run.create()?;
    if let Some(wave) = cluster_run.submit(1, nodes)? {
        let arrays = count(wave.jobs.len(), "array");
        let work = match (&cluster_run.site.search, cluster_run.site.pilots) {
            (Some(_), Some(pilots)) => format!("{} of a search", count(pilots, "pilot")),
            _ => count(wave.cells.cells.len(), "cell"),
        };
        note(&format!("run {run}: submitted {work} in {arrays}; logs in {}", cluster_run.folder().display()));
        note(&format!("follow with `pipeline attach {run}`, stop with `pipeline cancel {run}`"));
    }
    Ok(run)
}

/// Follows a run on a cluster to its end, and returns its summary.
pub(super) fn follow(
    (store, plan): (&Store, &Plan),
    run: &str,
    process: &Process,
    watch: &mut dyn FnMut(&Event),
) -> anyhow::Result<RunSummary> {
    let (file, _) = RunFile::read(store, run)?;
    let cluster_run = ClusterRun::read(store, run, plan)?;
    let summary = cluster_run.follow(&file, process, watch)?;
    cluster_run.newest_wave()?.and_then(|wave| excluded(&wave)).into_iter().for_each(|text| note(&text));
    if summary.stopped_by.is_some() {
        note(&format!(
            "the batch jobs continue; `pipeline attach {run}` follows them, `pipeline cancel {run}` stops them"
        ));
    }
    Ok(summary)
}

/// Opens a store for writing; a missing one is an error and is not created.
pub(super) fn existing_store(path: &Path) -> Result<Store, CliError> {
    existing(path)?;
    Ok(Store::open(path)?)
}

/// `cancel`: cancels the batch jobs of a run.
pub(crate) fn cancel(store: &Path, run: Option<&str>) -> Result<u8, CliError> {
    let store = existing_store(store)?;
    let run = on_cluster(&store, run)?;
    let (_, plan) = RunFile::read(&store, &run)?;
    let cluster_run = ClusterRun::read(&store, &run, &plan)?;
    let jobs = cluster_run.cancel()?;
    let jobs = count(jobs, "batch job");
    note(&format!(
        "run {run}: cancelled {jobs}; running trainings now save their progress, for which Slurm grants KillWait"
    ));
    for wave in cluster_run.damaged_waves()? {
        let path = wave.display();
        note(&format!("{path} is damaged: find its running jobs with `squeue --me -o '%i %k'`, and cancel them"));
    }
    Ok(exit::OK)
}

/// Slurm's states of the newest run of a recipe on a cluster, one line per array; `None` if the run has ended.
pub(super) fn state(store: &Store, recipe: &str) -> anyhow::Result<Option<String>> {
    for run in newest_first(store)? {
        // A run of another version of this program, or one that is being written, may be unreadable.
        if !RunFile::recipe_name(store, &run).is_ok_and(|name| name == recipe) {
            continue;
        }
        let Ok((_, plan)) = RunFile::read(store, &run) else { continue };
        let Ok(cluster_run) = ClusterRun::read(store, &run, &plan) else { continue };
        let wave = cluster_run.newest_wave()?.filter(|_| !cluster_run.has_ended());
        let text = |wave: Wave| {
            let excluded = excluded(&wave).map(|text| format!("             {text}\n")).unwrap_or_default();
            format!("run {run} on Slurm, wave {}\n{}{excluded}", wave.number, arrays(&wave))
        };
        return Ok(wave.map(text));
    }
    Ok(None)
}

/// The states of the arrays of a wave.
fn arrays(wave: &Wave) -> String {
    let ids = wave.all_jobs();
    let Some(states) = slurm::states(&ids) else { return "             Slurm does not answer\n".into() };
    let line = |id: &u64| {
        let words = states.get(id).map(|states| {
            let word = |(state, reason): &(String, String)| match reason.as_str() {
                "None" | "" => state.clone(),
                reason => format!("{state} ({reason})"),
            };
            states.iter().map(word).collect::<Vec<_>>().join(", ")
        });
        format!("             job {id}: {}\n", words.unwrap_or_else(|| "no longer known to Slurm".into()))
    };
    ids.iter().map(line).collect()
}

/// The nodes that a wave avoids; none if it avoids none.
fn excluded(wave: &Wave) -> Option<String> {
    let nodes: Vec<&str> = wave.excluded.iter().map(String::as_str).collect();
    (!nodes.is_empty()).then(|| format!("excluded nodes, because batch jobs vanished there: {}", nodes.join(", ")))
}

/// The run of that name, or the newest run on a cluster.
pub(super) fn on_cluster(store: &Store, name: Option<&str>) -> Result<String, CliError> {
    let submit = "submit one with `pipeline run RECIPE --on slurm`";
    let Some(name) = name else {
        return newest_first(store)?.next().ok_or_else(|| CliError::nothing("no run is on a cluster", submit));
    };
    match (ClusterRun::exists(store, name), store.run_dir(name).exists()) {
        (true, _) => Ok(name.to_owned()),
        (_, true) => {
            let hint = format!("its processes stop with the one that started it: press Ctrl-C there; or {submit}");
            Err(CliError::nothing(format!("run {name} is not on a cluster"), hint))
        }
        _ => Err(CliError::nothing(format!("there is no run {name}"), submit)),
    }
}

/// The names of the runs on a cluster, the newest first.
fn newest_first(store: &Store) -> std::io::Result<impl Iterator<Item = String>> {
    let name = |dir: PathBuf| dir.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let names = engine::runs::run_dirs(store)?.into_iter().rev().map(name);
    Ok(names.filter(|run| ClusterRun::exists(store, run)))
}

/// The work of a batch job of wave `number`; returns its exit code.
pub(super) fn batch_job(
    session: &Session,
    run: &str,
    file: &RunFile,
    process: &Process,
    (number, role): (usize, Role),
    watch: &mut dyn FnMut(&Event),
) -> Result<u8, CliError> {
    let cluster_run = ClusterRun::read(&session.store, run, &session.plan)?;
    Ok(cluster_run.work((file, process), number, role, watch)?)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use clap::Parser;

    use super::*;
    use crate::args::{AttachArgs, Cli, Verb};
    use crate::verbs;

    /// A run of this recipe on a cluster, of which nothing was submitted.
    fn add_run(store: &Store, run: &str, recipe: &str) {
        let plan = serde_json::json!({
            "recipe": recipe, "nodes": [], "origins": {}, "left_out": [], "device": "cpu", "changes": [],
        });
        let file = RunFile {
            recipe: "r.toml".into(),
            data_root: "/data".into(),
            targets: BTreeSet::new(),
            force: BTreeSet::new(),
            device: "cpu".into(),
            profile: false,
            max_failures: None,
            timeout: None,
            log_filter: "info".into(),
            lease: Duration::from_secs(60),
        };
        let site = Site {
            cluster: ClusterFile::default(),
            program: "pipeline".into(),
            training: TRAINING.into(),
            pilots: None,
            search: None,
            max_array: 1,
        };
        std::fs::create_dir_all(store.run_dir(run)).unwrap();
        std::fs::write(store.run_dir(run).join("plan.json"), plan.to_string()).unwrap();
        file.write(store, run).unwrap();
        let plan = serde_json::from_value(plan).unwrap();
        ClusterRun { store, run: run.into(), plan: &plan, site }.create().unwrap();
    }

    #[test]
    fn the_state_of_a_recipe_ignores_damaged_runs() {
        let dir = tempfile::tempdir().unwrap();
        let store = Store::open(dir.path()).unwrap();
        add_run(&store, "1", "mine");
        let wave = serde_json::to_string(&Wave { number: 1, ..Wave::default() }).unwrap();
        std::fs::write(store.run_dir("1").join("slurm/wave-1.json"), wave).unwrap();
        add_run(&store, "2", "other");
        for (run, damaged) in [("2", "plan.json"), ("3", "plan.json"), ("4", "run.json"), ("5", "slurm/site.json")] {
            add_run(&store, run, if run == "2" { "other" } else { "mine" });
            std::fs::write(store.run_dir(run).join(damaged), "{").unwrap();
        }
        assert!(state(&store, "mine").unwrap().unwrap().starts_with("run 1 on Slurm, wave 1"));
        assert_eq!(state(&store, "another").unwrap(), None);
    }

    #[test]
    fn a_mistyped_store_is_refused_and_not_created() {
        let dir = tempfile::tempdir().unwrap();
        let typo = dir.path().join("typo");
        let attach = AttachArgs { run: None, json: false };
        let Verb::Worker(worker) = Cli::parse_from(["pipeline", "worker"]).verb else { panic!("another verb") };
        let refused =
            [cancel(&typo, None), verbs::attach::attach(&typo, &attach), verbs::worker::worker(&typo, &worker)];
        for result in refused {
            assert!(result.unwrap_err().to_string().contains("no store found"));
        }
        assert!(!typo.exists());
    }
}
