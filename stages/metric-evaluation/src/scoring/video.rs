//! Adds metrics of the image sequence of each camera.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Digest, Failure, FailureKind};
use rayon::prelude::*;
use scene::npy_file;

use crate::artifact::ImageMetrics;
use crate::metrics::metric::Metric;
use crate::metrics::score::Score;
use crate::metrics::video::{consistencies, flow_difference, residual_change};
use crate::params::MetricEvaluationParams;
use crate::test_set::TestSet;

/// File with the hashes of the images that the features were computed from, in the format of `sha256sum`.
const HASHES: &str = "images.sha256";
/// Folders of optical flow [H, W, 2] in pixels from the previous image: of the renders and of the ground truth.
const FLOWS: [&str; 2] = ["flow_of_renders", "flow_of_truth"];
/// Folders of feature vectors, by metric.
const FEATURES: [(Metric, &str); 2] =
    [(Metric::SubjectConsistency, "subject"), (Metric::BackgroundConsistency, "background")];

/// Adds flicker, and consistency and tOF if `features` names a folder of network outputs for the renders.
pub(crate) fn add(
    images: &mut [ImageMetrics],
    set: &TestSet<'_>,
    features: Option<&Path>,
    params: &MetricEvaluationParams,
) -> anyhow::Result<()> {
    if params.metrics.contains(&Metric::Flicker) {
        add_flicker(images, set, params)?;
    }
    let Some(folder) = features else { return Ok(()) };
    let wanted: Vec<_> = FEATURES.into_iter().filter(|(metric, _)| params.metrics.contains(metric)).collect();
    let flows = FLOWS.map(|kind| folder.join(kind));
    let has_flows = params.metrics.contains(&Metric::FlowOfVideo) && flows.iter().all(|folder| folder.is_dir());
    if wanted.is_empty() && !has_flows {
        return Ok(());
    }
    check_hashes(set, folder)?;
    if has_flows {
        add_flow_difference(images, set, &flows)?;
    }
    for (metric, kind) in wanted {
        let folder = folder.join(kind);
        if folder.is_dir() {
            add_consistency(images, set, metric, &folder)?;
        }
    }
    Ok(())
}

/// The indices of a set's images per camera, in the order of time.
fn videos(set: &TestSet<'_>) -> impl Iterator<Item = Vec<usize>> {
    let mut videos = BTreeMap::<u32, Vec<usize>>::new();
    for (index, (_, view)) in set.views.iter().enumerate() {
        videos.entry(view.camera_index).or_default().push(index);
    }
    // Views of a split are sorted by time.
    videos.into_values()
}

/// Adds the change of the error between consecutive images of a fixed camera. Flicker is undefined for a moving camera,
/// where a pixel shows different surfaces over time.
fn add_flicker(images: &mut [ImageMetrics], set: &TestSet<'_>, params: &MetricEvaluationParams) -> anyhow::Result<()> {
    let neighbours: Vec<[usize; 2]> =
        videos(set).flat_map(|video| video.array_windows().copied().collect::<Vec<_>>()).collect();
    let is_fixed = |[before, after]: &[usize; 2]| set.views[*before].1.camera == set.views[*after].1.camera;
    let flicker = |[before, after]: [usize; 2]| -> anyhow::Result<(usize, f64)> {
        let ([r0, t0], [r1, t1]) = (set.images(before, params)?, set.images(after, params)?);
        Ok((after, residual_change([&r0, &t0], [&r1, &t1])))
    };
    let found: Vec<_> = neighbours.into_par_iter().filter(is_fixed).map(flicker).collect::<Result<_, _>>()?;
    for (index, value) in found {
        images[index].values.insert(Metric::Flicker, Score::Value(value));
    }
    Ok(())
}

