//! The columns of tables: name, unit, direction and decimals of every measured value.

use engine::names_hint;
use metric_evaluation::{MaskName, Metric};
use serde::de::IntoDeserializer as _;
use serde::de::value::Error;
use serde::{Deserialize, Serialize};

/// A measured value of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", try_from = "String")]
pub enum Column {
    /// Seconds of training, evaluation excluded.
    TrainingSecs,
    /// Number of Gaussians in the model.
    Gaussians,
    /// Size of the model's tensors, 10⁶ bytes.
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
    /// Seconds of training until the PSNR of the curve (in dB) first reached 95 % of its last value.
    #[serde(rename = "secs_to_95")]
    SecsTo95,
    /// Seconds of training until the PSNR of the curve (in dB) first reached 99 % of its last value.
    #[serde(rename = "secs_to_99")]
    SecsTo99,
    /// Seconds of training until the PSNR of the curve first reached 25 dB.
    #[serde(rename = "secs_to_25_db")]
    SecsTo25Db,
    /// Seconds of training until the PSNR of the curve first reached 30 dB.
    #[serde(rename = "secs_to_30_db")]
    SecsTo30Db,
    /// Seconds of training until the PSNR of the curve first reached 35 dB.
    #[serde(rename = "secs_to_35_db")]
    SecsTo35Db,
    /// PSNR of the last evaluation within 10 seconds of training.
    #[serde(rename = "psnr_at_10s")]
    PsnrAt10s,
    /// PSNR of the last evaluation within one minute of training.
    #[serde(rename = "psnr_at_60s")]
    PsnrAt60s,
    /// PSNR of the last evaluation within five minutes of training.
    #[serde(rename = "psnr_at_300s")]
    PsnrAt300s,
    /// PSNR of the last evaluation of the curve.
    PsnrAtEnd,
    /// Milliseconds per training iteration.
    MsPerIteration,
    /// Peak resident memory of the training process, 10⁶ bytes.
    PeakMemoryMb,
    /// PSNR above that of the best constant image, dB.
    #[serde(rename = "psnr_above_constant")]
    AboveConstant,
    /// PSNR of the best constant image; the same for all methods of a scene.
    PsnrConstant,
    /// PSNR of the mean of the other images (see [`metric_evaluation::MeanImage`]); the same for all methods of a scene.
    PsnrMeanImage,
    /// Prompt IoU of the best constant answer; the same for all models with the same prompts.
    PromptIouConstant,
    /// Prompt IoU of the places where other images show the class; the same for all models with the same prompts.
    PromptIouPrior,
    /// A metric of the stage `metric-evaluation`.
    #[serde(untagged)]
    Metric(Metric),
    /// A metric over the pixels of a mask.
    #[serde(untagged)]
    Masked(Masked),
}

/// A masked metric together with its mask, without which it has no meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(into = "&'static str")]
pub struct Masked {
    /// The metric.
    pub metric: Metric,
    /// The mask.
    pub mask: MaskName,
}

/// The names of a masked metric in files, by mask in the order of [`MaskName::ALL`].
macro_rules! masked_keys {
    ($metric:literal) => {
        [
            concat!($metric, "_co_visibility"),
            concat!($metric, "_foreground"),
            concat!($metric, "_labels"),
            concat!($metric, "_other"),
        ]
    };
}

impl Masked {
    /// Every masked metric with every mask.
    fn all() -> impl Iterator<Item = Self> {
        let masked = Metric::ALL.into_iter().filter(|metric| metric.is_masked());
        masked.flat_map(|metric| MaskName::ALL.map(|mask| Self { metric, mask }))
    }

    fn key(self) -> &'static str {
        let keys = match self.metric {
            Metric::MaskedPsnr => masked_keys!("masked_psnr"),
            Metric::MaskedSsim => masked_keys!("masked_ssim"),
            Metric::MaskedSsimStrict => masked_keys!("masked_ssim_strict"),
            Metric::MaskedLpips => masked_keys!("masked_lpips"),
            metric => [metric.key(); 4],
        };
        keys[self.mask as usize]
    }
}

impl From<Masked> for &'static str {
    fn from(masked: Masked) -> Self {
        masked.key()
    }
}

impl TryFrom<String> for Column {
    type Error = String;

    /// Files have the names of [`Column::key`], and metrics also those of parameters.
    fn try_from(name: String) -> Result<Self, String> {
        let as_parameter = || Metric::deserialize(name.as_str().into_deserializer()).map(Self::Metric);
        Self::named(&name).or_else(|unknown| as_parameter().map_err(|_: Error| unknown))
    }
}

impl Column {
    /// PSNR: the value that ranks methods and that papers print.
    pub const PSNR: Self = Self::Metric(Metric::Psnr);

    /// Metrics of tasks other than the images: a loss may change them and leave PSNR unchanged.
    pub(crate) const TASKS: [Self; 3] =
        [Self::Metric(Metric::VelocityError), Self::Metric(Metric::FlowError), Self::Metric(Metric::PromptIou)];

    /// All columns other than the metrics of the evaluation stage, in the order of the CSV file.
    const COSTS: [Self; 23] = [
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
        Self::AboveConstant,
        Self::PsnrConstant,
        Self::PsnrMeanImage,
        Self::PromptIouConstant,
        Self::PromptIouPrior,
    ];

