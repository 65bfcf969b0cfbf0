//! Poses with COLMAP: features, matches, and the largest reconstruction.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};

use crate::LostScale;
use crate::error::{Result, bad, io};
use crate::estimators::Estimator;
use crate::frames::{IMAGES, image_names, in_work};
use crate::masks_folder::for_colmap;
use crate::request::{CameraModel, Matcher, Request};
use crate::steps::{Step, Steps, remove};
use crate::tools::COLMAP;

/// The folder of the chosen reconstruction in the capture.
const MODEL: &str = "sparse/0";
/// Maximum number of frames of a video for which all pairs are compared: 780 pairs, a minute on two cores.
const ALL_OF_VIDEO: usize = 40;
/// Maximum number of unordered images for which all pairs are compared: 20 thousand pairs.
const ALL_OF_PHOTOS: usize = 200;
/// Share of images with a pose below which `sfm-import` refuses a model.
const LEAST_SHARE: f64 = 0.5;
/// With fewer images than this, a reconstruction may be smaller than COLMAP's minimum of 10 images.
const FEW: usize = 20;
/// Share of images with a pose below which a second attempt is worth its time: COLMAP's mapper depends on chance, and lost
/// frames are gaps in time.
const GOOD_SHARE: f64 = 0.9;
/// Advice if COLMAP fails.
const POSES_HINT: &str = "try masks of the moving objects (--masks, or an estimator), more frames per second (--fps) so that \
                          neighbours overlap, larger frames (--max-side), a camera that moves sideways and not only turns. \
                          Poses of VGGT, MASt3R or MegaSaM can be imported instead (see the README of sfm-import)";
/// Settings for cameras that hardly move: the first pair may have a small angle and few common points, and points with
/// a triangulation angle of half a degree are accepted. With the default of 1.5 degrees, few points of such a video
/// remain, and the images that need them are lost. The intrinsics stay as they were guessed (or as EXIF states them), because
/// a camera that hardly moves does not determine them: refined, they drift and take the poses with them.
const PATIENT: [&str; 16] = [
    "--Mapper.ba_refine_focal_length",
    "0",
    "--Mapper.ba_refine_extra_params",
    "0",
    "--Mapper.init_min_tri_angle",
    "4",
    "--Mapper.init_min_num_inliers",
    "50",
    "--Mapper.tri_min_angle",
    "0.5",
    "--Mapper.filter_min_tri_angle",
    "0.5",
    "--Mapper.abs_pose_min_num_inliers",
    "15",
    "--Mapper.abs_pose_max_error",
    "8",
];

impl CameraModel {
    fn of_colmap(self, estimators: &[Estimator]) -> &'static str {
        let has_maps = estimators.iter().any(|estimator| estimator.kind.is_map());
        match self {
            Self::Auto if has_maps => "SIMPLE_PINHOLE",
            Self::SimplePinhole => "SIMPLE_PINHOLE",
            Self::Auto | Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Opencv => "OPENCV",
        }
    }
}

/// Extracts features from the pixels that no mask hides.
pub(crate) fn features(steps: &mut Steps<'_>, request: &Request, estimators: &[Estimator]) -> Result<()> {
    let tool = COLMAP.version();
    let (per, cameras) = match has_folders(&steps.dir) {
        true => ("single_camera_per_folder", "one camera per folder"),
        false => ("single_camera", "one camera"),
    };
    let model = request.camera_model.of_colmap(estimators);
    let masks = for_colmap(&steps.dir);
    let mut arguments = words(&["feature_extractor", "--image_path", IMAGES, "--ImageReader.camera_model", model]);
    arguments.extend([format!("--ImageReader.{per}"), "1".into()]);
    arguments.extend(masks.iter().flat_map(|folder| ["--ImageReader.mask_path".to_owned(), folder.clone()]));
    let output = in_work("features.db");
    let mut inputs = vec![("images", PathBuf::from(IMAGES))];
    inputs.extend(masks.map(|folder| ("masks", folder.into())));
    let commands = vec![shown(&arguments)];
    let step = Step { name: "features", commands, tool: tool.clone(), inputs, outputs: vec![&output] };
    steps.run(step, |steps| {
        let scratch = steps.scratch("features")?;
        let database = scratch.join("features.db");
        arguments.extend(database_and_gpu("feature_extractor", &tool?, &database)?);
        let log = steps.execute("features", colmap(&arguments), &fraction)?;
        let counts = log.lines().filter_map(|line| line.trim().strip_prefix("Features:")?.trim().parse::<u64>().ok());
        let mut counts: Vec<u64> = counts.collect();
        counts.sort_unstable();
        steps.publish(&database, &output)?;
        let median = counts
            .get(counts.len() / 2)
            .map_or(String::new(), |median| format!(", {median} features in the median image"));
        Ok((Vec::new(), format!("{model}, {cameras}{median}")))
    })
}

