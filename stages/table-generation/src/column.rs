//! The figures that tables are made of: name, unit, direction and decimals of each, once.

use metric_evaluation::Metric;
use serde::{Deserialize, Serialize};

/// One figure of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Column {
    /// Seconds of training without evaluation.
    TrainingSecs,
    /// Gaussians in the model.
    Gaussians,
    /// Bytes of the model's tensors / 10⁶.
    SizeMb,
    /// Frames per second of the rasteriser alone (median).
    FpsRaster,
    /// Frames per second of motion model and rasteriser (median).
    FpsModel,
    /// Frames per second of delivered images: motion model, rasteriser, 8-bit conversion and encoding (median).
    FpsDelivered,
    /// Seconds of training until the PSNR of the curve (in dB) first reached 90 % of its last value.
    #[serde(rename = "secs_to_90")]
    SecsTo90,
    /// The same for 95 %.
    #[serde(rename = "secs_to_95")]
    SecsTo95,
    /// The same for 99 %.
    #[serde(rename = "secs_to_99")]
    SecsTo99,
    /// Seconds of training until the PSNR of the curve first reached 25 dB.
    #[serde(rename = "secs_to_25_db")]
    SecsTo25Db,
    /// The same for 30 dB.
    #[serde(rename = "secs_to_30_db")]
    SecsTo30Db,
    /// The same for 35 dB.
    #[serde(rename = "secs_to_35_db")]
    SecsTo35Db,
    /// PSNR of the curve after 10 seconds of training: what a deadline would have got.
    #[serde(rename = "psnr_at_10s")]
    PsnrAt10s,
    /// The same after a minute.
    #[serde(rename = "psnr_at_60s")]
    PsnrAt60s,
    /// The same after five minutes.
    #[serde(rename = "psnr_at_300s")]
    PsnrAt300s,
    /// PSNR of the curve at its end.
    PsnrAtEnd,
    /// Milliseconds per training iteration.
    MsPerIteration,
    /// Largest resident memory of the training process / 10⁶ bytes.
    PeakMemoryMb,
    /// What metric-evaluation measured.
    #[serde(untagged)]
    Metric(Metric),
}

impl Column {
    /// The figure that ranks methods and that papers print.
    pub const PSNR: Self = Self::Metric(Metric::Psnr);

    /// What a run is measured by beside metrics, in the order of the CSV file.
    const COSTS: [Self; 18] = [
        Self::TrainingSecs,
        Self::Gaussians,
        Self::SizeMb,
        Self::FpsRaster,
        Self::FpsModel,
        Self::FpsDelivered,
        Self::SecsTo90,
        Self::SecsTo95,
        Self::SecsTo99,
        Self::SecsTo25Db,
        Self::SecsTo30Db,
        Self::SecsTo35Db,
        Self::PsnrAt10s,
        Self::PsnrAt60s,
        Self::PsnrAt300s,
        Self::PsnrAtEnd,
        Self::MsPerIteration,
        Self::PeakMemoryMb,
    ];

    /// The columns of the headline table.
    pub const HEADLINE: [Self; 10] = [
        Self::PSNR,
        Self::Metric(Metric::Ssim),
        Self::Metric(Metric::MsSsim),
        Self::Metric(Metric::LpipsAlex),
        Self::TrainingSecs,
        Self::Gaussians,
        Self::SizeMb,
        Self::FpsRaster,
        Self::FpsModel,
        Self::FpsDelivered,
    ];

    /// Seconds to a share of the run's own last PSNR.
    pub const TIME_TO_SHARE: [Self; 3] = [Self::SecsTo90, Self::SecsTo95, Self::SecsTo99];

    /// Seconds to a fixed PSNR.
    pub const TIME_TO_DB: [Self; 3] = [Self::SecsTo25Db, Self::SecsTo30Db, Self::SecsTo35Db];

    /// PSNR under a deadline, and without one.
    pub const BUDGETS: [Self; 4] = [Self::PsnrAt10s, Self::PsnrAt60s, Self::PsnrAt300s, Self::PsnrAtEnd];

