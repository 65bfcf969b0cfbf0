//! Waves: the jobs that are submitted together. The last job of a wave submits the next one for cells that ended
//! without a result.

use std::collections::BTreeSet;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::Context;
use engine::{Failure, FailureKind, Plan, Store};
use fs_err as fs;
use serde::{Deserialize, Serialize};

use crate::batches::{After, Batch, batches};
use crate::cells::{Cells, Class};
use crate::file::ClusterFile;
use crate::needs::Needs;
use crate::run_file::read_json;
use crate::slurm;

/// The options of a run on a cluster, in addition to those of every shared run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Site {
    /// The cluster file.
    pub cluster: ClusterFile,
    /// The program, at a path that all machines see.
    pub program: PathBuf,
    /// The id of the stage whose jobs define cells.
    pub training: String,
    /// The number of pilots; none if every cell is a separate job.
    pub pilots: Option<usize>,
    /// The arguments with which pilots take part in a search, whose jobs are not known beforehand; none for a plan.
    #[serde(default)]
    pub search: Option<Vec<String>>,
    /// The largest number of elements of an array.
    pub max_array: usize,
}

/// A shared run on a cluster.
#[derive(Debug)]
pub struct ClusterRun<'a> {
    /// The store.
    pub store: &'a Store,
    /// The run's name.
    pub run: String,
    /// The plan.
    pub plan: &'a Plan,
    /// The options.
    pub site: Site,
}

/// What was submitted together.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Wave {
    /// The number, from 1.
    pub number: usize,
    /// The cells and collecting jobs without a result.
    pub cells: Cells,
    /// The arrays of cells; empty with pilots.
    pub batches: Vec<Batch>,
    /// The ids of the arrays, and of the array of pilots.
    pub jobs: Vec<u64>,
    /// The id of the last job, which collects results.
    pub report: Option<u64>,
    /// Nodes that are avoided because jobs vanished on them.
    pub excluded: BTreeSet<String>,
}

impl Wave {
    /// The ids of all jobs of the wave, the last job last.
    pub fn all_jobs(&self) -> Vec<u64> {
        self.jobs.iter().chain(&self.report).copied().collect()
    }
}

impl<'a> ClusterRun<'a> {
    /// Reads the options of a run that was submitted before.
    pub fn read(store: &'a Store, run: &str, plan: &'a Plan) -> anyhow::Result<Self> {
        let site = read_json(&folder(store, run).join("site.json"))?;
        Ok(Self { store, run: run.into(), plan, site })
    }

    /// Whether a run was submitted to a cluster.
    pub fn exists(store: &Store, run: &str) -> bool {
        folder(store, run).join("site.json").exists()
    }

    /// Writes the options, before the first wave.
    pub fn create(&self) -> anyhow::Result<()> {
        fs::create_dir_all(self.folder())?;
        Ok(fs::write(self.folder().join("site.json"), serde_json::to_vec_pretty(&self.site)?)?)
    }

    /// The folder with scripts, waves and logs.
    pub fn folder(&self) -> PathBuf {
        folder(self.store, &self.run)
    }

    /// The wave with this number.
    pub fn wave(&self, number: usize) -> anyhow::Result<Wave> {
        read_json(&self.wave_file(number))
    }

    /// The newest wave, if anything was submitted. A damaged file counts as a wave without jobs.
    pub fn newest_wave(&self) -> anyhow::Result<Option<Wave>> {
        let newest = self.wave_numbers()?.last().copied();
        Ok(newest.map(|number| self.wave(number).unwrap_or_else(|_| Wave { number, ..Wave::default() })))
    }

    /// The ids of all known jobs of the run, without those of damaged waves.
    pub fn jobs(&self) -> anyhow::Result<Vec<u64>> {
        let waves = self.wave_numbers()?.into_iter().filter_map(|number| self.wave(number).ok());
        Ok(waves.flat_map(|wave| wave.all_jobs()).collect())
    }

    /// The files of waves that cannot be read, whose jobs are therefore unknown.
    pub fn damaged_waves(&self) -> anyhow::Result<Vec<PathBuf>> {
        let damaged = self.wave_numbers()?.into_iter().filter(|number| self.wave(*number).is_err());
        Ok(damaged.map(|number| self.wave_file(number)).collect())
    }