/// Matches features between images.
pub(crate) fn matches(steps: &mut Steps<'_>, request: &Request) -> Result<()> {
    let tool = COLMAP.version();
    let images = image_names(&steps.dir.join(IMAGES)).len();
    let is_video = !request.input.is_dir();
    let most = if is_video { ALL_OF_VIDEO } else { ALL_OF_PHOTOS };
    let compares_all = match request.matcher {
        Matcher::Exhaustive => true,
        Matcher::Sequential => false,
        Matcher::Auto => images <= most || has_folders(&steps.dir),
    };
    let verb = if compares_all { "exhaustive_matcher" } else { "sequential_matcher" };
    let mut arguments = words(&[verb]);
    if !compares_all {
        // Finding loops needs a vocabulary tree, which would be downloaded.
        arguments.extend(words(&["--SequentialMatching.loop_detection", "0"]));
    }
    let (input, output) = (in_work("features.db"), in_work("matches.db"));
    let inputs = vec![("features", PathBuf::from(&input))];
    let commands = vec![shown(&arguments)];
    let step = Step { name: "matches", commands, tool: tool.clone(), inputs, outputs: vec![&output] };
    steps.run(step, |steps| {
        let scratch = steps.scratch("matches")?;
        let database = scratch.join("matches.db");
        std::fs::copy(steps.dir.join(&input), &database).map_err(|error| io(&error, &database))?;
        arguments.extend(database_and_gpu(verb, &tool?, &database)?);
        steps.execute("matches", colmap(&arguments), &fraction)?;
        steps.publish(&database, &output)?;
        let pairs = if compares_all { "all pairs" } else { "neighbours in time" };
        Ok((Vec::new(), format!("{pairs} of {images} images")))
    })
}

/// A reconstruction of the mapper.
#[derive(Debug)]
pub(crate) struct Reconstruction {
    /// Number of images with a pose.
    pub(crate) count: usize,
    /// The factor between the sizes of its parts, if it lost its scale.
    pub(crate) lost_scale: Option<f64>,
    /// The number of reconstructions of the same attempt.
    pub(crate) models: usize,
    pub(crate) path: PathBuf,
}