    /// Every column, in the order of the CSV file.
    pub fn all() -> impl Iterator<Item = Self> {
        Metric::ALL.into_iter().map(Self::Metric).chain(Self::COSTS)
    }

    /// Figures that need more than images (exact maps, labels, masks, a camera at rest), which few captures have.
    pub fn conditional() -> impl Iterator<Item = Self> {
        Metric::ALL.into_iter().filter(|metric| metric.is_conditional()).map(Self::Metric)
    }

    fn metric(self) -> Option<Metric> {
        match self {
            Self::Metric(metric) => Some(metric),
            _ => None,
        }
    }

    /// The name in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::TrainingSecs => "training_secs",
            Self::Gaussians => "gaussians",
            Self::SizeMb => "size_mb",
            Self::FpsRaster => "fps_raster",
            Self::FpsModel => "fps_model",
            Self::FpsDelivered => "fps_delivered",
            Self::SecsTo90 => "secs_to_90",
            Self::SecsTo95 => "secs_to_95",
            Self::SecsTo99 => "secs_to_99",
            Self::SecsTo25Db => "secs_to_25_db",
            Self::SecsTo30Db => "secs_to_30_db",
            Self::SecsTo35Db => "secs_to_35_db",
            Self::PsnrAt10s => "psnr_at_10s",
            Self::PsnrAt60s => "psnr_at_60s",
            Self::PsnrAt300s => "psnr_at_300s",
            Self::PsnrAtEnd => "psnr_at_end",
            Self::MsPerIteration => "ms_per_iteration",
            Self::PeakMemoryMb => "peak_memory_mb",
            Self::Metric(metric) => metric.key(),
        }
    }

    /// The name and unit in tables.
    pub fn heading(self) -> String {
        let (name, unit) = match self {
            Self::TrainingSecs => ("training", "s"),
            Self::Gaussians => ("Gaussians", ""),
            Self::SizeMb => ("size", "MB"),
            Self::FpsRaster => ("FPS raster", ""),
            Self::FpsModel => ("FPS model", ""),
            Self::FpsDelivered => ("FPS delivered", ""),
            Self::SecsTo90 => ("to 90 %", "s"),
            Self::SecsTo95 => ("to 95 %", "s"),
            Self::SecsTo99 => ("to 99 %", "s"),
            Self::SecsTo25Db => ("to 25 dB", "s"),
            Self::SecsTo30Db => ("to 30 dB", "s"),
            Self::SecsTo35Db => ("to 35 dB", "s"),
            Self::PsnrAt10s => ("at 10 s", "dB"),
            Self::PsnrAt60s => ("at 1 min", "dB"),
            Self::PsnrAt300s => ("at 5 min", "dB"),
            Self::PsnrAtEnd => ("full", "dB"),
            Self::MsPerIteration => ("iteration", "ms"),
            Self::PeakMemoryMb => ("peak memory", "MB"),
            Self::Metric(metric) => (metric.heading(), metric.unit()),
        };
        if unit.is_empty() { name.into() } else { format!("{name} ({unit})") }
    }

    /// Decimals in tables; ranks are decided on values rounded to them.
    pub fn decimals(self) -> usize {
        match self {
            Self::Gaussians => 0,
            Self::SizeMb | Self::MsPerIteration => 2,
            Self::PsnrAt10s | Self::PsnrAt60s | Self::PsnrAt300s | Self::PsnrAtEnd => Metric::Psnr.decimals(),
            Self::PeakMemoryMb => 0,
            _ => self.metric().map_or(1, Metric::decimals),
        }
    }

    /// Whether more is better.
    pub fn higher_is_better(self) -> bool {
        let is_rate = matches!(self, Self::FpsRaster | Self::FpsModel | Self::FpsDelivered);
        self.metric().map_or(is_rate || Self::BUDGETS.contains(&self), Metric::higher_is_better)
    }

    /// Whether the value depends on the machine, so that ranks need one machine.
    pub fn is_timing(self) -> bool {
        self.metric().is_none() && !matches!(self, Self::Gaussians | Self::SizeMb | Self::PsnrAtEnd)
    }
}
