//! One line per event, for logs and pipes.

use engine::event::{Counts, Event, NodeResult, Outcome};

use super::{Display, Eta};
use crate::error::CliError;
use crate::output::{count, duration, note};

#[derive(Default)]
pub(crate) struct Lines {
    counts: Counts,
    eta: Eta,
}

impl Display for Lines {
    fn show(&mut self, event: &Event) -> Result<(), CliError> {
        if let Some(line) = self.line(event) {
            note(&line);
        }
        Ok(())
    }
}

impl Lines {
    /// Lines that predict the end of the run with `eta`.
    pub(crate) fn new(eta: Eta) -> Self {
        Self { counts: Counts::default(), eta }
    }

    /// The line for an event; none for events that would flood the log.
    pub(crate) fn line(&mut self, event: &Event) -> Option<String> {
        self.eta.note(event);
        match event {
            Event::Planned { run, recipe, jobs, .. } => {
                self.counts.total = *jobs;
                Some(format!("run {run} of {recipe}: {}", count(*jobs, "job")))
            }
            Event::Started { node, threads, .. } => {
                self.counts.running += 1;
                Some(format!("{} started {node} ({})", self.place(), count(*threads, "thread")))
            }
            Event::Finished { node, result } => {
                self.counts.add(result.outcome);
                if result.wall_secs.is_some() {
                    self.counts.running = self.counts.running.saturating_sub(1);
                }
                finished(node, result).map(|text| format!("{} {text}", self.place()))
            }
            Event::Waiting { node } => Some(format!("{} {node} waits for another process's result", self.place())),
            Event::Heartbeat { counts, running } => {
                let left = self.eta.text().map(|text| format!("; {text}")).unwrap_or_default();
                Some(heartbeat(counts, running) + &left)
            }
            Event::Stopping { message } => Some(format!("stopping: {message}")),
            Event::Warning { message } => Some(format!("warning: {message}")),
            Event::Progress { .. } | Event::RunFinished { .. } => None,
        }
    }

    /// `[12/240]`: finished jobs and all jobs.
    fn place(&self) -> String {
        let finished = self.counts.done() + self.counts.failed + self.counts.missing_data + self.counts.skipped;
        format!("[{finished}/{}]", self.counts.total)
    }
}

/// A job's outcome in words; none for cached jobs, because there may be thousands, and none for jobs without data or
/// without a producer's result, which the summary counts. The summary also has the reasons of failures.
pub(crate) fn finished(node: &str, result: &NodeResult) -> Option<String> {
    let note = result.note.as_ref().map(|note| format!(" ({note})")).unwrap_or_default();
    match result.outcome {
        Outcome::Cached | Outcome::NotRun | Outcome::MissingData | Outcome::Skipped => None,
        Outcome::Executed => Some(format!("done {node} in {}{note}", duration(result.wall_secs.unwrap_or_default()))),
        Outcome::Failed => {
            let kind = result.failure.as_ref().map(|failure| format!(" ({})", failure.kind.words()));
            Some(format!("FAILED {node}{}", kind.unwrap_or_default()))
        }
        Outcome::Interrupted => Some(format!("stopped {node}")),
    }
}

/// `[12/240 done, 3 running, 1 failed] train/lego step 9000/30000 27.4 dB`
fn heartbeat(counts: &Counts, running: &[(String, engine::Progress)]) -> String {
    let place = |progress: &engine::Progress| match progress.total {
        0 => String::new(), // the job has yet to report its number of steps
        total => format!(" step {}/{total}", progress.done),
    };
    let job = |(node, progress): &(String, engine::Progress)| {
        format!("{node}{} {}", place(progress), progress.message).trim_end().to_owned()
    };
    let jobs: Vec<String> = running.iter().map(job).collect();
    let head =
        format!("[{}/{} done, {} running, {} failed]", counts.done(), counts.total, counts.running, counts.failed);
    format!("{head} {}", jobs.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_without_known_steps_is_only_named() {
        let job = |node: &str, done, total, message: &str| {
            (node.to_owned(), engine::Progress { done, total, message: message.into() })
        };
        let counts = Counts { total: 3, running: 3, ..Counts::default() };
        let running = [job("a", 0, 0, ""), job("b", 0, 0, "calibrates"), job("c", 1, 2, "")];
        assert_eq!(heartbeat(&counts, &running), "[0/3 done, 3 running, 0 failed] a; b calibrates; c step 1/2");
    }
}
