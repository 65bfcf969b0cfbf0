//! A first recipe for one's own captures.

use std::path::Path;

use super::summary::Summary;
use super::video;
use crate::files;
use crate::params::Format;

/// A recipe for the importable captures of `dir`, with common parameters in the node and the others per scene.
pub(super) fn of(dir: &Path, captures: &[Summary]) -> Option<String> {
    let ready =
        captures.iter().filter_map(|summary| Some((summary, files::name(&summary.path), summary.params.as_ref()?)));
    let ready: Vec<_> = ready.collect();
    let is_common = |param: &&(&'static str, String)| ready.iter().all(|(_, _, others)| others.contains(param));
    let common: Vec<String> =
        ready.first()?.2.iter().filter(is_common).map(|(key, value)| format!(", {key} = {value}")).collect();
    let scenes: Vec<String> = ready.iter().map(|(_, name, _)| format!("{:?}", axis_value(name))).collect();
    let mut own = String::new();
    for (_, name, params) in &ready {
        // A folder name may contain symbols that axis values must not contain.
        let source = (axis_value(name) != *name).then(|| ("source", format!("{:?}", without_axes(name))));
        let others = params.iter().filter(|param| !is_common(param)).cloned().chain(source);
        let lines: String = others.map(|(key, value)| format!("nodes.capture.params.{key} = {value}\n")).collect();
        if !lines.is_empty() {
            own += &format!("\n[[set]]\nwhen = {{ scene = {:?} }}\n{lines}", axis_value(name));
        }
    }
    let is_one_capture = captures.len() == 1 && captures[0].path == dir;
    let data_root = if is_one_capture { dir.parent().unwrap_or(dir) } else { dir };
    // The prefix avoids the names of the recipes in this repository.
    let (name, data_root) = (format!("own-{}", axis_value(&files::name(dir))), data_root.display());
    let note = if ready.iter().any(|(summary, ..)| summary.format == Format::Colmap) {
        "# Images are treated as frames of a video, in the order of their names. For photos of a static scene, replace fps by\n\
         # static = true.\n"
    } else {
        ""
    };
    let first = &ready[0].0.companions;
    if first.show_what_moves() && ready.iter().all(|(summary, ..)| summary.companions == *first) {
        let common: String =
            ready[0].2.iter().filter(is_common).map(|(key, value)| format!("{key} = {value}\n")).collect();
        return Some(format!(
            "# Save as {name}.toml and run with --data-root {data_root}\n\
             # Sized for a CPU: `pipeline recipes show video` prints what it extends. Found: {}.\n\
             extends = [\"builtin:video\"]\nname = {name:?}\n\n\
             # All of these but static3dgs seed the subject from its pixels; so do deformable3dgs, scgs and mcgs.\n\
             [axes]\nscene = [{}]\nmethod = [\"static3dgs\", \"deformable4dgs\", \"realtime4dgs\", \"vcgs\"]\nseed = [0]\n\n\
             {}{own}\n[nodes.report.params]\ntitle = {name:?}\nrecipe = \"{name}.toml\"\n",
            first.found(),
            scenes.join(", "),
            video::tables(first, &common),
        ));
    }
    Some(format!(
        "# Save as {name}.toml and run with --data-root {data_root}\n\
         extends = [\"builtin:benchmark\"]\nname = {name:?}\n\n\
         [axes]\nscene = [{}]\nmethod = [\"static3dgs\", \"deformable4dgs\"]\nseed = [0]\n\n\
         {note}[nodes.capture]\nstage = \"sfm-import\"\nover = [\"scene\"]\n\
         params = {{ source = \"{{scene}}\"{} }}\n{own}\n\
         # Sizes for a CPU. Without them, the methods use the schedules and sizes of their papers.\n\
         [nodes.train.params]\nschedule_scale = 0.05\ninitial_points = {{ random_count = 2000 }}\n\
         density = {{ max_count = 10000, opacity_reset_interval = 0 }}\n\
         deformable4dgs = {{ channels = 16, spatial_resolution = 32 }}\n{}\n\
         [nodes.report.params]\ntitle = {name:?}\nrecipe = \"{name}.toml\"\n",
        scenes.join(", "),
        common.concat(),
        video::missing(first),
    ))
}

/// The name of a capture's folder on the axis `scene` of its recipe, which is called `own-NAME.toml`.
pub fn scene_name(dir: &Path) -> String {
    axis_value(&files::name(dir))
}

/// The name with every symbol replaced that job names must not contain.
fn axis_value(name: &str) -> String {
    let is_safe = |symbol: char| symbol.is_ascii_alphanumeric() || "_-+.".contains(symbol);
    let safe: String = name.chars().map(|symbol| if is_safe(symbol) { symbol } else { '_' }).collect();
    let safe = safe.trim_start_matches(['-', '.']);
    if safe.is_empty() { "own".into() } else { safe.into() }
}

/// Escapes braces, which would otherwise refer to an axis.
fn without_axes(text: &str) -> String {
    text.replace('{', "{{").replace('}', "}}")
}