    /// The numbers of the waves that were submitted.
    fn wave_numbers(&self) -> anyhow::Result<BTreeSet<usize>> {
        let mut numbers = BTreeSet::new();
        for entry in fs::read_dir(self.folder())? {
            let name = entry?.file_name().to_string_lossy().into_owned();
            let number = name.strip_prefix("wave-").and_then(|rest| rest.strip_suffix(".json"));
            numbers.extend(number.and_then(|number| number.parse::<usize>().ok()));
        }
        Ok(numbers)
    }

    fn wave_file(&self, number: usize) -> PathBuf {
        self.folder().join(format!("wave-{number}.json"))
    }

    /// Submits `nodes`, which have no result yet. Returns `None` if another process has submitted a wave of this number.
    ///
    /// # Errors
    ///
    /// If Slurm refuses one of the jobs, those before it are cancelled, and the wave counts as not submitted. The error names
    /// the run.
    pub fn submit(&self, number: usize, nodes: &BTreeSet<usize>) -> anyhow::Result<Option<Wave>> {
        let cells = self.cells(nodes);
        let all = (0..cells.cells.len()).collect();
        let batches =
            if self.site.pilots.is_some() { Vec::new() } else { batches(&cells.cells, &all, self.site.max_array) };
        let excluded = self.suspects(number)?;
        let needs = Needs::read(self.store)?;
        let mut wave = Wave { number, cells, batches, excluded, ..Wave::default() };
        if !self.publish(&wave)? {
            return Ok(None);
        }
        match self.submit_jobs(&mut wave, &needs) {
            Ok(()) => Ok(Some(wave)),
            Err(error) => Err(self.undo(&wave, &error).into()),
        }
    }

    /// Those of `nodes` that have to run, as cells and collecting jobs.
    pub(crate) fn cells(&self, nodes: &BTreeSet<usize>) -> Cells {
        Cells::of(self.plan, nodes, |node| node.stage == self.site.training)
    }

    fn submit_jobs(&self, wave: &mut Wave, needs: &Needs) -> anyhow::Result<()> {
        match self.site.pilots {
            Some(count) => self.submit_pilots(wave, needs, count)?,
            None => self.submit_batches(wave, needs)?,
        }
        self.submit_report(wave, needs)
    }

    /// Cancels the jobs of a wave whose submission failed with `error`, and removes the wave, so that a process that
    /// follows the run can submit it again. The wave stays if its jobs cannot be cancelled. Returns the error to report.
    fn undo(&self, wave: &Wave, error: &anyhow::Error) -> Failure {
        let (run, number, jobs) = (&self.run, wave.number, wave.all_jobs());
        let cancelled = if jobs.is_empty() { Ok(()) } else { slurm::cancel(&jobs) };
        let undone = cancelled.and_then(|()| Ok(fs::remove_file(self.wave_file(number))?));
        let (state, advice) = match undone {
            Ok(()) => {
                ("cancelled".into(), format!("submit it again with `pipeline attach {run}`, or end the run with"))
            }
            Err(left) => (format!("not cancelled ({left:#})"), "cancel them with".into()),
        };
        let of_jobs = engine::count(jobs.len(), "batch job");
        let message = format!("run {run}: wave {number} was not submitted ({of_jobs} {state}): {error:#}");
        Failure::new(FailureKind::World, message).hint(format!("{advice} `pipeline cancel {run}`"))
    }

    fn submit_batches(&self, wave: &mut Wave, needs: &Needs) -> anyhow::Result<()> {
        for (at, batch) in wave.batches.clone().into_iter().enumerate() {
            let cells: Vec<&BTreeSet<usize>> =
                batch.elements.values().map(|cell| &wave.cells.cells[*cell].nodes).collect();
            let mut options = self.options(wave, batch.class, &format!("{at}-%a"));
            let numbers: Vec<String> = batch.elements.keys().map(u32::to_string).collect();
            options.push(format!("--array={}%{}", numbers.join(","), self.site.cluster.throttle));
            options.extend(dependency(&batch.after, &wave.jobs).map(|text| format!("--dependency={text}")));
            options.extend(self.limits(batch.class, &cells, needs, wave.number));
            let command = format!("--batch {at}");
            let id = self.send(wave, &format!("{at}"), batch.class, &command, &options)?;
            wave.jobs.push(id);
            self.write(wave)?;
        }
        Ok(())
    }

