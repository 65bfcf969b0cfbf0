//! The patterns of a manifest's layout, and the files that match them.

use std::collections::BTreeMap;
use std::path::Path;

/// A part of the name of a file or folder.
enum Part {
    Text(String),
    /// `*`: any text.
    Any,
    /// `{camera}`, or digits: `{CC}`, `{NN}`.
    Camera(Symbols),
    /// `{frame}`, or digits: `{FFFFFF}`.
    Frame(Symbols),
}

/// What a placeholder matches.
#[derive(Clone, Copy, PartialEq)]
enum Symbols {
    All,
    Digits,
}

/// A pattern of files below the folder of a scene, e.g. `{scene}/images/{CC}/{FFFFFF}.jpg`.
pub(crate) struct Pattern(Vec<Vec<Part>>);

impl Pattern {
    /// Parses a pattern of a scene in `folder`. None for prose, and for placeholders that are not those of [`Part`].
    pub(crate) fn parse(text: &str, folder: &Path) -> Option<Self> {
        let below = text.strip_prefix("{scene}/").filter(|below| !below.contains([',', ' ']))?;
        let scene = folder.file_name().unwrap_or_default().to_string_lossy();
        below.split('/').map(|name| parts_of(&name.replace("{scene}", &scene))).collect::<Option<_>>().map(Self)
    }

    /// Whether the pattern distinguishes cameras.
    pub(crate) fn has_cameras(&self) -> bool {
        self.0.iter().flatten().any(|part| matches!(part, Part::Camera(_)))
    }

    /// The number of matching files of each camera; of an empty name if the pattern does not distinguish cameras.
    pub(crate) fn files_by_camera(&self, folder: &Path) -> BTreeMap<String, u64> {
        let mut files = BTreeMap::new();
        count(&self.0, folder, "", &mut files);
        files
    }
}

/// Adds the files below `folder` that match `names`.
fn count(names: &[Vec<Part>], folder: &Path, camera: &str, files: &mut BTreeMap<String, u64>) {
    let Some((parts, below)) = names.split_first() else { return };
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some(found) = name.to_str().and_then(|name| matched(parts, name)) else { continue };
        let camera = found.unwrap_or(camera);
        if below.is_empty() {
            *files.entry(camera.to_owned()).or_default() += 1;
        } else {
            count(below, &entry.path(), camera, files);
        }
    }
}

fn parts_of(name: &str) -> Option<Vec<Part>> {
    let mut parts = Vec::new();
    let mut rest = name;
    while let Some(at) = rest.find(['{', '*']) {
        if at > 0 {
            parts.push(Part::Text(rest[..at].to_owned()));
        }
        if rest[at..].starts_with('*') {
            parts.push(Part::Any);
            rest = &rest[at + 1..];
            continue;
        }
        let (inside, after) = rest[at + 1..].split_once('}')?;
        let is_all = |symbol: char| !inside.is_empty() && inside.chars().all(|other| other == symbol);
        parts.push(match inside {
            "camera" => Part::Camera(Symbols::All),
            "frame" => Part::Frame(Symbols::All),
            _ if is_all('C') || is_all('N') => Part::Camera(Symbols::Digits),
            _ if is_all('F') => Part::Frame(Symbols::Digits),
            _ => return None,
        });
        rest = after;
    }
    if !rest.is_empty() {
        parts.push(Part::Text(rest.to_owned()));
    }
    Some(parts)
}

/// Whether a name matches, with the name of the camera in it, if there is one. Upper and lower case are equal.
fn matched<'a>(parts: &[Part], name: &'a str) -> Option<Option<&'a str>> {
    let Some((part, after)) = parts.split_first() else { return name.is_empty().then_some(None) };
    let (symbols, least) = match part {
        Part::Text(text) => {
            let start = name.get(..text.len()).filter(|start| start.eq_ignore_ascii_case(text))?;
            return matched(after, &name[start.len()..]);
        }
        Part::Any => (Symbols::All, 0),
        Part::Camera(symbols) | Part::Frame(symbols) => (*symbols, 1),
    };
    let ends = name.char_indices().map(|(at, _)| at).chain([name.len()]).filter(|end| *end >= least);
    let fits = |text: &str| symbols == Symbols::All || text.bytes().all(|byte| byte.is_ascii_digit());
    ends.take_while(|end| fits(&name[..*end])).find_map(|end| {
        let camera = matched(after, &name[end..])?;
        Some(if matches!(part, Part::Camera(_)) { Some(&name[..end]) } else { camera })
    })
}
