//! A first recipe for a user's own captures.

use std::collections::BTreeSet;
use std::path::Path;

use super::companions::Companions;
use super::summary::Summary;
use super::video;
use crate::files;
use crate::params::Format;

const VIDEO_NOTE: &str = "# Images are treated as frames of a video, in the order of their names. For photos of a static scene, replace fps by\n\
     # static = true.\n";
const INSTANT_NOTE: &str = "# static = true: all images are treated as views of one instant. For frames of a video, replace it by fps = 30.0.\n";
const HEXPLANE: &str = "deformable4dgs = { channels = 16, spatial_resolution = 32 }\n";
/// With the learning rates of `builtin:cpu`.
const HEXPLANE_OF_VIDEOS: &str = "\n\
     # Deformations of videos start at zero, because a random first displacement is larger than the subject.\n\
     [nodes.train.params.deformable4dgs]\nchannels = 16\nspatial_resolution = 32\nzero_heads = true\n\
     plane_rate = { start = 3e-3, end = 3e-4, steps = 20000 }\n\
     network_rate = { start = 3e-4, end = 3e-5, steps = 20000 }\n";
const LABELS: &str =
    "\n# The masked pixels are also evaluated separately.\n[nodes.metrics.params.masks]\nlabels = \"nonzero\"\n";

/// A recipe for the importable captures of `dir`, with common parameters in the node and the others per scene.
pub(super) fn of(dir: &Path, captures: &[Summary]) -> Option<String> {
    let parts = Parts::new(dir, captures)?;
    let Parts { name, data_root, scenes, companions, .. } = &parts;
    let head = format!("# Save as {name}.toml and run with --data-root {data_root}\n");
    let body = if companions.as_ref().is_some_and(Companions::can_seed) { parts.seeded() } else { parts.usual() };
    let [extends, methods, tables] = body;
    Some(format!(
        "{head}{extends}\nname = {name:?}\n\n[axes]\nscene = [{scenes}]\nmethod = [{methods}]\nseed = [0]\n\n{tables}"
    ))
}

