//! Metrics in f64: of images, by the definitions of the splatting literature; of masked images and image sequences; of
//! surfaces and semantics, where a capture has exact maps or labels.

pub(crate) mod language;
pub(crate) mod masked;
pub(crate) mod metric;
mod ms_ssim;
pub(crate) mod prompt_prior;
pub(crate) mod psnr;
pub(crate) mod score;
mod ssim;
pub(crate) mod surfaces;
#[cfg(test)]
mod tests;
pub(crate) mod trivial;
pub(crate) mod video;

use std::collections::{BTreeMap, BTreeSet};

use self::metric::Metric;
use self::ms_ssim::ms_ssim;
use self::psnr::{mean_squared_error, psnr_from_mse};
use self::score::Score;
use self::ssim::{SsimMeans, ssim_means};
use crate::image_file::Image;

/// Computes the wanted metrics of a render and its ground truth, which must have equal sizes.
///
/// The three SSIM metrics share the window sums of the full-resolution images.
pub(crate) fn image_scores(render: &Image, truth: &Image, wanted: &BTreeSet<Metric>) -> BTreeMap<Metric, Score> {
    let mut scores = BTreeMap::new();
    if wanted.contains(&Metric::Psnr) {
        scores.insert(Metric::Psnr, Score::Value(psnr_from_mse(mean_squared_error(render, truth))));
    }
    let similarity = [Metric::Ssim, Metric::SsimValid, Metric::MsSsim];
    if similarity.iter().any(|metric| wanted.contains(metric)) {
        let channels = [0, 1, 2].map(|c| ssim_means(&render.planes[c], &truth.planes[c], render.width));
        let mut all = BTreeMap::from([
            (Metric::Ssim, Score::Value(channels.iter().map(|means| means.zero_padded).sum::<f64>() / 3.0)),
            (Metric::SsimValid, mean_of_channels(&channels, |means| means.valid)),
            (Metric::MsSsim, ms_ssim(render, truth, &channels)),
        ]);
        all.retain(|metric, _| wanted.contains(metric));
        scores.append(&mut all);
    }
    scores
}

/// The mean over three channels of a value that needs at least one window inside the image.
fn mean_of_channels(channels: &[SsimMeans; 3], value: impl Fn(&SsimMeans) -> Option<f64>) -> Score {
    match channels.iter().map(value).sum::<Option<f64>>() {
        Some(sum) => Score::Value(sum / 3.0),
        None => Score::undefined(format!("image smaller than {} px", ssim::TAPS)),
    }
}
