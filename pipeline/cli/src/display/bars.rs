//! Progress bars for terminals: one for the run and one per running job.

use std::collections::BTreeMap;
use std::time::Duration;

use engine::event::{Event, Outcome};
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use super::{Display, Eta, lines};
use crate::error::CliError;

pub(crate) struct Bars {
    all: MultiProgress,
    run: ProgressBar,
    jobs: BTreeMap<String, ProgressBar>,
    failed: usize,
    eta: Eta,
}

impl Bars {
    pub(crate) fn new(eta: Eta) -> Self {
        let all = MultiProgress::new();
        let run = all.add(ProgressBar::new(0).with_style(style("{bar:24} {pos}/{len} jobs  {elapsed}  {msg}")));
        run.enable_steady_tick(Duration::from_millis(500));
        Self { all, run, jobs: BTreeMap::new(), failed: 0, eta }
    }

    /// Shows failures and the remaining time after the run's bar.
    fn show_state(&self) {
        let failed = (self.failed > 0).then(|| format!("{} failed", self.failed));
        let parts: Vec<String> = failed.into_iter().chain(self.eta.text()).collect();
        self.run.set_message(parts.join("  "));
    }

    fn note(&self, text: &str) {
        // A failed write is harmless: the run's event log holds every message.
        let _ = self.all.println(text);
    }
}

impl Display for Bars {
    fn show(&mut self, event: &Event) -> Result<(), CliError> {
        self.eta.note(event);
        self.show_state();
        match event {
            Event::Planned { jobs, .. } => self.run.set_length(*jobs as u64),
            Event::Started { node, .. } => {
                let bar = ProgressBar::new(0).with_style(style("  {bar:22} {percent:>3}% {prefix}  {msg}  {eta}"));
                let bar = self.all.add(bar.with_prefix(node.clone()));
                bar.enable_steady_tick(Duration::from_millis(500));
                self.jobs.insert(node.clone(), bar);
            }
            Event::Progress { node, progress } => {
                if let Some(bar) = self.jobs.get(node) {
                    bar.set_length(progress.total);
                    bar.set_position(progress.done);
                    bar.set_message(progress.message.clone());
                }
            }
            Event::Finished { node, result } => {
                if let Some(bar) = self.jobs.remove(node) {
                    bar.finish_and_clear();
                }
                self.run.inc(1);
                if result.outcome == Outcome::Failed {
                    self.failed += 1;
                }
                if let Some(text) = lines::finished(node, result) {
                    self.note(&text);
                }
            }
            Event::Waiting { node } => self.note(&format!("{node} waits for another process's result")),
            Event::Stopping { message } => self.note(&format!("stopping: {message}")),
            Event::Warning { message } => self.note(&format!("warning: {message}")),
            Event::Heartbeat { .. } => {}
            Event::RunFinished { .. } => self.run.finish_and_clear(),
        }
        Ok(())
    }
}

/// A bar's style. An invalid template falls back to the default style; all templates are constants of this file.
fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("━╸ ")
}