fn add_consistency(
    images: &mut [ImageMetrics],
    set: &TestSet<'_>,
    metric: Metric,
    folder: &Path,
) -> Result<(), Failure> {
    for video in videos(set) {
        let features =
            video.iter().map(|&index| read(folder, &set.views[index].1.name)).collect::<Result<Vec<_>, _>>()?;
        if let Some(odd) = features.iter().position(|feature| feature.len() != features[0].len()) {
            let message =
                format!("the feature vector has {} values instead of {}", features[odd].len(), features[0].len());
            let path = folder.join(format!("{}.npy", set.views[video[odd]].1.name));
            return Err(Failure::new(FailureKind::BadInput, message).at(path));
        }
        for (&index, value) in video[1..].iter().zip(consistencies(&features)) {
            images[index].values.insert(metric, Score::Value(value));
        }
    }
    Ok(())
}

/// Adds tOF to every image after the first one of its camera.
fn add_flow_difference(images: &mut [ImageMetrics], set: &TestSet<'_>, folders: &[PathBuf; 2]) -> Result<(), Failure> {
    let later: Vec<usize> = videos(set).flat_map(|video| video[1..].to_vec()).collect();
    let difference = |&index: &usize| {
        let view = set.views[index].1;
        let (width, height) = (view.camera.intrinsics.width as usize, view.camera.intrinsics.height as usize);
        let flow = |folder: &Path| {
            let (path, array) = read_array(folder, &view.name, "flow")?;
            if array.shape == [height, width, 2] {
                return Ok(array.values);
            }
            let message = format!("the flow has shape {:?} instead of [{height}, {width}, 2]", array.shape);
            Err(Failure::new(FailureKind::BadInput, message).at(path))
        };
        Ok((index, flow_difference(&flow(&folders[0])?, &flow(&folders[1])?)))
    };
    for (index, value) in later.par_iter().map(difference).collect::<Result<Vec<_>, Failure>>()? {
        images[index].values.insert(Metric::FlowOfVideo, Score::Value(value));
    }
    Ok(())
}

/// Reads one finite feature vector.
fn read(folder: &Path, name: &str) -> Result<Vec<f64>, Failure> {
    Ok(read_array(folder, name, "feature vector")?.1.values)
}

/// Reads the finite array of a view; returns its file, too.
fn read_array(folder: &Path, name: &str, what: &str) -> Result<(PathBuf, npy_file::NpyArray), Failure> {
    let path = folder.join(format!("{name}.npy"));
    if !path.is_file() {
        return Err(Failure::new(FailureKind::MissingData, format!("view {name} has no {what}")).at(path));
    }
    let bad = |message: String| Failure::new(FailureKind::BadInput, message).at(&path);
    let array = npy_file::read(&path).map_err(|error| bad(error.message))?;
    match array.values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(bad(format!("value {at} is {}", array.values[at]))),
        None => Ok((path, array)),
    }
}

/// Refuses features that were computed from other renders.
fn check_hashes(set: &TestSet<'_>, folder: &Path) -> anyhow::Result<()> {
    let path = folder.join(HASHES);
    let hint =
        "run in the folder of the renders: sha256sum *.png > images.sha256, then compute the features of these images";
    let failure = |kind, message: String| Failure::new(kind, message).hint(hint).at(&path);
    let text = std::fs::read_to_string(&path).map_err(|error| {
        failure(FailureKind::MissingData, format!("cannot read the hashes of the images with features: {error}"))
    })?;
    let hashes: BTreeMap<&str, &str> = text
        .lines()
        .filter_map(|line| line.split_once(char::is_whitespace))
        .map(|(hash, file)| (file.trim_start().trim_start_matches('*').trim_end_matches(".png"), hash))
        .collect();
    for (rendered, view) in &set.views {
        let found = Digest::of_file(&set.renders.image_path(rendered))?.to_string();
        let message = match hashes.get(view.name.as_str()) {
            Some(hash) if *hash == found => continue,
            Some(_) => format!("the features belong to another render of {}", view.name),
            None => format!("there are no features of {}", view.name),
        };
        return Err(failure(FailureKind::BadInput, message).into());
    }
    Ok(())
}