    fn submit_pilots(&self, wave: &mut Wave, needs: &Needs, count: usize) -> anyhow::Result<()> {
        let class = wave.cells.cells.iter().map(|cell| cell.class).max().unwrap_or(Class::Cpu);
        let nodes: Vec<&BTreeSet<usize>> = wave.cells.cells.iter().map(|cell| &cell.nodes).collect();
        let mut options = self.options(wave, class, "pilot-%a");
        options.push(format!("--array=1-{count}%{}", self.site.cluster.throttle));
        options.extend(self.limits(class, &nodes, needs, wave.number));
        let part = format!("\"$SLURM_ARRAY_TASK_ID/{count}\"");
        let command = match self.site.search {
            Some(_) => format!("--search-part {part}"),
            None => format!("--part {part} --idle 60s"),
        };
        let id = self.send(wave, "pilots", class, &command, &options)?;
        wave.jobs.push(id);
        self.write(wave)
    }

    /// The job that runs after all others, whatever their outcomes.
    fn submit_report(&self, wave: &mut Wave, needs: &Needs) -> anyhow::Result<()> {
        let mut options = self.options(wave, Class::Report, "report");
        let after: Vec<String> = wave.jobs.iter().map(u64::to_string).collect();
        options.extend((!after.is_empty()).then(|| format!("--dependency=afterany:{}", after.join(":"))));
        options.extend(self.limits(Class::Report, &[], needs, wave.number));
        let command = if self.site.search.is_some() { "--search-report" } else { "--report" };
        wave.report = Some(self.send(wave, "report", Class::Report, command, &options)?);
        self.write(wave)
    }

    /// The options of every job of a class; `log` names its log.
    fn options(&self, wave: &Wave, class: Class, log: &str) -> Vec<String> {
        let of_class = self.site.cluster.class(class);
        let number = wave.number;
        // Slurm replaces e.g. %j in the whole path.
        let folder = self.folder().display().to_string().replace('%', "%%");
        let mut options = vec![
            format!("--job-name={}-{}", self.plan.recipe, word(class)),
            format!("--comment={}", self.run),
            format!("--output={folder}/wave-{number}-{log}.log"),
            "--open-mode=append".into(),
            "--requeue".into(),
            "--kill-on-invalid-dep=yes".into(),
        ];
        let named = [("partition", of_class.partition), ("account", of_class.account), ("qos", of_class.qos)];
        options.extend(named.into_iter().filter_map(|(name, value)| Some(format!("--{name}={}", value?))));
        options.extend(of_class.cpus.map(|cpus| format!("--cpus-per-task={cpus}")));
        options.extend(of_class.gres.map(|gres| format!("--gres={gres}")));
        let excluded: Vec<&str> = wave.excluded.iter().map(String::as_str).collect();
        options.extend((!excluded.is_empty()).then(|| format!("--exclude={}", excluded.join(","))));
        options.extend(of_class.extra);
        options
    }

    /// The limits of time and memory, and the lead of the signal: those of the cluster file, or those that measurements
    /// suggest.
    fn limits(&self, class: Class, cells: &[&BTreeSet<usize>], needs: &Needs, attempt: usize) -> Vec<String> {
        let of_class = self.site.cluster.class(class);
        let predicted = || if cells.is_empty() { None } else { needs.time(self.plan, cells, attempt) };
        let minutes = of_class.time.or_else(predicted).map(|time| time.as_secs().div_ceil(60).max(1));
        let nodes = || cells.iter().flat_map(|nodes| nodes.iter().copied());
        let memory = of_class.memory.or_else(|| needs.memory(self.plan, nodes()));
        let limit = minutes.map(|minutes| Duration::from_secs(60 * minutes));
        let lead = self.site.cluster.signal_lead.unwrap_or_else(|| needs.signal_lead(self.plan, nodes(), limit));
        let texts = [
            Some(format!("--signal=B:USR1@{}", lead.as_secs().max(1))),
            minutes.map(|minutes| format!("--time={minutes}")),
            memory.map(|text| format!("--mem={text}")),
        ];
        texts.into_iter().flatten().collect()
    }

