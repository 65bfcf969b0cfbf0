//! A first recipe for captures of one's own.

use std::path::Path;

use scene::protocol::PRESETS;

use super::Summary;
use crate::params::Format;
use crate::source::SourceCapture;

/// Pixels per row from which half of them are suggested.
const LARGE_WIDTH: u32 = 800;

/// What an import of the capture, whose images have `width` pixels per row, should say beyond its source.
pub fn params(source: &SourceCapture, width: u32) -> Vec<(&'static str, String)> {
    let text = |text: &str| format!("{text:?}");
    let mut params = Vec::new();
    if source.format == Format::N3v {
        params.extend(of_protocol(source, width));
    } else if width >= LARGE_WIDTH {
        params.extend([("width", (width / 2).to_string()), ("resize", text("area"))]);
    }
    match source.format {
        Format::Colmap => params.extend([("every_nth", "8".into()), ("fps", "30.0".into())]),
        Format::Nerfies => params.push(("fps", "30.0".into())),
        _ if source.name == "lego" && source.dataset == "dnerf" => params.push(("test_split", text("val"))),
        _ => (),
    }
    params
}

/// The size and the protocol that the literature has for the data set, where images of `width` can come to have them.
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

/// A recipe for the captures of `dir` that are ready: what their parameters have in common once, the rest by scene.
pub fn of(dir: &Path, captures: &[Summary]) -> Option<String> {
    let ready = captures.iter().filter_map(|summary| Some((summary, folder(&summary.path), summary.params.as_ref()?)));
    let ready: Vec<_> = ready.collect();
    let is_common = |param: &&(&'static str, String)| ready.iter().all(|(_, _, others)| others.contains(param));
    let common: Vec<String> =
        ready.first()?.2.iter().filter(is_common).map(|(key, value)| format!(", {key} = {value}")).collect();
    let scenes: Vec<String> = ready.iter().map(|(_, name, _)| format!("{:?}", axis_value(name))).collect();
    let mut own = String::new();
    for (_, name, params) in &ready {
        // A folder's name may have letters that no axis value may have.
        let source = (axis_value(name) != *name).then(|| ("source", format!("{:?}", without_axes(name))));
        let others = params.iter().filter(|param| !is_common(param)).cloned().chain(source);
        let lines: String = others.map(|(key, value)| format!("nodes.capture.params.{key} = {value}\n")).collect();
        if !lines.is_empty() {
            own += &format!("\n[[set]]\nwhen = {{ scene = {:?} }}\n{lines}", axis_value(name));
        }
    }
    let is_one_capture = captures.len() == 1 && captures[0].path == dir;
    let data_root = if is_one_capture { dir.parent().unwrap_or(dir) } else { dir };
    // No recipe that comes with the program is called so.
    let (name, data_root) = (format!("own-{}", axis_value(&folder(dir))), data_root.display());
    let note = if ready.iter().any(|(summary, ..)| summary.format == Format::Colmap) {
        "# Images are taken for the frames of a video in the order of their names; for photos of a scene at rest, replace fps by\n\
         # static = true.\n"
    } else {
        ""
    };
    Some(format!(
        "# Save as recipes/{name}.toml and run with --data-root {data_root}\n\
         extends = [\"common/benchmark.toml\"]\nname = {name:?}\n\n\
         [axes]\nscene = [{}]\nmethod = [\"static3dgs\", \"deformable4dgs\"]\nseed = [0]\n\n\
         {note}[nodes.capture]\nstage = \"sfm-import\"\nover = [\"scene\"]\n\
         params = {{ source = \"{{scene}}\"{} }}\n{own}\n\
         # Sizes for a CPU; without them, methods train as long and as large as their papers.\n\
         [nodes.train.params]\nschedule_scale = 0.05\ninitial_points = {{ random_count = 2000 }}\n\
         density = {{ max_count = 10000, opacity_reset_interval = 0 }}\n\
         deformable4dgs = {{ channels = 16, spatial_resolution = 32 }}\n\n\
         [nodes.report.params]\ntitle = {name:?}\nrecipe = \"recipes/{name}.toml\"\n",
        scenes.join(", "),
        common.concat(),
    ))
}

fn folder(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The name with letters that names of jobs may have.
fn axis_value(name: &str) -> String {
    let is_safe = |letter: char| letter.is_ascii_alphanumeric() || "_-+.".contains(letter);
    let safe: String = name.chars().map(|letter| if is_safe(letter) { letter } else { '_' }).collect();
    let safe = safe.trim_start_matches(['-', '.']);
    if safe.is_empty() { "own".into() } else { safe.into() }
}

/// A text whose braces name no axis.
fn without_axes(text: &str) -> String {
    text.replace('{', "{{").replace('}', "}}")
}
