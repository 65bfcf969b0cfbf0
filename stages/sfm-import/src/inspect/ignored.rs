//! Files and folders of a capture that an import does not read.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::companion_files::{DEPTHS, MASKS};
use crate::files;
use crate::params::Format;
use crate::{scannet, tum};

/// Maximum number of lines.
const LINES: usize = 8;

/// One line for each folder, and each file at the top, that an import ignores. `used` has the files that it reads; a folder
/// stands for everything in it.
pub(super) fn lines(dir: &Path, format: Format, used: &BTreeSet<PathBuf>) -> Vec<String> {
    let mut search = Search { dir, format, used, lines: Vec::new() };
    search.visit(dir);
    let Search { mut lines, .. } = search;
    let more = lines.len().saturating_sub(LINES);
    lines.truncate(LINES);
    if more > 0 {
        lines.push(format!("and {more} more"));
    }
    lines
}

struct Search<'a> {
    dir: &'a Path,
    format: Format,
    used: &'a BTreeSet<PathBuf>,
    lines: Vec<String>,
}

impl Search<'_> {
    /// Adds the lines of a folder that contains used files.
    fn visit(&mut self, folder: &Path) {
        let (mut files, mut folders) = (Vec::new(), Vec::new());
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            let is_hidden = entry.file_name().to_string_lossy().starts_with('.');
            if is_hidden
                || path.ancestors().take_while(|above| *above != self.dir).any(|above| self.used.contains(above))
            {
                continue;
            }
            let is_folder = path.is_dir();
            (if is_folder { &mut folders } else { &mut files }).push(path);
        }
        files.sort();
        folders.sort();
        files.retain(|path| !is_metadata(self.format, &files::name(path)));
        if folder == self.dir {
            let line = |path: &PathBuf| noted(&files::name(path), "", self.format);
            self.lines.extend(files.iter().map(line));
        } else if let Some(first) = files.first() {
            let what = match files.len() {
                1 => format!("{}, which no frame names", files::name(first)),
                count => format!(": {count} files that no frame names, e.g. {}", files::name(first)),
            };
            self.lines.push(self.shown(folder) + &what);
        }
        for path in folders {
            let holds_used = self.used.range(path.clone()..).next().is_some_and(|used| used.starts_with(&path));
            if holds_used {
                // Each instant also has the image of the camera that trains then, which `images` has too.
                if (self.format, &*files::name(&path)) != (Format::Nvidia, "mv_images") {
                    self.visit(&path);
                }
            } else if let Some(failure) = files::unreadable(&path) {
                self.lines.push(format!("{}: {}", self.shown(&path), failure.message));
            } else if !is_metadata(self.format, &files::name(&path)) {
                let size = match files::children(&path).len() {
                    1 => ": 1 entry".into(),
                    entries => format!(": {entries} entries"),
                };
                self.lines.push(noted(&self.shown(&path), &size, self.format));
            }
        }
    }

    /// A folder relative to the capture.
    fn shown(&self, folder: &Path) -> String {
        format!("{}/", folder.strip_prefix(self.dir).unwrap_or(folder).display())
    }
}

/// Whether the format reads a file or folder without naming it in a frame.
fn is_metadata(format: Format, name: &str) -> bool {
    const NERFIES: [&str; 7] =
        ["camera", "camera-paths", "dataset.json", "metadata.json", "scene.json", "points.npy", "splits"];
    const MONST3R: [&str; 6] = ["pred_", "conf_", "init_conf_", "enlarged_dynamic_mask_", "_depth_maps", "scene.glb"];
    const COLMAP: [&str; 5] = ["cameras", "images", "points3D", "rigs", "frames"];
    match format {
        Format::Nerfies => NERFIES.contains(&name),
        Format::N3v | Format::Llff | Format::Nvidia => name == "poses_bounds.npy",
        Format::EasyVolcap => ["intri.yml", "extri.yml", "optimized"].contains(&name),
        Format::Panoptic => name == "init_pt_cld.npz",
        Format::ScanNet => name == scannet::LENSES,
        Format::Tum => tum::METADATA.contains(&name),
        Format::Vggt => name.ends_with(".glb"),
        Format::MegaSam => name.ends_with("_droid.npz"),
        Format::Monst3r => MONST3R.iter().any(|start| name.starts_with(start)),
        Format::Colmap => {
            let stem = name.strip_suffix(".bin").or(name.strip_suffix(".txt"));
            name == "prepare.json" || stem.is_some_and(|stem| COLMAP.contains(&stem))
        }
        _ => false,
    }
}

/// An entry with the reason why it is ignored, where that is known.
fn noted(name: &str, size: &str, format: Format) -> String {
    let bare = name.trim_end_matches('/');
    let reason = match bare {
        "database.db" => "features and matches of COLMAP",
        "flow" | "flow_fwd" | "flow_bwd" | "normal" => "maps are read by the stage depth-flow-import",
        "covisible" => "masks of metric-evaluation: masks.co_visibility = { folder = \"SCENE/covisible/2x/val\" }",
        "maps" | "tracks" | "features" => "read by the import stages of estimators",
        _ if MASKS.contains(&bare) => "no PNG file in it has the name and size of an image",
        _ if DEPTHS.contains(&bare) => "maps are read by the stage depth-flow-import",
        _ if bare.starts_with("images_") || bare.starts_with("rgb/") => match format {
            Format::Colmap | Format::Nerfies | Format::Llff => "smaller copies, read if width asks for them",
            _ => "smaller copies; width resizes the images that the frames name",
        },
        _ if bare.ends_with(".mp4") || ["videos", "hdVideos"].contains(&bare) => match format {
            Format::N3v | Format::EasyVolcap | Format::Panoptic => "the extracted frames are read instead",
            Format::Immersive => "it has no calibration, or its extracted frames are read instead",
            _ => "only videos of rigs are decoded",
        },
        _ => "",
    };
    let reason = if reason.is_empty() { String::new() } else { format!(" ({reason})") };
    format!("{name}{size}{reason}")
}
