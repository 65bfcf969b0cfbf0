//! Evaluation of a folder of images against a folder of ground truth.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{Protocol, Split};

use crate::artifact::{METRIC_VERSION, Metrics, empty_set};
use crate::image_file::Background;
use crate::pairs::{Pair, evaluate_pairs};
use crate::params::MetricEvaluationParams;
use crate::scoring::perceptual::{self, NO_OPTION, Networks};
use crate::scoring::trivial::{self, Truths};

/// Extensions of image files, in lower case.
const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];
/// Maximum number of names in a message about missing counterparts.
const LISTED: usize = 5;

/// Compares every image in `renders` with the image of the same stem in `truth`, by all metrics.
///
/// # Errors
/// An empty folder, a missing counterpart on either side, images of different sizes, transparent images (see
/// [`evaluate_folders_with`]), or an unreadable file.
pub fn evaluate_folders(renders: &Path, truth: &Path) -> anyhow::Result<Metrics> {
    evaluate_folders_with(renders, truth, &MetricEvaluationParams::default(), None, None)
}

/// Compares two folders like [`evaluate_folders`], with chosen metrics, LPIPS weights from a folder, and transparent images
/// composited on `background`.
pub fn evaluate_folders_with(
    renders: &Path,
    truth: &Path,
    params: &MetricEvaluationParams,
    lpips_weights: Option<&Path>,
    background: Option<Background>,
) -> anyhow::Result<Metrics> {
    let pairs = paired(renders, truth)?;
    let (mut images, size) = evaluate_pairs(&pairs, params, background)?;
    let truths = pairs.iter().map(|pair| pair.truth.clone()).collect();
    let truths = Truths::without_poses(truths, params.quantise, background);
    trivial::add(&mut images, &truths, None)?;
    let networks = Networks::open(lpips_weights, &params.metrics, NO_OPTION)?;
    for (image, pair) in images.iter_mut().zip(&pairs) {
        perceptual::add(image, pair, &networks, params, background)?;
    }
    let background = match background {
        None => "as given",
        Some(Background::White) => "white",
        Some(Background::Black) => "black",
    };
    Ok(Metrics {
        method: "external".into(),
        protocol: Protocol {
            dataset: "folder".into(),
            split: "as given".into(),
            width: size[0],
            height: size[1],
            resize: "as given".into(),
            background: background.into(),
            time: "as given".into(),
        },
        split: Split::Test,
        metric_version: METRIC_VERSION,
        quantise: params.quantise,
        masks: BTreeMap::new(),
        masked: BTreeMap::new(),
        means: Metrics::means_of(&images, &params.metrics),
        prompts: BTreeMap::new(),
        trivial_prompts: BTreeMap::new(),
        trivial: Metrics::trivial_of(&images, truths.over),
        n_images: images.len(),
        images,
    })
}

/// Pairs images by file stem. Every image needs a counterpart, because a subset would be another test set.
fn paired(renders: &Path, truth: &Path) -> Result<Vec<Pair>, Failure> {
    let (rendered, mut true_images) = (images_in(renders)?, images_in(truth)?);
    let without = |those: &BTreeMap<String, PathBuf>, others: &BTreeMap<String, PathBuf>| {
        those.keys().filter(|stem| !others.contains_key(*stem)).cloned().collect::<Vec<_>>()
    };
    let (no_truth, no_render) = (without(&rendered, &true_images), without(&true_images, &rendered));
    if !no_truth.is_empty() {
        return Err(missing("renders", &no_truth, "ground truth", truth));
    }
    if !no_render.is_empty() {
        return Err(missing("ground-truth images", &no_render, "render", renders));
    }
    let pair = |(name, render): (String, PathBuf)| {
        let truth = true_images.remove(&name)?;
        Some(Pair { name, time_secs: None, camera_index: None, render, truth })
    };
    Ok(rendered.into_iter().filter_map(pair).collect())
}

fn missing(whose: &str, stems: &[String], counterpart: &str, folder: &Path) -> Failure {
    let more = if stems.len() > LISTED { format!(" and {} more", stems.len() - LISTED) } else { String::new() };
    let listed = stems[..stems.len().min(LISTED)].join(", ");
    let message = format!("these {whose} have no {counterpart} of the same name: {listed}{more}");
    Failure::new(FailureKind::BadInput, message)
        .hint("PNG and JPEG files are paired by file name without extension; remove or rename the others")
        .at(folder)
}

/// The PNG and JPEG files of a folder, by stem; no hidden files.
fn images_in(folder: &Path) -> Result<BTreeMap<String, PathBuf>, Failure> {
    let unreadable = |error: std::io::Error| {
        Failure::new(FailureKind::MissingData, format!("cannot list the folder: {error}")).at(folder)
    };
    let mut images = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        let (Some(stem), Some(extension)) = (path.file_stem(), extension) else { continue };
        if !EXTENSIONS.contains(&extension.as_str()) || stem.as_encoded_bytes().starts_with(b".") {
            continue;
        }
        if let Some(other) = images.insert(stem.to_string_lossy().into_owned(), path.clone()) {
            let message = format!("two images have the stem {}", stem.to_string_lossy());
            return Err(Failure::new(FailureKind::BadInput, message).hint("keep one of them").at(other.max(path)));
        }
    }
    if images.is_empty() {
        return Err(empty_set("folder").hint("it needs PNG or JPEG files").at(folder));
    }
    Ok(images)
}