/// The parts of a recipe's text.
struct Parts {
    name: String,
    data_root: String,
    /// The values of the axis `scene`.
    scenes: String,
    /// Parameters of the import that all captures share.
    common: Vec<(&'static str, String)>,
    /// Rules for single scenes.
    own: String,
    /// The results of estimators, if they are the same for all captures.
    companions: Option<Companions>,
    /// Whether all captures are videos of one moving camera.
    are_videos: bool,
    /// Whether all captures have masks of what moves, as labels.
    have_labels: bool,
    /// The keys of the parameters of captures that state no times (COLMAP, VGGT).
    time_keys: BTreeSet<&'static str>,
}

impl Parts {
    fn new(dir: &Path, captures: &[Summary]) -> Option<Self> {
        let ready =
            captures.iter().filter_map(|summary| Some((summary, files::name(&summary.path), summary.params.as_ref()?)));
        let ready: Vec<_> = ready.collect();
        let (first, _, params) = ready.first()?;
        let is_common = |param: &&(&'static str, String)| ready.iter().all(|(_, _, others)| others.contains(param));
        let common: Vec<_> = params.iter().filter(is_common).cloned().collect();
        let values = axis_values(&ready.iter().map(|(_, name, _)| name.as_str()).collect::<Vec<_>>());
        let scenes: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
        let named = ready.iter().zip(&values);
        let own = named.map(|((_, name, params), value)| own_rule(name, value, params, &common, &first.companions));
        let own = own.collect();
        let is_one_capture = captures.len() == 1 && captures[0].path == dir;
        let data_root = if is_one_capture { dir.parent().unwrap_or(dir) } else { dir };
        let are_equal = ready.iter().all(|(summary, ..)| summary.companions == first.companions);
        let untimed = ready
            .iter()
            .filter(|(summary, ..)| matches!(summary.format, Format::Colmap | Format::Vggt | Format::ScanNet));
        Some(Self {
            // The prefix avoids the names of the recipes in this repository.
            name: format!("own-{}", axis_value(&files::name(dir))),
            data_root: data_root.display().to_string(),
            scenes: scenes.join(", "),
            common,
            own,
            companions: are_equal.then(|| first.companions.clone()),
            are_videos: ready.iter().all(|(summary, ..)| summary.companions.is_video),
            have_labels: ready.iter().all(|(summary, ..)| has_labels(summary)),
            time_keys: untimed.flat_map(|(_, _, params)| params.iter().map(|(key, _)| *key)).collect(),
        })
    }

    /// `extends`, methods and tables of a recipe for captures that have only images and poses.
    fn usual(&self) -> [String; 3] {
        let time_notes: String = [("fps", VIDEO_NOTE), ("static", INSTANT_NOTE)]
            .into_iter()
            .filter_map(|(key, note)| self.time_keys.contains(key).then_some(note))
            .collect();
        let common: String = self.common.iter().map(|(key, value)| format!(", {key} = {value}")).collect();
        let tables = format!(
            "{time_notes}[nodes.capture]\nstage = \"sfm-import\"\nover = [\"scene\"]\n\
             params = {{ source = \"{{scene}}\"{common} }}\n{}\n\
             # Sizes for a CPU. Without them, the methods use the schedules and sizes of their papers.\n\
             [nodes.train.params]\nschedule_scale = 0.05\ninitial_points = {{ random_count = 2000 }}\n\
             density = {{ max_count = 10000, opacity_reset_interval = 0 }}\n{}{}{}{}",
            self.own,
            if self.are_videos { HEXPLANE_OF_VIDEOS } else { HEXPLANE },
            if self.have_labels { LABELS } else { "" },
            self.companions.as_ref().map(co_visibility).unwrap_or_default(),
            self.companions.as_ref().map(video::missing).unwrap_or_default(),
        );
        ["extends = [\"builtin:benchmark\"]".into(), "\"static3dgs\", \"deformable4dgs\"".into(), tables]
    }

    /// `extends`, methods and tables of a recipe for videos whose moving parts are known.
    fn seeded(&self) -> [String; 3] {
        let companions = self.companions.clone().unwrap_or_default();
        let extends = format!(
            "# Sized for a CPU: `pipeline recipes show video` prints what it extends. Found: {}. All methods here except\n\
             # static3dgs seed the subject from the masks; so do the methods that are not listed.\n\
             extends = [\"builtin:video\"]",
            companions.found(),
        );
        let common: String = self.common.iter().map(|(key, value)| format!("{key} = {value}\n")).collect();
        let tables = video::tables(&companions, &common) + &co_visibility(&companions) + &self.own;
        let methods = "\"static3dgs\", \"deformable3dgs\", \"deformable4dgs\", \"realtime4dgs\", \"vcgs\"";
        [extends, methods.into(), tables]
    }
}

/// Whether every image of a moving scene has a mask.
fn has_labels(summary: &Summary) -> bool {
    let frames = summary.frames.as_ref().filter(|frames| frames.time_range_secs.is_some());
    frames.is_some_and(|frames| frames.masks > 0 && frames.masks == frames.counts.values().sum::<usize>())
}

/// A rule for the parameters of one scene that others do not share. `value` on the axis may differ from the folder's `name`.
fn own_rule(
    name: &str,
    value: &str,
    params: &[(&'static str, String)],
    common: &[(&'static str, String)],
    companions: &Companions,
) -> String {
    let source = (value != name).then(|| ("source", format!("{:?}", without_axes(name))));
    let others = params.iter().filter(|param| !common.contains(param)).cloned().chain(source);
    let mut lines: String = others.map(|(key, value)| format!("nodes.capture.params.{key} = {value}\n")).collect();
    if value != name {
        let masks = co_visible_folder(companions, &without_axes(name));
        let line = |folder: String| format!("nodes.metrics.params.masks.co_visibility.folder = {folder}\n");
        lines += &masks.map(line).unwrap_or_default();
    }
    if value != name && companions.can_seed() {
        lines += &video::folders(companions, &without_axes(name));
    }
    if lines.is_empty() {
        return lines;
    }
    format!("\n[[set]]\nwhen = {{ scene = {value:?} }}\n{lines}")
}

/// The masks of DyCheck, on which its main metrics are measured.
fn co_visibility(companions: &Companions) -> String {
    let table = |folder: String| {
        format!(
            "\n# Pixels that the training views see, too.\n[nodes.metrics.params.masks.co_visibility]\nfolder = {folder}\n"
        )
    };
    co_visible_folder(companions, "{scene}").map(table).unwrap_or_default()
}

/// The folder of these masks below the data root, in TOML.
fn co_visible_folder(companions: &Companions, scene: &str) -> Option<String> {
    companions.co_visible.as_ref().map(|masks| format!("{:?}", format!("{scene}/{}", masks.folder)))
}

/// The name of a capture's folder on the axis `scene` of its recipe, which is called `own-NAME.toml`.
pub fn scene_name(dir: &Path) -> String {
    axis_value(&files::name(dir))
}

/// A different value for each name, which is numbered if that of another name would be equal.
fn axis_values(names: &[&str]) -> Vec<String> {
    let mut taken: BTreeSet<String> =
        names.iter().filter(|name| axis_value(name) == **name).map(|name| (*name).into()).collect();
    let value = |name: &&str| {
        let value = axis_value(name);
        if value == **name {
            return value;
        }
        let mut numbered = (2_u32..).map(|number| format!("{value}-{number}"));
        let free = if taken.contains(&value) { numbered.find(|other| !taken.contains(other)) } else { None };
        let free = free.unwrap_or(value);
        taken.insert(free.clone());
        free
    };
    names.iter().map(value).collect()
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