    /// The columns of the headline table.
    pub(crate) const HEADLINE: [Self; 11] = [
        Self::PSNR,
        Self::AboveConstant,
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

    /// Seconds to a share of the run's last PSNR.
    pub(crate) const TIME_TO_SHARE: [Self; 3] = [Self::SecsTo90, Self::SecsTo95, Self::SecsTo99];

    /// Seconds to a fixed PSNR.
    pub(crate) const TIME_TO_DB: [Self; 3] = [Self::SecsTo25Db, Self::SecsTo30Db, Self::SecsTo35Db];

    /// PSNR within a deadline, and without one.
    pub(crate) const BUDGETS: [Self; 4] = [Self::PsnrAt10s, Self::PsnrAt60s, Self::PsnrAt300s, Self::PsnrAtEnd];

    /// All columns, in the order of the CSV file.
    pub fn all() -> impl Iterator<Item = Self> {
        let unmasked = Metric::ALL.into_iter().filter(|metric| !metric.is_masked()).map(Self::Metric);
        unmasked.chain(Masked::all().map(Self::Masked)).chain(Self::COSTS)
    }

    /// Metrics that need more than images (exact maps, labels, masks, a static camera), which few captures provide; prompt IoU
    /// is followed by that of answers that need no model.
    pub(crate) fn conditional() -> impl Iterator<Item = Self> {
        let with_trivial = |metric| match metric {
            Metric::PromptIou => vec![Self::Metric(metric), Self::PromptIouConstant, Self::PromptIouPrior],
            metric => vec![Self::Metric(metric)],
        };
        let unmasked = Metric::ALL.into_iter().filter(|metric| metric.is_conditional() && !metric.is_masked());
        Masked::all().map(Self::Masked).chain(unmasked.flat_map(with_trivial))
    }

    /// The metric of the evaluation stage that the column has, if any.
    pub fn metric(self) -> Option<Metric> {
        match self {
            Self::Metric(metric) | Self::Masked(Masked { metric, .. }) => Some(metric),
            _ => None,
        }
    }

    /// The column with a name of [`Column::key`]. The error suggests the nearest name and lists all names.
    pub fn named(name: &str) -> Result<Self, String> {
        let unknown = || format!("no column is called `{name}`; {}", names_hint(name, Self::all().map(Self::key)));
        Self::all().find(|column| column.key() == name).ok_or_else(unknown)
    }

    /// The column's name in files, e.g. `training_secs`.
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
            Self::AboveConstant => "psnr_above_constant",
            Self::PsnrConstant => "psnr_constant",
            Self::PsnrMeanImage => "psnr_mean_image",
            Self::PromptIouConstant => "prompt_iou_constant",
            Self::PromptIouPrior => "prompt_iou_prior",
            Self::Metric(metric) => metric.key(),
            Self::Masked(masked) => masked.key(),
        }
    }

    /// The column's name and unit in tables, e.g. `training (s)`.
    pub fn heading(self) -> String {
        if let Self::Masked(Masked { metric, mask }) = self {
            let unit = if metric.unit().is_empty() { String::new() } else { format!(" ({})", metric.unit()) };
            return format!("{}, {}{unit}", metric.heading(), mask.heading());
        }
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
            Self::PsnrAtEnd => ("at the end", "dB"),
            Self::MsPerIteration => ("iteration", "ms"),
            Self::PeakMemoryMb => ("peak memory", "MB"),
            Self::AboveConstant => ("above best constant image", "dB"),
            Self::PsnrConstant => ("best constant image", "dB"),
            Self::PsnrMeanImage => ("mean of the other images", "dB"),
            Self::PromptIouConstant => ("prompt IoU, best constant answer", ""),
            Self::PromptIouPrior => ("prompt IoU, spatial prior", ""),
            Self::Metric(metric) | Self::Masked(Masked { metric, .. }) => (metric.heading(), metric.unit()),
        };
        if unit.is_empty() { name.into() } else { format!("{name} ({unit})") }
    }

    /// Number of decimals in tables; ranks compare values rounded to them.
    pub fn decimals(self) -> usize {
        match self {
            Self::Gaussians => 0,
            Self::SizeMb | Self::MsPerIteration => 2,
            Self::PsnrAt10s | Self::PsnrAt60s | Self::PsnrAt300s | Self::PsnrAtEnd => Metric::Psnr.decimals(),
            Self::AboveConstant | Self::PsnrConstant | Self::PsnrMeanImage => Metric::Psnr.decimals(),
            Self::PeakMemoryMb => 0,
            Self::PromptIouConstant | Self::PromptIouPrior => Metric::PromptIou.decimals(),
            _ => self.metric().map_or(1, Metric::decimals),
        }
    }

    /// Whether a higher value is better.
    pub fn higher_is_better(self) -> bool {
        let is_rate = matches!(self, Self::FpsRaster | Self::FpsModel | Self::FpsDelivered);
        self.metric().map_or(is_rate || Self::BUDGETS.contains(&self) || self.is_of_trivial(), Metric::higher_is_better)
    }

    /// Whether the value depends on the machine; such values are ranked only if one machine measured all of them.
    pub fn is_timing(self) -> bool {
        let is_count = matches!(self, Self::Gaussians | Self::SizeMb | Self::PsnrAtEnd);
        self.metric().is_none() && !is_count && !self.is_of_trivial()
    }

    /// Whether the value is the time until a quality was reached; a run that never reached it has no value.
    pub(crate) fn is_time_to_quality(self) -> bool {
        Self::TIME_TO_SHARE.contains(&self) || Self::TIME_TO_DB.contains(&self)
    }

    /// Whether the value is about images that need no model.
    fn is_of_trivial(self) -> bool {
        matches!(
            self,
            Self::AboveConstant
                | Self::PsnrConstant
                | Self::PsnrMeanImage
                | Self::PromptIouConstant
                | Self::PromptIouPrior
        )
    }
}