/// Reconstructs the scene, chooses the largest usable reconstruction, and returns its number of images. Too few images are an
/// error.
pub(crate) fn mapping(steps: &mut Steps<'_>, lost_scale: LostScale<'_>) -> Result<usize> {
    let images = image_names(&steps.dir.join(IMAGES)).len();
    let input = in_work("matches.db");
    let mut arguments = words(&["mapper", "--image_path", IMAGES]);
    if images < FEW {
        arguments.extend(words(&["--Mapper.min_model_size", "3"]));
    }
    let inputs = vec![("matches", PathBuf::from(&input)), ("images", IMAGES.into())];
    let patient = [arguments.clone(), words(&PATIENT)].concat();
    let step = Step {
        name: "mapping",
        commands: vec![shown(&arguments), shown(&patient)],
        tool: COLMAP.version(),
        inputs,
        outputs: vec![MODEL],
    };
    steps.run(step, |steps| {
        let (mut best, mut failed) = attempt(steps, "mapping", &arguments, images, lost_scale)?;
        let mut more = Vec::new();
        if let Some(problem) = problem(best.as_ref(), images) {
            steps.note(format!("{problem}: trying again with settings for cameras that hardly move"));
            more.push(shown(&patient));
            let (second, failed_again) = attempt(steps, "mapping-patient", &patient, images, lost_scale)?;
            best = best_of(best.into_iter().chain(second), images);
            failed = failed.or(failed_again);
        }
        let Some(Reconstruction { count, models, path, .. }) = best else { return Err(no_model(failed, images)) };
        steps.publish(&path, MODEL)?;
        let of_models = if models > 1 { format!(", the largest of {models} reconstructions") } else { String::new() };
        Ok((more, format!("{count} of {images} images have a pose{of_models}")))
    })?;
    let model = steps.dir.join(MODEL);
    let count = registered(&model).unwrap_or(0);
    check(count, images, lost_scale(&model))?;
    Ok(count)
}

/// Refuses a model that no method can train on: with too few of the images, or whose parts differ in size by the factor
/// `lost_scale`.
pub(crate) fn check(count: usize, images: usize, lost_scale: Option<f64>) -> Result<()> {
    if !is_enough(count, images) {
        return Err(too_few(count, images));
    }
    match lost_scale {
        Some(factor) => Err(bad(format!("{}, and the poses are unusable", of_lost_scale(factor))).hint(POSES_HINT)),
        None => Ok(()),
    }
}

/// The reason why a second attempt is worth its time; `None` if it is not.
pub(crate) fn problem(best: Option<&Reconstruction>, images: usize) -> Option<String> {
    let count = best.map_or(0, |best| best.count);
    if !((count as f64) >= GOOD_SHARE * images as f64) {
        return Some(format!("only {count} of {images} images have a pose"));
    }
    best.and_then(|best| best.lost_scale).map(of_lost_scale)
}

fn of_lost_scale(factor: f64) -> String {
    format!("COLMAP lost the scale: the distance of the points differs by a factor of {factor:.0e} between images")
}

/// Of the reconstructions with enough images and one scale, that with the most images; if there are none, of all.
pub(crate) fn best_of(all: impl Iterator<Item = Reconstruction>, images: usize) -> Option<Reconstruction> {
    let is_usable = |found: &Reconstruction| found.lost_scale.is_none() && is_enough(found.count, images);
    all.max_by_key(|found| (is_usable(found), found.count))
}

/// Runs the mapper and returns its best reconstruction, or how the mapper failed without one; `name` is that of its log. Newer
/// versions also fail if they find no reconstruction.
fn attempt(
    steps: &mut Steps<'_>,
    name: &str,
    arguments: &[String],
    images: usize,
    lost_scale: LostScale<'_>,
) -> Result<(Option<Reconstruction>, Option<Failure>)> {
    let scratch = steps.scratch(name)?;
    // The mapper writes into the database that it reads.
    let copies = steps.scratch("mapping-database")?;
    let database = copies.join("matches.db");
    std::fs::copy(steps.dir.join(in_work("matches.db")), &database).map_err(|error| io(&error, &database))?;
    let mut command = colmap(arguments);
    command.arg("--database_path").arg(&database).arg("--output_path").arg(&scratch);
    let ended = steps.execute(name, command, &|log| Some((last_registered(log)?, images as u64)));
    remove(&copies)?;
    let entries = std::fs::read_dir(&scratch).map_err(|error| io(&error, &scratch))?;
    let models = entries.flatten().filter_map(|entry| Some((registered(&entry.path())?, entry.path())));
    let models: Vec<(usize, PathBuf)> = models.collect();
    let found = models.len();
    let reconstruction = |(count, path): (usize, PathBuf)| {
        let lost_scale = lost_scale(&path);
        Reconstruction { count, lost_scale, models: found, path }
    };
    match ended {
        // A crash is an error, not a poor reconstruction.
        Err(failure) if found == 0 && failure.kind == FailureKind::World => Err(failure),
        _ => Ok((best_of(models.into_iter().map(reconstruction), images), ended.err())),
    }
}

