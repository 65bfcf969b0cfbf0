//! The figures of quality: name, unit, direction and decimals of each, once.

use serde::{Deserialize, Serialize};

/// A figure of quality.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// Per-image PSNR in dB; a set's value is the mean over its images.
    Psnr,
    /// PSNR in dB of the mean squared error over all images (the original NeRF convention); defined for a set only.
    PsnrPooled,
    /// SSIM of 3D Gaussian Splatting: 11-tap Gaussian window, σ = 1.5, zero padding, mean over pixels and channels.
    Ssim,
    /// The same SSIM over the windows that lie inside the image (scikit-image, D-NeRF, `tf.image.ssim`).
    SsimValid,
    /// Multi-scale SSIM over five scales (`pytorch_msssim`).
    MsSsim,
    /// LPIPS 0.1 with AlexNet, colours in [-1, 1] ([`crate::lpips`]).
    LpipsAlex,
    /// The same with VGG-16.
    LpipsVgg,
    /// The same with SqueezeNet 1.1.
    LpipsSqueeze,
    /// With AlexNet and colours in [0, 1], as the code of 3D Gaussian Splatting measures it by mistake: lower than LPIPS.
    LpipsAlexLegacy,
    /// The same with VGG-16.
    LpipsVggLegacy,
    /// PSNR over the pixels of a mask.
    MaskedPsnr,
    /// SSIM by partial convolution over a mask, mean over all windows as DyCheck has it: windows that see nothing of the
    /// mask count as equal, so that it rises as the mask shrinks.
    MaskedSsim,
    /// The same, mean over the windows that see something of the mask.
    MaskedSsimStrict,
    /// LPIPS (AlexNet) by pixel of images that are black outside of a mask, mean over the mask (DyCheck).
    MaskedLpips,
    /// Mean absolute change of the error between an image and the one before it of the same camera at rest.
    Flicker,
    /// Mean cosine of what an image shows with the one before it and with the first of its camera (VBench), where features
    /// of its subject are supplied.
    SubjectConsistency,
    /// The same of features of the background.
    BackgroundConsistency,
    /// How much the motion seen in the render's video differs from that in the truth's (tOF), where flows of both are given.
    FlowOfVideo,
    /// PSNR over the pixels whose true surface moves.
    PsnrMoving,
    /// The same, pooled over the images in which less than half as much of the moving surface is seen as in the image
    /// that sees most of it: while it goes behind something, and when it comes back. Defined for a set only.
    PsnrEmerging,
    /// Mean distance between rendered and true velocity of moving surfaces, scene units per second.
    VelocityError,
    /// Mean end-point error of the flow to the next frame on moving surfaces, pixels.
    FlowError,
    /// Mean difference in view-space z where render and truth show a surface, scene units.
    DepthError,
    /// Share of the truly covered pixels where the render covers less than half.
    HoleArea,
    /// Share of all pixels where the render shows a surface that is more than a tenth nearer than the true one, or
    /// where there is none.
    FloaterArea,
    /// Intersection over union of the pixels that a prompt selects and those labelled with its class, mean over the prompts
    /// in sight ([`super::prompt_overlaps`]).
    PromptIou,
    /// 1 − cosine between the mean feature of a class in an image and its mean over all images, mean over the classes in
    /// sight ([`super::feature_drifts`]).
    FeatureDrift,
}

/// What a figure is computed from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// Colours of render and truth.
    Images,
    /// What trained networks see in both.
    Perceptual,
    /// A part of each image.
    Masked,
    /// Images of one camera in the order of time.
    Video,
    /// Exact maps of surfaces.
    Surfaces,
    /// Labels and what the model means.
    Language,
}

/// What a metric is called and how it is printed.
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
    pub const ALL: [Self; 27] = [
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
        // Decimals of images' figures are those that the literature prints.
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

    /// Decimals in tables, and that ranks are decided on.
    pub fn decimals(self) -> usize {
        self.definition().decimals
    }

    /// `dB`, `px`, or nothing for an index, a share and scene units.
    pub fn unit(self) -> &'static str {
        self.definition().unit
    }

    /// Whether more is better.
    pub fn higher_is_better(self) -> bool {
        self.definition().higher_is_better
    }

    /// What the figure is computed from.
    pub fn family(self) -> Family {
        self.definition().family
    }

    /// Whether the figure needs more than pairs of images; it is absent where that is not given, and its mean is over the
    /// images that define it.
    pub fn is_conditional(self) -> bool {
        !matches!(self.family(), Family::Images | Family::Perceptual)
    }
}
