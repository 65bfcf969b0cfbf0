//! Stage `metric-evaluation`: judges images, whoever made them, against the true ones.
//!
//! [`MetricEvaluation`] is the stage; [`evaluate_folders`] judges two folders of images outside any run; the
//! functions of [`metrics`] judge one pair.

mod artifact;
mod folders;
mod image_file;
mod judges;
pub mod lpips;
pub mod metrics;
mod params;
mod run;
#[cfg(test)]
mod stage_tests;
mod summary;
#[cfg(test)]
mod test_images;
mod test_set;
#[cfg(test)]
mod tests;

pub use artifact::{ImageMetrics, METRIC_VERSION, Metrics, Remark};
pub use folders::{evaluate_folders, evaluate_folders_with};
pub use image_file::{Background, Image};
pub use metrics::{Metric, Score};
pub use params::{Keep, MaskSource, MetricEvaluationParams, Quantise};
pub use run::{MetricEvaluation, Pair, evaluate_pairs};
