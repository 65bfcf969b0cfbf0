//! The metrics: name, unit, direction and decimals of each.

use serde::{Deserialize, Serialize};

/// A quality metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// PSNR per image in dB; the value of a set is the mean over its images.
    Psnr,
    /// PSNR in dB of the mean squared error over all images (the convention of NeRF); defined for a set only.
    PsnrPooled,
    /// SSIM of 3D Gaussian Splatting: 11-tap Gaussian window, σ = 1.5, zero padding, mean over pixels and channels.
    Ssim,
    /// SSIM with the same window, over windows inside the image (scikit-image, D-NeRF, `tf.image.ssim`).
    SsimValid,
    /// Multi-scale SSIM over five scales (`pytorch_msssim`).
    MsSsim,
    /// LPIPS 0.1 with AlexNet, for colours in [-1, 1].
    LpipsAlex,
    /// LPIPS 0.1 with VGG-16, for colours in [-1, 1].
    LpipsVgg,
    /// LPIPS 0.1 with SqueezeNet 1.1, for colours in [-1, 1].
    LpipsSqueeze,
    /// LPIPS with AlexNet and colours in [0, 1], a mistake in the code of 3D Gaussian Splatting; lower than LPIPS.
    LpipsAlexLegacy,
    /// LPIPS with VGG-16 and colours in [0, 1], a mistake in the code of 3D Gaussian Splatting; lower than LPIPS.
    LpipsVggLegacy,
    /// PSNR over the pixels of a mask.
    MaskedPsnr,
    /// SSIM by partial convolution over a mask, mean over all windows (DyCheck). Windows outside the mask count as
    /// equal, so that the value increases as the mask shrinks.
    MaskedSsim,
    /// SSIM over the masked pixels of each window, whose weights sum to 1; mean over the windows that are centred on a
    /// masked pixel.
    MaskedSsimStrict,
    /// LPIPS (AlexNet) per pixel of images that are black outside a mask, mean over the mask (DyCheck).
    MaskedLpips,
    /// Mean absolute change of the error between consecutive images of a fixed camera.
    Flicker,
    /// Mean cosine of an image's subject features with those of the previous and of the first image of its camera (VBench);
    /// the features are supplied.
    SubjectConsistency,
    /// Mean cosine of an image's background features with those of the previous and of the first image of its camera
    /// (VBench); the features are supplied.
    BackgroundConsistency,
    /// Difference between the optical flow in the video of the renders and in that of the ground truth (tOF); both flows
    /// are supplied.
    FlowOfVideo,
    /// PSNR over the pixels whose true surface moves.
    PsnrMoving,
    /// PSNR over pixels whose true surface moves, pooled over images with less than half as many such pixels as the image
    /// with most of them, i.e. while the surface is partly occluded. Defined for a set only.
    PsnrEmerging,
    /// Mean distance between rendered and true velocity of moving surfaces, scene units per second.
    VelocityError,
    /// Mean end-point error of the flow to the next frame on moving surfaces, pixels.
    FlowError,
    /// Mean difference in view-space z where render and ground truth show a surface, scene units.
    DepthError,
    /// Share of the covered pixels of the ground truth where the render covers less than half.
    HoleArea,
    /// Share of pixels where the render shows a surface more than a tenth nearer than the true one, or a surface where
    /// there is none. Pixels without true depth count only if the capture's alpha shows that they are empty.
    FloaterArea,
    /// Intersection over union of the pixels where most of the weight is from moving Gaussians, and the labelled
    /// pixels; for captures without exact velocity, whose labels mark moving objects.
    SilhouetteIou,
    /// Intersection over union of the pixels that a prompt selects and the pixels labelled with its class, mean over the
    /// prompts with visible classes.
    PromptIou,
    /// 1 − cosine between the mean feature of a class in an image and its mean over all images, mean over the visible
    /// classes.
    FeatureDrift,
}

/// The inputs that a metric is computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Family {
    /// Colours of the render and the ground truth.
    Images,
    /// Network features of both images.
    Perceptual,
    /// The masked part of each image.
    Masked,
    /// The image sequence of one camera.
    Video,
    /// Exact maps of surfaces.
    Surfaces,
    /// Labels and the model's semantics.
    Language,
}

/// Names and format of a metric.
struct Definition {
    family: Family,
    key: &'static str,
    heading: &'static str,
    unit: &'static str,
    decimals: usize,
    higher_is_better: bool,
}

impl Metric {
    /// Every metric, in the order of tables.
    pub const ALL: [Self; 28] = [
        Self::Psnr,
        Self::PsnrPooled,
        Self::Ssim,
        Self::SsimValid,
        Self::MsSsim,
        Self::LpipsAlex,
        Self::LpipsVgg,
        Self::LpipsSqueeze,
        Self::LpipsAlexLegacy,
        Self::LpipsVggLegacy,
        Self::MaskedPsnr,
        Self::MaskedSsim,
        Self::MaskedSsimStrict,
        Self::MaskedLpips,
        Self::Flicker,
        Self::SubjectConsistency,
        Self::BackgroundConsistency,
        Self::FlowOfVideo,
        Self::PsnrMoving,
        Self::PsnrEmerging,
        Self::VelocityError,
        Self::FlowError,
        Self::DepthError,
        Self::HoleArea,
        Self::FloaterArea,
        Self::SilhouetteIou,
        Self::PromptIou,
        Self::FeatureDrift,
    ];