    /// Writes the script of a job and submits it.
    fn send(&self, wave: &Wave, name: &str, class: Class, command: &str, options: &[String]) -> anyhow::Result<u64> {
        let number = wave.number;
        let path = self.folder().join(format!("wave-{number}-{name}.sh"));
        let mut script = format!("#!/bin/bash\n# {} jobs of run {}\n", word(class), self.run);
        self.site.cluster.prologue.iter().for_each(|line| script += &format!("{line}\n"));
        // `exec`: the program itself must receive Slurm's signals.
        let role = match &self.site.search {
            Some(arguments) => {
                let arguments: Vec<String> = arguments.iter().map(|text| quoted(text)).collect();
                format!("{} --search-run {} --search-wave {number}", arguments.join(" "), self.run)
            }
            None => format!("worker {} --wave {number}", self.run),
        };
        let [program, store] =
            [self.site.program.as_path(), self.store.root()].map(|path| quoted(&path.display().to_string()));
        script += &format!("exec {program} --store {store} {role} {command}\n");
        fs::write(&path, script)?;
        slurm::submit(options, &path).with_context(|| format!("cannot submit {}", path.display()))
    }

    /// Writes a new wave under its name. Returns false if there is a wave of this number.
    fn publish(&self, wave: &Wave) -> anyhow::Result<bool> {
        let path = self.wave_file(wave.number);
        // Other users of the store may follow the run; the umask applies to these permissions.
        let readable = std::fs::Permissions::from_mode(0o666);
        let mut file = tempfile::Builder::new().permissions(readable).tempfile_in(self.folder())?;
        file.write_all(&serde_json::to_vec_pretty(wave)?)?;
        match file.persist_noclobber(&path) {
            Ok(_) => Ok(true),
            Err(refused) if refused.error.kind() == ErrorKind::AlreadyExists => Ok(false),
            Err(refused) => Err(refused.error).with_context(|| format!("cannot write {}", path.display())),
        }
    }

    fn write(&self, wave: &Wave) -> anyhow::Result<()> {
        let path = self.wave_file(wave.number);
        let new = path.with_extension("new");
        fs::write(&new, serde_json::to_vec_pretty(wave)?)?;
        Ok(fs::rename(new, path)?)
    }

    /// The nodes on which at least two jobs of earlier waves vanished without an end record, unless no node would be
    /// left.
    fn suspects(&self, number: usize) -> anyhow::Result<BTreeSet<String>> {
        let suspects = crate::attendance::suspects(&self.folder(), number)?;
        if suspects.is_empty() {
            return Ok(suspects);
        }
        let others = slurm::nodes()?.iter().any(|node| !suspects.contains(node));
        Ok(if others { suspects } else { BTreeSet::new() })
    }
}

/// A dependency as Slurm writes it; `jobs` are the ids of earlier batches.
fn dependency(after: &After, jobs: &[u64]) -> Option<String> {
    match after {
        After::Nothing => None,
        After::Corresponding(batch) => Some(format!("aftercorr:{}", jobs[*batch])),
        After::Elements(elements) => {
            let elements: Vec<String> =
                elements.iter().map(|(batch, number)| format!("{}_{number}", jobs[*batch])).collect();
            Some(format!("afterok:{}", elements.join(":")))
        }
    }
}

/// A word of a shell.
fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}

fn word(class: Class) -> &'static str {
    match class {
        Class::Prepare => "prepare",
        Class::Cpu => "cpu",
        Class::Gpu => "gpu",
        Class::Report => "report",
    }
}

fn folder(store: &Store, run: &str) -> PathBuf {
    store.run_dir(run).join("slurm")
}

#[cfg(test)]
#[path = "wave_tests.rs"]
mod tests;
