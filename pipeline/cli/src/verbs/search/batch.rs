//! A search on a cluster: an array of pilots that work on one search, and a last job that writes the report or submits
//! more pilots.

use std::collections::BTreeSet;
use std::path::Path;

use ::cluster::{ClusterRun, RunFile, requeue};
use anyhow::Context;
use clap::Parser;
use engine::{Failure, FailureKind, Plan, Store, builtin_name, exit};

use super::{Search, report, settings, workers};
use crate::args::{Cli, Verb};
use crate::error::CliError;
use crate::output::note;
use crate::session::Session;
use crate::verbs::cluster;

/// Submits the pilots of a search and, without `--detach`, follows them.
pub(super) fn submit_and_follow(search: &mut Search<'_>) -> Result<u8, CliError> {
    if search.args.workers.is_none() {
        let message = "the trials of a search are not known beforehand, so they cannot be submitted one by one";
        let hint = "add --workers N: N pilots take trials until there are none";
        return Err(CliError::Input(Failure::new(FailureKind::BadInput, message).hint(hint).into()));
    }
    if search.is_over()? {
        report::write(search)?;
        return Ok(search.exit_code());
    }
    let session = Session::open(search.store, &search.recipe)?;
    let mut arguments = vec![];
    for argument in workers::arguments(search)? {
        let text = argument.into_string().map_err(|_| anyhow::anyhow!("an argument is not UTF-8"))?;
        arguments.push(text);
    }
    arguments.extend(["--device".into(), search.recipe.with.device.clone()]);
    let arguments = with_absolute_recipe(arguments, &search.args.recipe.recipe)?;
    let nodes = super::trial::trainings(&session.plan).collect();
    let run = cluster::submit_search(&session, search.args, arguments, &nodes)?;
    if search.args.detach {
        return Ok(exit::OK);
    }
    let cluster_run = ClusterRun::read(&session.store, &run, &session.plan)?;
    follow(search, &cluster_run, &nodes)
}

/// The arguments with an absolute path of the recipe, for `attach` in another folder.
fn with_absolute_recipe(mut arguments: Vec<String>, recipe: &Path) -> std::io::Result<Vec<String>> {
    if builtin_name(recipe).is_none() {
        let absolute = std::path::absolute(recipe)?.to_string_lossy().into_owned();
        arguments.iter_mut().filter(|argument| Path::new(argument) == recipe).for_each(|it| it.clone_from(&absolute));
    }
    Ok(arguments)
}

/// Shows new trials until the search has ended.
fn follow(search: &mut Search<'_>, run: &ClusterRun<'_>, nodes: &BTreeSet<usize>) -> Result<u8, CliError> {
    let stop = search.stop.clone();
    let mut shown = search.history.entries.len();
    let shared = std::cell::RefCell::new(&mut *search);
    let watched = run.watch(
        &stop,
        || {
            let mut search = shared.borrow_mut();
            search.history.refresh()?;
            search.history.entries.iter().skip(shown).for_each(|entry| note(&search.line(entry)));
            shown = search.history.entries.len();
            Ok(true)
        },
        |wave| close(&mut shared.borrow_mut(), run, nodes, wave).map_err(|error| anyhow::anyhow!("{error}")),
    );
    watched?;
    search.history.refresh()?;
    if search.stop.count() > 0 {
        let name = &run.run;
        note(&format!(
            "the batch jobs continue; `pipeline attach {name}` follows them, `pipeline cancel {name}` stops them"
        ));
    }
    report::write(search)?;
    Ok(search.exit_code())
}

/// `attach` for a search: follows it like the process that submitted it.
pub(crate) fn attach(store: &Path, run: &ClusterRun<'_>) -> Result<u8, CliError> {
    let arguments = run.site.search.iter().flatten().cloned();
    let parsed = Cli::try_parse_from([String::from("pipeline")].into_iter().chain(arguments));
    let Ok(Cli { verb: Verb::Run(args), .. }) = parsed else {
        return Err(anyhow::anyhow!("run {} was submitted by another version of this program", run.run).into());
    };
    let settings = settings(&args)?;
    let settings = settings.with_context(|| format!("run {} is not a search", run.run))?;
    let mut search = Search::open(store, &args, &settings)?;
    let nodes = super::trial::trainings(run.plan).collect();
    follow(&mut search, run, &nodes)
}

/// The work of a batch job of a search.
pub(super) fn batch_job(search: &mut Search<'_>) -> Result<u8, CliError> {
    let sweep = &search.args.sweep;
    let (Some(run), Some(wave)) = (sweep.search_run.clone(), sweep.search_wave) else { return Ok(exit::NOTHING) };
    let (_, plan): (RunFile, Plan) = RunFile::read(&Store::open(search.store)?, &run)?;
    let store = Store::open(search.store)?;
    let cluster_run = ClusterRun::read(&store, &run, &plan)?;
    if cluster_run.is_cancelled() {
        return Ok(exit::NOTHING);
    }
    if search.args.sweep.search_report {
        let nodes = super::trial::trainings(&plan).collect();
        close(search, &cluster_run, &nodes, wave)?;
        return Ok(exit::OK);
    }
    let (part, _) = search.args.sweep.search_part.unwrap_or((1, 1));
    let mut failed = None;
    cluster_run.attended(wave, &format!("w{wave}-pilot-{part}"), || {
        failed = search.work().err();
        Ok(())
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    let is_over = search.is_over()?;
    Ok(match search.stop.last_signal() {
        "USR1" if search.stop.count() > 0 && !is_over && !cluster_run.is_cancelled() => requeue(&search.stop),
        _ => exit::OK,
    })
}

/// Submits pilots again if trials are left, or writes the report.
fn close(search: &mut Search<'_>, run: &ClusterRun<'_>, nodes: &BTreeSet<usize>, wave: usize) -> Result<(), CliError> {
    if !search.is_over()? && wave < run.site.cluster.attempts && !run.is_cancelled() {
        run.submit(wave + 1, nodes)?;
        return Ok(());
    }
    report::write(search)?;
    Ok(run.end(search.exit_code())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_recipe_of_a_submitted_search_is_absolute() {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let made = |text: &str, recipe: &str| with_absolute_recipe(words(text), Path::new(recipe)).unwrap();
        let recipe = std::env::current_dir().unwrap().join("a.toml");
        assert_eq!(made("run a.toml -s a=b", "a.toml"), words(&format!("run {} -s a=b", recipe.display())));
        assert_eq!(made("run builtin:a -s a=b", "builtin:a"), words("run builtin:a -s a=b"));
    }
}
