//! The recipe of a video whose moving parts are known: methods seed the subject from its masked pixels.

use std::collections::BTreeMap;

use super::companions::{Companions, DepthPlace, MaskPlace};

/// Longest side of the imported images for a CPU.
const SIDE: u32 = 256;

/// Validation views that the recipe `builtin:video` holds out.
pub(super) const VALIDATION: usize = 4;

/// Width of the imported images, at most their own: minutes per training on a CPU.
pub(super) fn width((width, height): (u32, u32)) -> u32 {
    let longest = width.max(height).max(SIDE);
    ((f64::from(width) * f64::from(SIDE) / f64::from(longest)).round() as u32).max(1)
}

/// The tables of the recipe after `[axes]`; `capture` has the parameters of the import as TOML.
pub(super) fn tables(companions: &Companions, capture: &str) -> String {
    let mut text = format!("[nodes.capture.params]\nsource = \"{{scene}}\"\n{capture}");
    text += &priors(companions);
    text += &layers(companions);
    if companions.masks != MaskPlace::Labels {
        text += "\n# Only masks that the import reads as labels can judge the subject alone.\n[nodes.metrics.params.masks]\n\
                 labels = \"none\"\n";
    }
    text += &missing(companions);
    text
}

/// The source of depth and flow.
fn priors(companions: &Companions) -> String {
    if !companions.has_maps() {
        let own = "\n[nodes.priors.params]\nsource = \"capture\"\n";
        return if companions.depth == DepthPlace::Capture { own.into() } else { String::new() };
    }
    let is_stated = companions.import.get("depth").is_some_and(|values| !values.is_empty());
    let depth = match companions.depth {
        DepthPlace::Absent => "# Depth is interpolated between the points of the capture.\nfill_depth = true\n",
        DepthPlace::Capture => "# Depth is that of the capture.\nfill_depth = true\n",
        DepthPlace::Files if is_stated => "",
        DepthPlace::Files => {
            "# What the files contain is not known: relative inverse depth is the most common. Otherwise z, ray-distance or affine-depth.\n\
             depth = { kind = \"inverse-depth\" }\n"
        }
    };
    let tables = ["depth", "flow", "normals"].map(|name| table(companions, name)).concat();
    format!("\n[nodes.priors.params]\nsource = \"files\"\nfolder = {:?}\n{depth}{tables}", folder(&companions.maps))
}

/// A folder below the data root, with the scene as an axis.
fn folder(name: &str) -> String {
    if name.is_empty() { "{scene}".into() } else { format!("{{scene}}/{name}") }
}

/// The folders of maps and masks of a capture whose folder is not named like its scene, as lines of a rule.
pub(super) fn folders(companions: &Companions, capture: &str) -> String {
    let line = |node: &str, folder: String| {
        format!("nodes.{node}.params.folder = {:?}\n", folder.replacen("{scene}", capture, 1))
    };
    let maps = companions.has_maps().then(|| line("priors", folder(&companions.maps)));
    let masks = (companions.masks == MaskPlace::Files).then(|| line("layers", folder("masks")));
    [maps, masks].into_iter().flatten().collect()
}

/// How the moving parts are found.
fn layers(companions: &Companions) -> String {
    let own: String = companions.import.get("masks").map(lines).unwrap_or_default();
    match companions.masks {
        MaskPlace::Labels if own.is_empty() => String::new(),
        MaskPlace::Labels => format!("\n[nodes.layers.params]\n{own}"),
        MaskPlace::Files => {
            format!("\n[nodes.layers.params]\nsource = \"files\"\nfolder = {:?}\n{own}", folder("masks"))
        }
        MaskPlace::Absent => {
            "\n# Without masks, a pixel moves if the motion of the camera does not explain its flow.\n\
             [nodes.layers.inputs]\npriors = \"priors\"\n"
                .into()
        }
    }
}

/// The missing inputs, as a comment.
pub(super) fn missing(companions: &Companions) -> String {
    let lines = companions.missing().into_iter().map(|text| format!("# * {text}\n"));
    let lines: String = lines.collect();
    if lines.is_empty() { lines } else { format!("\n# Missing inputs, the most useful first:\n{lines}") }
}

/// A line `name = { … }` with parameters recorded by `prepare`.
fn table(companions: &Companions, name: &str) -> String {
    let Some(values) = companions.import.get(name).filter(|values| !values.is_empty()) else { return String::new() };
    let values: Vec<String> = values.iter().map(|(key, value)| format!("{key} = {}", toml(value))).collect();
    format!("{name} = {{ {} }}\n", values.join(", "))
}

fn lines(values: &BTreeMap<String, serde_json::Value>) -> String {
    values.iter().map(|(key, value)| format!("{key} = {}\n", toml(value))).collect()
}

/// A value of JSON as TOML: texts and numbers are written alike.
fn toml(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Object(table) => {
            let values: Vec<String> = table.iter().map(|(key, value)| format!("{key} = {}", toml(value))).collect();
            format!("{{ {} }}", values.join(", "))
        }
        other => other.to_string(),
    }
}