/// The number of images of a binary model: the first value of its file of images.
fn registered(model: &Path) -> Option<usize> {
    let bytes = std::fs::read(model.join("images.bin")).ok()?;
    Some(u64::from_le_bytes(bytes.get(..8)?.try_into().ok()?) as usize)
}

fn is_enough(count: usize, images: usize) -> bool {
    count >= 3 && count as f64 >= LEAST_SHARE * images as f64
}

fn too_few(count: usize, images: usize) -> Failure {
    bad(format!("only {count} of {images} images have a pose")).hint(POSES_HINT)
}

/// The failure of a mapper without a reconstruction. One that failed may have had another reason than the images, e.g. an
/// option that this version of COLMAP does not have.
pub(crate) fn no_model(failed: Option<Failure>, images: usize) -> Failure {
    let few = too_few(0, images);
    match failed {
        Some(failure) => {
            Failure { message: format!("{}: {}", few.message, failure.message), hint: few.hint, ..failure }
        }
        None => few,
    }
}

/// Whether images lie in folders, one per camera.
fn has_folders(dir: &Path) -> bool {
    image_names(&dir.join(IMAGES)).iter().any(|name| name.contains('/'))
}

/// The arguments that do not change a result: the path of the database, and whether a GPU is used. Their names depend
/// on the version.
fn database_and_gpu(verb: &str, version: &str, database: &Path) -> Result<Vec<String>> {
    let help = COLMAP.output(&[verb, "-h"]).unwrap_or_default();
    let has_cuda = version.contains("with CUDA") || COLMAP.output(&["-h"])?.contains("with CUDA");
    let task = if verb == "feature_extractor" { "Extraction" } else { "Matching" };
    let groups = ["Sift", "Feature"].map(|kind| format!("--{kind}{task}.use_gpu"));
    let gpu = groups.into_iter().find(|name| help.contains(name.as_str()));
    let mut arguments = vec!["--database_path".to_owned(), database.display().to_string()];
    arguments.extend(gpu.into_iter().flat_map(|name| [name, u8::from(has_cuda).to_string()]));
    Ok(arguments)
}

fn colmap(arguments: &[String]) -> std::process::Command {
    let mut command = COLMAP.command();
    command.args(arguments);
    command
}

fn words(arguments: &[&str]) -> Vec<String> {
    arguments.iter().map(|word| (*word).to_owned()).collect()
}

fn shown(arguments: &[String]) -> String {
    format!("colmap {}", arguments.join(" "))
}

/// The last fraction in brackets in a log, e.g. `Processed file [3/70]` or `Matching block [1/2, 2/2]`.
pub(crate) fn fraction(log: &str) -> Option<(u64, u64)> {
    let inside = log.rsplit('[').find_map(|rest| {
        let inside = rest.split_once(']')?.0;
        inside.contains('/').then_some(inside)
    })?;
    let part = |text: &str| {
        let (done, total) = text.trim().split_once('/')?;
        Some((done.trim().parse::<u64>().ok()?, total.trim().parse::<u64>().ok()?))
    };
    match inside.split_once(',') {
        None => part(inside),
        Some((row, column)) => {
            let ((row, rows), (column, columns)) = (part(row)?, part(column)?);
            Some((row.saturating_sub(1) * columns + column, rows * columns))
        }
    }
}

/// The number of registered images that the mapper printed last, e.g. `Registering image #5 (12)`.
pub(crate) fn last_registered(log: &str) -> Option<u64> {
    let line = log.lines().rev().find(|line| line.contains("Registering image"))?;
    let inside = line.rsplit_once('(')?.1;
    inside.chars().filter(char::is_ascii_digit).collect::<String>().parse().ok()
}
