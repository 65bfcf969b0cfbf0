//! Motion seen by a static camera: pixels that differ from the temporal median of the camera's images.

use captures::per_view;
use engine::{Failure, FailureKind, JobContext};
use image::RgbImage;
use scene::{Capture, Mask, Split, View};

use crate::Params;

/// Minimum number of training images of a camera pose: the median of fewer images may show moving objects.
const MIN_IMAGES: usize = 5;
/// Maximum number of images in a median, evenly spread over time.
const MAX_IMAGES: usize = 31;

/// The moving pixels of every training view; none for held-out views, whose images must not reach training.
pub(crate) fn masks(context: &JobContext, capture: &Capture, params: &Params) -> anyhow::Result<Vec<Option<Mask>>> {
    let train: Vec<&View> = capture.views_of(Split::Train).map(|(_, view)| view).collect();
    let mut poses: Vec<Vec<&View>> = Vec::new();
    for view in train {
        match poses.iter_mut().find(|pose| pose[0].camera == view.camera) {
            Some(pose) => pose.push(view),
            None => poses.push(vec![view]),
        }
    }
    if poses.iter().any(|pose| pose.len() < MIN_IMAGES) {
        let message = format!("a temporal median needs {MIN_IMAGES} training images of every camera pose");
        let hint = "cameras that move need another source, e.g. \"residual-flow\"";
        return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(&capture.dir).into());
    }
    let medians = per_view(context, poses.len(), |pose| median(capture, &poses[pose]))?;
    per_view(context, capture.views.len(), |index| {
        let view = &capture.views[index];
        let pose = poses.iter().position(|pose| view.split == Split::Train && pose[0].camera == view.camera);
        let mask = |pose: usize| Ok(moving(&capture.load_image(view)?, &medians[pose], params));
        pose.map(mask).transpose()
    })
}

/// The median of every channel of every pixel over the images of a camera pose.
fn median(capture: &Capture, views: &[&View]) -> anyhow::Result<Vec<u8>> {
    let count = views.len().min(MAX_IMAGES);
    let chosen = (0..count).map(|at| views[at * (views.len() - 1) / (count - 1)]);
    let images: Vec<RgbImage> = chosen.map(|view| Ok(capture.load_image(view)?)).collect::<anyhow::Result<_>>()?;
    let of_value = |at: usize| {
        let mut values: Vec<u8> = images.iter().map(|image| image.as_raw()[at]).collect();
        *values.select_nth_unstable(count / 2).1
    };
    Ok((0..images[0].as_raw().len()).map(of_value).collect())
}

/// The pixels with a channel that differs from the median, and their surroundings.
fn moving(image: &RgbImage, median: &[u8], params: &Params) -> Mask {
    let differs = |(value, median): (&u8, &u8)| f64::from(value.abs_diff(*median)) > 255.0 * params.min_difference;
    let pixels = image.as_raw().chunks_exact(3).zip(median.chunks_exact(3));
    let inside = pixels.map(|(pixel, median)| pixel.iter().zip(median).any(differs)).collect();
    Mask { width: image.width(), height: image.height(), inside }.dilated(params.dilation_px)
}
