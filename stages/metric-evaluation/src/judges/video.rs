//! Adds the figures of images of one camera in the order of time.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Digest, Failure, FailureKind};
use rayon::prelude::*;
use scene::npy_file;

use crate::metrics::{consistencies, flow_difference, residual_change};
use crate::test_set::TestSet;
use crate::{ImageMetrics, Metric, MetricEvaluationParams, Score};

/// The file that says which images the features were computed from, as `sha256sum` writes it.
const HASHES: &str = "images.sha256";
/// Folders of optical flow from the image before, px, [H, W, 2]: of the renders and of the true images.
const FLOWS: [&str; 2] = ["flow_of_renders", "flow_of_truth"];
/// Folders of feature vectors.
const FEATURES: [(Metric, &str); 2] =
    [(Metric::SubjectConsistency, "subject"), (Metric::BackgroundConsistency, "background")];

/// Adds flicker, and where `features` is a folder of what networks say of the renders, consistency and tOF.
pub fn add(
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

/// Positions of a set's images by camera, in the order of time.
fn videos(set: &TestSet<'_>) -> impl Iterator<Item = Vec<usize>> {
    let mut videos = BTreeMap::<u32, Vec<usize>>::new();
    for (index, (_, view)) in set.views.iter().enumerate() {
        videos.entry(view.camera_index).or_default().push(index);
    }
    // The capture's order within a split is that of time.
    videos.into_values()
}

/// The change of the error from each image to the next of a camera that stands still; a camera that moves has no flicker,
/// because the same pixel shows something else.
fn add_flicker(images: &mut [ImageMetrics], set: &TestSet<'_>, params: &MetricEvaluationParams) -> anyhow::Result<()> {
    let neighbours: Vec<[usize; 2]> =
        videos(set).flat_map(|video| video.array_windows().copied().collect::<Vec<_>>()).collect();
    let is_at_rest = |[before, after]: &[usize; 2]| set.views[*before].1.camera == set.views[*after].1.camera;
    let flicker = |[before, after]: [usize; 2]| -> anyhow::Result<(usize, f64)> {
        let ([r0, t0], [r1, t1]) = (set.images(before, params)?, set.images(after, params)?);
        Ok((after, residual_change([&r0, &t0], [&r1, &t1])))
    };
    let found: Vec<_> = neighbours.into_par_iter().filter(is_at_rest).map(flicker).collect::<Result<_, _>>()?;
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
            let message = format!("{} values where {} are expected", features[odd].len(), features[0].len());
            let path = folder.join(format!("{}.npy", set.views[video[odd]].1.name));
            return Err(Failure::new(FailureKind::BadInput, message).at(path));
        }
        for (&index, value) in video[1..].iter().zip(consistencies(&features)) {
            images[index].values.insert(metric, Score::Value(value));
        }
    }
    Ok(())
}

/// tOF of every image after the first of its camera.
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
            let message = format!("flow of shape {:?} where [{height}, {width}, 2] is expected", array.shape);
            Err(Failure::new(FailureKind::BadInput, message).at(path))
        };
        Ok((index, flow_difference(&flow(&folders[0])?, &flow(&folders[1])?)))
    };
    for (index, value) in later.par_iter().map(difference).collect::<Result<Vec<_>, Failure>>()? {
        images[index].values.insert(Metric::FlowOfVideo, Score::Value(value));
    }
    Ok(())
}

/// One finite feature vector.
fn read(folder: &Path, name: &str) -> Result<Vec<f64>, Failure> {
    Ok(read_array(folder, name, "feature vector")?.1.values)
}

/// A finite array that belongs to a view, and its file.
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

/// Features of other renders than these say nothing about these.
fn check_hashes(set: &TestSet<'_>, folder: &Path) -> anyhow::Result<()> {
    let path = folder.join(HASHES);
    let hint =
        "in the folder of the renders: sha256sum *.png > images.sha256, then compute the features of these images";
    let failure = |kind, message: String| Failure::new(kind, message).hint(hint).at(&path);
    let text = std::fs::read_to_string(&path).map_err(|error| {
        failure(FailureKind::MissingData, format!("cannot read which images have features: {error}"))
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
            Some(_) => format!("features of another render of {}", view.name),
            None => format!("no features of {}", view.name),
        };
        return Err(failure(FailureKind::BadInput, message).into());
    }
    Ok(())
}
