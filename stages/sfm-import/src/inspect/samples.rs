//! Statistics of a few decoded images of a capture.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};

use engine::Failure;
use image::DynamicImage;
use rayon::prelude::*;
use scene::Split;
use serde::Serialize;

use crate::error::Result;
use crate::source::{Frame, SourceCapture};

/// Maximum number of decoded pixels: about a quarter of a second per core.
const PIXELS: u64 = 24_000_000;
/// Only the first frames of a video are decoded, because a frame costs as much as all before it.
const VIDEO_FRAMES: u32 = 30;
/// Largest difference of a channel from white or black that compression causes.
const TOLERANCE: u8 = 2;
/// Mean share of pixels that equal the background, and of opaque pixels among all that do so, from which a white object on
/// white is suspected: above any overexposed sky or white shirt.
const WHITE_ON_WHITE: [f64; 2] = [0.75, 0.1];
/// Share of the pixels below which a subject is tiny: one of 100 pixels width is seen at 20×25.
const TINY_SHARE: f64 = 0.05;

/// Statistics of a few training images, evenly spread over the capture.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Samples {
    /// Number of decoded images.
    pub decoded: usize,
    /// Smallest and largest share of pixels that equal a white background after compositing.
    pub background_share: [f64; 2],
    /// Smallest and largest share of pixels that are opaque and white.
    pub opaque_white_share: [f64; 2],
    /// Smallest and largest share of pixels that are opaque and black.
    pub opaque_black_share: [f64; 2],
    /// Mean shares of pixels that equal a white background, and that are opaque and white.
    pub mean_shares: [f64; 2],
    /// Number of decoded images with a single colour.
    pub constant: usize,
    /// Whether all decoded images are equal.
    pub equal: bool,
}

/// Statistics of one image.
struct Sample {
    transparent: f64,
    white: f64,
    black: f64,
    is_constant: bool,
    digest: u64,
}

impl Samples {
    /// Decodes at most `images` of the training split. Images that cannot be decoded are errors.
    pub(super) fn of(source: &SourceCapture, images: usize) -> (Self, Vec<Failure>) {
        let chosen = chosen(source, images);
        let decoded: Vec<Result<Sample>> = chosen.par_iter().map(|frame| Sample::of(frame)).collect();
        let (mut samples, mut failures) = (Vec::new(), Vec::new());
        for sample in decoded {
            match sample {
                Ok(sample) => samples.push(sample),
                Err(failure) => failures.push(failure),
            }
        }
        let range = |share: &dyn Fn(&Sample) -> f64| {
            let shares = samples.iter().map(share);
            shares.fold([1.0, 0.0], |[low, high]: [f64; 2], share| [low.min(share), high.max(share)])
        };
        let mean =
            |share: &dyn Fn(&Sample) -> f64| samples.iter().map(share).sum::<f64>() / samples.len().max(1) as f64;
        let summary = Self {
            decoded: samples.len(),
            background_share: range(&|sample| sample.transparent + sample.white),
            opaque_white_share: range(&|sample| sample.white),
            opaque_black_share: range(&|sample| sample.black),
            mean_shares: [mean(&|sample| sample.transparent + sample.white), mean(&|sample| sample.white)],
            constant: samples.iter().filter(|sample| sample.is_constant).count(),
            equal: samples.len() > 1 && samples.iter().all(|sample| sample.digest == samples[0].digest),
        };
        (summary, failures)
    }

    /// Whether a black background is safer than the default white one, because opaque parts of the images are white.
    pub(super) fn suggest_black(&self) -> bool {
        let is_white = self.mean_shares.iter().zip(WHITE_ON_WHITE).all(|(share, least)| *share >= least);
        is_white && self.opaque_white_share[1] > self.opaque_black_share[1]
    }

    /// Problems that will degrade a training.
    pub(super) fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let [least, most] = self.background_share;
        if self.equal {
            warnings.push(format!("the {} decoded images are equal: the capture shows one view", self.decoded));
        } else if self.constant > 0 {
            warnings.push(format!("{} of {} decoded images have a single colour", self.constant, self.decoded));
        }
        if self.suggest_black() {
            let (share, opaque) = (percent([least, most]), percent(self.opaque_white_share));
            warnings.push(format!(
                "{share} of the pixels equal the background (white), although {opaque} are opaque: a model cannot separate them \
                 from nothing and may lose all Gaussians; set background = \"black\""
            ));
        }
        if self.decoded > 0 && self.constant < self.decoded && 1.0 - least <= TINY_SHARE {
            warnings.push(format!(
                "the subject covers only {} of the pixels: crop the images around it, or keep their full width",
                percent([1.0 - most, 1.0 - least])
            ));
        }
        warnings
    }

    /// The line of the report.
    pub(super) fn text(&self) -> String {
        let noun = if self.decoded == 1 { "image" } else { "images" };
        let share = percent(self.background_share);
        format!("{share} equal the background (white) in {} decoded {noun}", self.decoded)
    }
}

/// The training frames to decode.
fn chosen(source: &SourceCapture, images: usize) -> Vec<&Frame> {
    let is_near = |frame: &&Frame| frame.in_video().is_none_or(|place| place.index < VIDEO_FRAMES);
    let train: Vec<&Frame> = source.frames.iter().filter(|frame| frame.split == Split::Train).filter(is_near).collect();
    let size = train.first().map_or(1, |frame| {
        let intrinsics = frame.lens.intrinsics;
        u64::from(intrinsics.width) * u64::from(intrinsics.height)
    });
    let affordable = usize::try_from(PIXELS / size.max(1)).unwrap_or(images);
    let count = affordable.clamp(1, images).min(train.len());
    (0..count).map(|index| train[(2 * index + 1) * train.len() / (2 * count)]).collect()
}

impl Sample {
    fn of(frame: &Frame) -> Result<Self> {
        let image = frame.decode()?;
        let has_alpha = image.color().has_alpha();
        let image =
            if has_alpha { DynamicImage::from(image.into_rgba8()) } else { DynamicImage::from(image.into_rgb8()) };
        let (bytes, channels) = (image.as_bytes(), if has_alpha { 4 } else { 3 });
        let mut counts = [0_u64; 3];
        for pixel in bytes.chunks_exact(channels) {
            let is_opaque = channels == 3 || pixel[3] >= 255 - TOLERANCE;
            counts[0] += u64::from(channels == 4 && pixel[3] == 0);
            counts[1] += u64::from(is_opaque && pixel[..3].iter().all(|value| *value >= 255 - TOLERANCE));
            counts[2] += u64::from(is_opaque && pixel[..3].iter().all(|value| *value <= TOLERANCE));
        }
        let pixels = (bytes.len() / channels).max(1) as f64;
        let [transparent, white, black] = counts.map(|count| count as f64 / pixels);
        let mut hasher = DefaultHasher::new();
        bytes.hash(&mut hasher);
        let first = &bytes[..channels.min(bytes.len())];
        let is_constant = bytes.chunks_exact(channels).all(|pixel| pixel == first);
        Ok(Self { transparent, white, black, is_constant, digest: hasher.finish() })
    }
}

/// A range of shares, e.g. `92–97 %`.
fn percent([low, high]: [f64; 2]) -> String {
    let round = |share: f64| match share {
        0.0 => "0".to_owned(),
        small if small < 0.1 => format!("{:.1}", 100.0 * small),
        share => format!("{:.0}", 100.0 * share),
    };
    let (low, high) = (round(low), round(high));
    if low == high { format!("{low} %") } else { format!("{low}–{high} %") }
}
