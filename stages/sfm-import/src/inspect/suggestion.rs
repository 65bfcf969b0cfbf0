//! Suggested import parameters.

use scene::protocol::PRESETS;
use scene::{Intrinsics, Split};

use super::companions::Companions;
use super::samples::Samples;
use super::video;
use crate::params::Format;
use crate::rig::videos::other_rate;
use crate::source::SourceCapture;

/// Longest side in pixels from which smaller images are suggested. The time of a step grows with the pixels, and the recipe's
/// schedule takes minutes on a CPU below this size.
const LARGE_SIDE: u32 = 800;
/// The frame rate that is assumed for a video without a known rate.
const USUAL_FPS: f64 = 30.0;

/// Suggests import parameters besides `source`, for images of this size and content. Values are in TOML.
pub(super) fn params(
    source: &SourceCapture,
    samples: Option<&Samples>,
    &Intrinsics { width, height, .. }: &Intrinsics,
    companions: &Companions,
) -> Vec<(&'static str, String)> {
    let text = |text: &str| format!("{text:?}");
    let of_videos = rate_of_videos(source);
    let fps = format!("{:?}", companions.fps.or(of_videos).unwrap_or(USUAL_FPS));
    let mut params = Vec::new();
    if source.format == Format::N3v {
        params.extend(of_protocol(source, width));
        params.extend(of_videos.map(|_| ("fps", fps.clone())));
    } else if let Some(masks) = &companions.co_visible {
        params.push(("width", masks.width.to_string()));
    } else if companions.is_video {
        let fitting = video::width((width, height));
        // The recipe with seeds extends one that sets its own width.
        let is_needed = fitting < width || companions.can_seed();
        params.extend(is_needed.then(|| ("width", fitting.to_string())));
    } else if width.max(height) >= LARGE_SIDE {
        params.extend([("width", reduced_width((width, height)).to_string()), ("resize", text("area"))]);
    }
    match source.format {
        Format::Blender | Format::Nerfstudio if !source.split_rule.starts_with("official") => {
            params.push(("every_nth", "8".into()))
        }
        Format::Colmap | Format::Vggt | Format::ScanNet if source.is_one_instant() => {
            params.extend([("every_nth", "8".into()), ("static", "true".into())]);
        }
        Format::Colmap | Format::Vggt | Format::MegaSam | Format::Monst3r => {
            params.extend([("every_nth", "8".into()), ("fps", fps)]);
        }
        Format::Llff if !source.is_one_instant() => params.push(("fps", fps)),
        Format::Tum => params.push(("every_nth", "8".into())),
        Format::Nerfies | Format::EasyVolcap | Format::Panoptic | Format::Technicolor | Format::Immersive => {
            params.push(("fps", fps))
        }
        _ if source.name == "lego" && source.dataset == "dnerf" => params.push(("test_split", text("val"))),
        _ => (),
    }
    if companions.can_seed() && source.count(Split::Train) <= video::VALIDATION {
        params.push(("val_count", "0".into()));
    }
    if samples.is_some_and(Samples::suggest_black) {
        params.push(("background", text("black")));
    }
    params
}

/// The frame rate of a rig's videos, if it is not the usual one.
pub(super) fn rate_of_videos(source: &SourceCapture) -> Option<f64> {
    let video = source.frames.iter().find(|frame| frame.in_video().is_some())?;
    other_rate(&video.image, USUAL_FPS)
}

/// The width halved until the longest side is below [`LARGE_SIDE`]: whole pixels are averaged, and a stored copy such as
/// `images_4` has this size. D-NeRF's 800 pixels become the 400 of the literature.
fn reduced_width((width, height): (u32, u32)) -> u32 {
    let halvings = (width.max(height) / LARGE_SIDE).checked_ilog2().map_or(0, |halvings| halvings + 1);
    (width >> halvings).max(1)
}

/// The size and the protocol of the data set in the literature, if images of this width can be resized to it.
fn of_protocol(source: &SourceCapture, width: u32) -> Vec<(&'static str, String)> {
    let Some(preset) = PRESETS.iter().find(|preset| preset.protocol().dataset == source.dataset) else {
        return Vec::new();
    };
    let protocol = preset.protocol();
    if width <= protocol.width {
        return Vec::new();
    }
    let mut params = vec![("width", protocol.width.to_string()), ("resize", format!("{:?}", protocol.resize))];
    if source.split_rule == protocol.split {
        params.push(("protocol", format!("{:?}", preset.name)));
    }
    params
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_images_are_halved_until_a_cpu_can_train_on_them() {
        for (size, width) in
            [((800, 800), 400), ((1600, 900), 400), ((1920, 1080), 480), ((8064, 6048), 504), ((6048, 8064), 378)]
        {
            assert_eq!(reduced_width(size), width, "{size:?}");
        }
    }
}
