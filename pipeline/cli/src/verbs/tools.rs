//! `inspect`, `eval` and `completions`: verbs without a recipe.

use std::io::ErrorKind;
use std::path::Path;

use clap::CommandFactory;
use engine::{Failure, FailureKind, exit};
use metric_evaluation::{MetricEvaluationParams, Metrics, evaluate_folders_with};
use sfm_import::Format;

use crate::args::{Cli, EvalArgs};
use crate::error::CliError;
use crate::output::{print, print_json, print_line};
use crate::verbs::data;

/// Checks that a path that the user named is a folder.
fn require_folder(path: &Path) -> Result<(), CliError> {
    let problem = match std::fs::metadata(path) {
        Ok(found) if found.is_dir() => return Ok(()),
        Ok(_) => "not a folder".to_owned(),
        Err(error) if error.kind() == ErrorKind::NotFound => "no such folder".to_owned(),
        Err(error) => format!("cannot open the folder ({error})"),
    };
    Err(anyhow::Error::from(Failure::new(FailureKind::BadInput, problem).at(path)).into())
}

/// Describes the captures in a folder, or prints only a recipe for them. Errors if any of them cannot be imported.
pub(crate) fn inspect(dir: &Path, format: Format, only_recipe: bool) -> Result<u8, CliError> {
    if dir.is_file() {
        let failure = Failure::new(FailureKind::BadInput, "a capture is a folder, not a file");
        let next_step = sfm_import::inspect::next_step_for_file(dir);
        let hint = next_step.unwrap_or_else(|| "name the folder that contains the file".into());
        return Err(anyhow::Error::from(failure.hint(hint).at(dir)).into());
    }
    require_folder(dir)?;
    let found = sfm_import::inspect::inspect_as(dir, format).map_err(CliError::of_input)?;
    match found.recipe() {
        Some(recipe) if only_recipe => print_line(recipe.trim_end())?,
        None if only_recipe => {
            let failure = Failure::new(FailureKind::BadInput, "nothing here can be imported");
            return Err(anyhow::Error::from(
                failure.hint("`pipeline inspect` without --recipe lists the problems").at(dir),
            )
            .into());
        }
        _ => {
            print_line(found.text().trim_end())?;
            let known =
                found.captures.iter().map(|capture| data::known(&capture.path, &format!("{:?}", capture.format)));
            let lines = known.collect::<Result<Vec<_>, _>>()?.concat();
            lines.iter().try_for_each(|line| print_line(line))?;
        }
    }
    let bad: Vec<&Path> =
        found.captures.iter().filter(|it| !it.problems.is_empty()).map(|it| it.path.as_path()).collect();
    if bad.is_empty() {
        return Ok(exit::OK);
    }
    if !only_recipe {
        let message = format!("not everything can be imported; the problems are listed above: {}", dir.display());
        return Err(CliError::of_input(anyhow::anyhow!(message)));
    }
    let names: Vec<String> =
        bad.iter().map(|path| path.file_name().unwrap_or_default().display().to_string()).collect();
    let message = format!("captures with problems were left out of the recipe: {}", names.join(", "));
    let failure = Failure::new(FailureKind::BadInput, message);
    Err(anyhow::Error::from(failure.hint("`pipeline inspect` without --recipe lists the problems").at(dir)).into())
}

pub(crate) fn eval(args: &EvalArgs) -> Result<u8, CliError> {
    let metrics = evaluated(args)?;
    if args.json {
        print_json(&metrics)?;
    } else {
        print_line(metrics.summary().trim_end())?;
    }
    Ok(exit::OK)
}

/// The metrics of the images in the two folders.
fn evaluated(args: &EvalArgs) -> Result<Metrics, CliError> {
    require_folder(&args.renders)?;
    require_folder(&args.truth)?;
    let weights = args.lpips_weights.as_deref();
    weights.map_or(Ok(()), require_folder)?;
    let params = MetricEvaluationParams::default();
    evaluate_folders_with(&args.renders, &args.truth, &params, weights, args.background).map_err(CliError::of_input)
}

pub(crate) fn completions(shell: clap_complete::Shell) -> Result<u8, CliError> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "pipeline", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(exit::OK)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::Verb;

    #[test]
    fn eval_composites_transparent_images_on_the_background() {
        let root = tempfile::tempdir().unwrap();
        let [renders, truth] = ["renders", "truth"].map(|name| root.path().join(name));
        [&renders, &truth].into_iter().for_each(|folder| std::fs::create_dir(folder).unwrap());
        image::RgbImage::from_pixel(24, 16, image::Rgb([255; 3])).save(renders.join("a.png")).unwrap();
        image::RgbaImage::from_pixel(24, 16, image::Rgba([0; 4])).save(truth.join("a.png")).unwrap();
        let folders = [format!("--renders={}", renders.display()), format!("--truth={}", truth.display())];
        let eval = |more: &[&str]| {
            let words = ["pipeline", "eval", &folders[0], &folders[1]].into_iter().chain(more.iter().copied());
            let Verb::Eval(args) = Cli::try_parse_from(words).unwrap().verb else { panic!("another verb") };
            evaluated(&args)
        };
        let refused = eval(&[]).unwrap_err().to_string();
        assert!(refused.contains("transparent") && refused.contains("eval --background"), "{refused}");
        for (colour, mse) in [("white", 0.0), ("black", 1.0)] {
            let metrics = eval(&["--background", colour]).unwrap();
            assert_eq!((metrics.images[0].mse, metrics.protocol.background.as_str()), (mse, colour));
        }
    }
}
