//! `prepare`: makes a capture from a video or images, shows the progress, and prints the next commands.

use std::path::Path;

use engine::exit;
use indicatif::{ProgressBar, ProgressStyle};
use prepare::Event;

use crate::args::PrepareArgs;
use crate::error::CliError;
use crate::output::{count, duration, note, print_line, quoted};

pub(crate) fn prepare(args: &PrepareArgs) -> Result<u8, CliError> {
    let bar = ProgressBar::new(0);
    let style = ProgressStyle::with_template("  {bar:24} {pos}/{len}  {elapsed}  {msg}");
    bar.set_style(style.expect("the template is valid"));
    let prepared = prepare::prepare(&args.request(), &sfm_import::inspect::lost_scale, &mut |event| show(&bar, event));
    bar.finish_and_clear();
    let prepared = prepared.map_err(|failure| CliError::of_input(failure.into()))?;
    note(&match prepared.executed.len() {
        0 => "nothing had to run: every result is kept".into(),
        number => format!("{} ran; the results are kept in {}", count(number, "step"), prepared.dir.display()),
    });
    if prepared.registered.is_some() {
        note("COLMAP's results differ from run to run: keep sparse/0 with the models that are trained on it");
        next_commands(&prepared.dir)?;
    }
    Ok(exit::OK)
}

/// Shows an event: lines on standard error and, on a terminal, a bar for the running step.
fn show(bar: &ProgressBar, event: &Event) {
    let line = |text: String| bar.suspend(|| note(&text));
    match event {
        Event::Kept { step, summary } => line(format!("kept  {step}: {summary}")),
        Event::Started { step, command } => {
            line(format!("run   {step}: {command}"));
            bar.reset();
            bar.set_message(step.clone());
        }
        Event::Progress { done, total } => {
            bar.set_length(*total);
            bar.set_position(*done);
        }
        Event::Finished { step, summary, secs } => line(format!("done  {step}: {summary} ({})", duration(*secs))),
        Event::Note(text) => line(format!("note  {text}")),
    }
}

/// Prints the commands that lead from a prepared capture to a film.
fn next_commands(dir: &Path) -> Result<(), CliError> {
    let scene = sfm_import::inspect::scene_name(dir);
    let method = if dir.join("masks").is_dir() { "vcgs" } else { "deformable4dgs" };
    let (recipe, root) = (format!("own-{scene}.toml"), dir.parent().unwrap_or(dir));
    let [dir, root] = [dir, root].map(|path| quoted(&path.display().to_string()));
    print_line(&format!(
        "pipeline inspect {dir} --recipe > {recipe}\n\
         pipeline run {recipe} --data-root {root}\n\
         pipeline render {recipe} train/{scene}/{method}/0 --views test --truth --gif {scene}.gif --data-root {root}"
    ))
}
