//! Steps with cached results: a step runs only if its inputs, its commands or its tool have changed, if an output is
//! missing, or if the user forces it. Changed outputs are kept.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use engine::lock;

use crate::digest;
use crate::error::{Result, bad, io};
use crate::event::Event;
use crate::manifest::{Manifest, Record};
use crate::process;
use crate::request::Request;

/// Folder of logs, databases and unfinished results in the capture; readers of captures skip hidden folders.
pub(crate) const WORK: &str = ".prepare";

/// The inputs and outputs of a step.
pub(crate) struct Step<'a> {
    /// The name.
    pub(crate) name: &'a str,
    /// Command lines as the user would type them in the folder of the capture: the first, then those that the step runs in
    /// addition if the result is poor.
    pub(crate) commands: Vec<String>,
    /// The tool's version, or the reason why the tool cannot be used.
    pub(crate) tool: Result<String>,
    /// Inputs by name: paths, relative to the capture or absolute.
    pub(crate) inputs: Vec<(&'a str, PathBuf)>,
    /// Outputs, relative to the capture.
    pub(crate) outputs: Vec<&'a str>,
}

/// The steps of one capture.
pub(crate) struct Steps<'a> {
    /// The folder of the capture.
    pub(crate) dir: PathBuf,
    /// Names of the steps that ran.
    pub(crate) executed: Vec<String>,
    manifest: Manifest,
    force: BTreeSet<String>,
    report: &'a mut dyn FnMut(&Event),
    /// Held until the end, so that two runs do not write the same files.
    _lock: File,
}

impl<'a> Steps<'a> {
    /// Creates the folder of the capture if it is missing, locks it, and reads the manifest of an earlier run.
    pub(crate) fn open(request: &Request, report: &'a mut dyn FnMut(&Event)) -> Result<Self> {
        let work = request.out.join(WORK);
        std::fs::create_dir_all(work.join("logs")).map_err(|error| io(&error, &work))?;
        let dir = request.out.canonicalize().map_err(|error| io(&error, &request.out))?;
        let lock = lock::open(&work.join("lock")).map_err(|error| io(&error, &work))?;
        if !lock::try_exclusive(&lock).map_err(|error| io(&error, &work))? {
            return Err(bad("another `pipeline prepare` is at work in this folder").at(&dir));
        }
        let manifest = Manifest::read(&dir)?;
        let force = request.force.iter().cloned().collect();
        Ok(Self { dir, executed: Vec::new(), manifest, force, report, _lock: lock })
    }

    /// Runs a step unless its result is kept. `make` writes the outputs and returns further command lines that it ran
    /// and the result in words.
    pub(crate) fn run(
        &mut self,
        step: Step<'_>,
        make: impl FnOnce(&mut Self) -> Result<(Vec<String>, String)>,
    ) -> Result<()> {
        let inputs = self.digests(&step.inputs)?;
        let kept = self.manifest.steps.get(step.name).cloned();
        // A tool that is missing now does not invalidate its earlier results.
        let tool = match (&step.tool, &kept) {
            (Err(_), Some(record)) => record.tool.clone(),
            (tool, _) => tool.clone().unwrap_or_default(),
        };
        let key = |commands: &[String]| {
            digest::of_text(&format!("{}\n{}\n{tool}\n{inputs:?}", step.name, commands.join("\n")))
        };
        let first = step.commands[0].clone();
        let is_current = |record: &Record| {
            let ran = &record.commands;
            !ran.is_empty() && step.commands.starts_with(ran) && record.key == key(ran)
        };
        if let Some(record) = kept.filter(|record| is_current(record) && !self.force.contains(step.name))
            && self.keeps(&step, record)?
        {
            return Ok(());
        }
        step.tool?;
        self.own(&step.outputs)?;
        let clock = Instant::now();
        (self.report)(&Event::Started { step: step.name.into(), command: first.clone() });
        let (more, summary) = make(self)?;
        let secs = clock.elapsed().as_secs_f64();
        let hash = |path: &&str| Ok(((*path).to_owned(), digest::of_path(&self.dir.join(path))?.unwrap_or_default()));
        let outputs = step.outputs.iter().map(hash).collect::<Result<BTreeMap<_, _>>>()?;
        let commands = [vec![first], more].concat();
        let record = Record { key: key(&commands), commands, tool, inputs, outputs, summary: summary.clone(), secs };
        self.manifest.steps.insert(step.name.into(), record);
        self.manifest.write(&self.dir)?;
        self.executed.push(step.name.into());
        (self.report)(&Event::Finished { step: step.name.into(), summary, secs });
        Ok(())
    }