    fn definition(self) -> Definition {
        let more = |family, key, heading, unit, decimals| Definition {
            family,
            key,
            heading,
            unit,
            decimals,
            higher_is_better: true,
        };
        let less = |family, key, heading, unit, decimals| Definition {
            higher_is_better: false,
            ..more(family, key, heading, unit, decimals)
        };
        use Family::{Images, Language, Masked, Perceptual, Surfaces, Video};
        // Image metrics have the decimals of the literature.
        match self {
            Self::Psnr => more(Images, "psnr", "PSNR", "dB", 2),
            Self::PsnrPooled => more(Images, "psnr_pooled", "PSNR pooled", "dB", 2),
            Self::Ssim => more(Images, "ssim", "SSIM", "", 4),
            Self::SsimValid => more(Images, "ssim_valid", "SSIM valid", "", 4),
            Self::MsSsim => more(Images, "ms_ssim", "MS-SSIM", "", 4),
            Self::LpipsAlex => less(Perceptual, "lpips_alex", "LPIPS alex", "", 4),
            Self::LpipsVgg => less(Perceptual, "lpips_vgg", "LPIPS vgg", "", 4),
            Self::LpipsSqueeze => less(Perceptual, "lpips_squeeze", "LPIPS squeeze", "", 4),
            Self::LpipsAlexLegacy => less(Perceptual, "lpips_alex_legacy", "LPIPS alex [0,1]", "", 4),
            Self::LpipsVggLegacy => less(Perceptual, "lpips_vgg_legacy", "LPIPS vgg [0,1]", "", 4),
            Self::MaskedPsnr => more(Masked, "masked_psnr", "mPSNR", "dB", 2),
            Self::MaskedSsim => more(Masked, "masked_ssim", "mSSIM", "", 4),
            Self::MaskedSsimStrict => more(Masked, "masked_ssim_strict", "mSSIM strict", "", 4),
            Self::MaskedLpips => less(Masked, "masked_lpips", "mLPIPS", "", 4),
            Self::Flicker => less(Video, "flicker", "flicker", "", 4),
            Self::SubjectConsistency => more(Video, "subject_consistency", "subject consistency", "", 4),
            Self::BackgroundConsistency => more(Video, "background_consistency", "background consistency", "", 4),
            Self::FlowOfVideo => less(Video, "tof", "tOF", "px", 3),
            Self::PsnrMoving => more(Surfaces, "psnr_moving", "PSNR moving", "dB", 2),
            Self::PsnrEmerging => more(Surfaces, "psnr_emerging", "PSNR emerging", "dB", 2),
            Self::VelocityError => less(Surfaces, "velocity_error", "velocity error", "1/s", 3),
            Self::FlowError => less(Surfaces, "flow_error", "flow error", "px", 3),
            Self::DepthError => less(Surfaces, "depth_error", "depth error", "", 4),
            Self::HoleArea => less(Surfaces, "hole_area", "holes", "", 4),
            Self::FloaterArea => less(Surfaces, "floater_area", "floaters", "", 4),
            Self::SilhouetteIou => more(Surfaces, "silhouette_iou", "silhouette IoU", "", 3),
            Self::PromptIou => more(Language, "prompt_iou", "prompt IoU", "", 3),
            Self::FeatureDrift => less(Language, "feature_drift", "feature drift", "", 4),
        }
    }

    /// The name in files and parameters.
    pub fn key(self) -> &'static str {
        self.definition().key
    }

    /// The name in tables.
    pub fn heading(self) -> &'static str {
        self.definition().heading
    }

    /// Number of decimals in tables and rankings.
    pub fn decimals(self) -> usize {
        self.definition().decimals
    }

    /// The unit, e.g. `dB` or `px`; empty for indices, shares and scene units.
    pub fn unit(self) -> &'static str {
        self.definition().unit
    }

    /// Whether higher values are better.
    pub fn higher_is_better(self) -> bool {
        self.definition().higher_is_better
    }

    /// The inputs that the metric is computed from.
    pub(crate) fn family(self) -> Family {
        self.definition().family
    }

    /// Whether the metric is over the pixels of a mask, and has a value for each.
    pub fn is_masked(self) -> bool {
        self.family() == Family::Masked
    }

    /// Whether the metric compares network outputs for the renders, which a folder provides.
    pub(crate) fn is_of_features(self) -> bool {
        matches!(self, Self::SubjectConsistency | Self::BackgroundConsistency | Self::FlowOfVideo)
    }

    /// Whether the metric needs more than pairs of images. It is absent without these inputs, and its mean is over the
    /// images that define it.
    pub fn is_conditional(self) -> bool {
        !matches!(self.family(), Family::Images | Family::Perceptual)
    }
}
