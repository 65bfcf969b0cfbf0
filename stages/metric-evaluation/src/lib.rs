#![doc = include_str!("../README.md")]

mod artifact;
mod folders;
mod image_file;
mod lpips;
mod masks;
mod metrics;
mod pairs;
mod params;
mod run;
mod scoring;
mod summary;
mod test_set;
#[cfg(test)]
mod tests;

pub use artifact::{ImageMetrics, Metrics, Remark};
pub use folders::{evaluate_folders, evaluate_folders_with};
pub use image_file::{Background, Quantise};
pub use lpips::weights::lpips_files;
pub use masks::{Keep, LabelMask, MaskFiles, MaskName, Masks};
pub use metrics::metric::Metric;
pub use metrics::prompt_prior::TrivialOverlap;
pub use metrics::score::Score;
pub use metrics::surfaces::MovingError;
pub use metrics::trivial::{Degenerate, MeanImage, MeanOver, Trivial};
pub use params::{LPIPS_FOLDER, MetricEvaluationParams};
pub use run::MetricEvaluation;
pub use scoring::perceptual::missing_weights;