    /// Reports something that the user should know.
    pub(crate) fn note(&mut self, text: impl Into<String>) {
        (self.report)(&Event::Note(text.into()));
    }

    /// Runs a command in the folder of the capture; `progress` finds the units that are done, and all, in its log.
    pub(crate) fn execute(
        &mut self,
        name: &str,
        mut command: Command,
        progress: &dyn Fn(&str) -> Option<(u64, u64)>,
    ) -> Result<String> {
        command.current_dir(&self.dir);
        let log = self.dir.join(WORK).join("logs").join(format!("{name}.log"));
        let report = &mut self.report;
        process::run(command, &log, &mut |text| {
            if let Some((done, total)) = progress(text) {
                report(&Event::Progress { done, total });
            }
        })?;
        Ok(process::text(&log))
    }

    /// A new, empty folder for an unfinished result, relative to the capture.
    pub(crate) fn scratch(&self, name: &str) -> Result<PathBuf> {
        let path = self.dir.join(WORK).join(unfinished(name));
        remove(&path)?;
        std::fs::create_dir_all(&path).map_err(|error| io(&error, &path))?;
        Ok(path)
    }

    /// Puts a finished result in its place, relative to the capture.
    pub(crate) fn publish(&self, from: &Path, to: &str) -> Result<()> {
        let to = self.dir.join(to);
        remove(&to)?;
        let parent = to.parent().unwrap_or(&self.dir);
        std::fs::create_dir_all(parent).map_err(|error| io(&error, parent))?;
        std::fs::rename(from, &to).map_err(|error| io(&error, &to))
    }

    /// Writes the data for `inspect --recipe`: the rate of the frames, and parameters of the importers by table.
    pub(crate) fn finish(&mut self, fps: Option<f64>, imports: BTreeMap<String, toml::Table>) -> Result<()> {
        self.manifest.fps = fps;
        self.manifest.import.extend(imports);
        self.manifest.write(&self.dir)
    }

    /// The hashes of inputs; a missing one counts as empty.
    fn digests(&self, inputs: &[(&str, PathBuf)]) -> Result<BTreeMap<String, String>> {
        let hash = |(name, path): &(&str, PathBuf)| {
            Ok(((*name).to_owned(), digest::of_path(&self.dir.join(path))?.unwrap_or_default()))
        };
        inputs.iter().map(hash).collect()
    }

    /// Whether the outputs of a step still exist; if so, reports that they are kept. Changed outputs are kept, too:
    /// they may be manual corrections.
    fn keeps(&mut self, step: &Step<'_>, record: Record) -> Result<bool> {
        for path in &step.outputs {
            let Some(hash) = digest::of_path(&self.dir.join(path))? else { return Ok(false) };
            if record.outputs.get(*path) != Some(&hash) {
                let name = step.name;
                self.note(format!(
                    "{path} was changed after step {name} made it, and is kept; --force {name} replaces it"
                ));
            }
        }
        (self.report)(&Event::Kept { step: step.name.into(), summary: record.summary });
        Ok(true)
    }

    /// Claims outputs before they are written. Refuses to replace files that no step created.
    fn own(&mut self, outputs: &[&str]) -> Result<()> {
        for path in outputs.iter().filter(|path| !path.starts_with(WORK)) {
            if self.dir.join(path).exists() && !self.manifest.owned.contains(*path) {
                let failure = bad("this would be replaced, but `pipeline prepare` did not create it");
                return Err(failure.hint("name another folder with --out, or move it away").at(self.dir.join(path)));
            }
            self.manifest.owned.insert((*path).to_owned());
        }
        self.manifest.write(&self.dir)
    }
}

/// The folder of an unfinished result in the folder of work.
pub(crate) fn unfinished(name: &str) -> String {
    format!("{name}.partial")
}

/// Removes a file or folder if it exists.
pub(crate) fn remove(path: &Path) -> Result<()> {
    let removed =
        if path.is_dir() && !path.is_symlink() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    match removed {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(io(&error, path)),
        _ => Ok(()),
    }
}
