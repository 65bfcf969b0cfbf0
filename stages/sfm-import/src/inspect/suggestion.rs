//! Suggested import parameters.

use scene::protocol::PRESETS;

use super::samples::Samples;
use crate::params::Format;
use crate::source::SourceCapture;

/// Minimum image width in pixels for which half of it is suggested.
const LARGE_WIDTH: u32 = 800;

/// Suggests import parameters besides `source`, for images of this width and content. Values are in TOML.
pub(super) fn params(source: &SourceCapture, samples: Option<&Samples>, width: u32) -> Vec<(&'static str, String)> {
    let text = |text: &str| format!("{text:?}");
    let mut params = Vec::new();
    if source.format == Format::N3v {
        params.extend(of_protocol(source, width));
    } else if width >= LARGE_WIDTH {
        params.extend([("width", (width / 2).to_string()), ("resize", text("area"))]);
    }
    match source.format {
        Format::Blender | Format::Nerfstudio if !source.split_rule.starts_with("official") => {
            params.push(("every_nth", "8".into()))
        }
        Format::Colmap | Format::Vggt | Format::MegaSam | Format::Monst3r => {
            params.extend([("every_nth", "8".into()), ("fps", "30.0".into())]);
        }
        Format::Nerfies | Format::EasyVolcap | Format::Panoptic | Format::Technicolor => {
            params.push(("fps", "30.0".into()))
        }
        _ if source.name == "lego" && source.dataset == "dnerf" => params.push(("test_split", text("val"))),
        _ => (),
    }
    if samples.is_some_and(Samples::suggest_black) {
        params.push(("background", text("black")));
    }
    params
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
