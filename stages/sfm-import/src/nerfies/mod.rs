//! The layout of Nerfies (Park et al. 2021a), HyperNeRF (Park et al. 2021b) and DyCheck (Gao et al. 2022): one camera file
//! per view, `dataset.json`, `metadata.json`, `scene.json`, images in `rgb/{1,2,4,…}x`, `points.npy`.
//!
//! Orientations are world-to-camera with OpenCV's axes, as rows; positions are camera centres. Coordinates are normalised
//! as in the authors' loaders: (point - center) · scale of `scene.json`.

pub(crate) mod files;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use glam::DVec3;
use scene::{Split, npy_file};

use self::files::{Dataset, SceneFrame, SplitNames, ViewMetadata, camera, camera_path, metadata, parse};
use crate::bounds::StatedBounds;
use crate::error::{Result, bad};
use crate::files::{self as paths, children, image_size};
use crate::image_names::image_named;
use crate::mask_polarity::SetPixels;
use crate::params::{Format, Params};
use crate::source::{Frame, SourceCapture, time_map};
use crate::split;

/// Grey level of points, which have no colours in this format.
const UNKNOWN_COLOR: u8 = 128;
/// Interpolation captures train on every N-th view and test on the views half-way between (HyperNeRF, section 4).
const INTERPOLATION_STEP: usize = 4;

/// Folders of masks, which have a folder per size. NeRF-DS (Yan et al. 2023) stores the second one for its own training.
const MASK_FOLDERS: [&str; 2] = ["mask", "resized_mask"];
/// The ending of masks that are white on the subject.
const MASK: &str = ".png";
/// The ending of COLMAP's masks, which NeRF-DS has: an image's whole name and `.png`. They are white where nothing moves.
const STATIC_MASK: &str = ".png.png";

/// The warning about a known error of a notebook.
const NOTEBOOK: &str = "each held-out view has the warp_id of the next training view in metadata.json, as the notebook of Nerfies \
    writes it: times are the ranks in ids of dataset.json; state time_id if they are others";

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join("camera").is_dir() && dir.join("metadata.json").is_file()
}

/// Reads the views of the split; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let (views, split_rule) = split_views(dir)?;
    check_distinct(&views).map_err(|failure| failure.at(dir))?;
    let scene_frame = scene_frame(dir, &mut warnings)?;
    let images = Images::choose(dir, &views, params)?;
    let mut metadata = metadata(dir)?;
    if let Some(ids) = ids_of_notebook(dir, &views, &metadata) {
        warnings.push(NOTEBOOK.into());
        ids.iter().zip(0..).for_each(|(id, instant)| _ = metadata.get_mut(id).map(|view| view.set_instant(instant)));
    }
    let source = FrameSource { dir, scene_frame, images: &images, metadata: &metadata, params };
    let mut frames = views.iter().map(|(id, split)| source.frame(id, *split)).collect::<Result<Vec<_>>>()?;
    if params.is_static() {
        frames.iter_mut().zip(0..).for_each(|(frame, index)| frame.camera_index = index);
    }
    frames.sort_by_key(|frame| (frame.frame_index, frame.camera_index));
    let time_map = time_map(&frames, params.is_static(), params.fps);
    let mut rules = vec![split_rule.to_owned()];
    if images.factor > 1 {
        rules.push(format!("images at 1/{}", images.factor));
    }
    rules.extend(split::refine(&mut frames, params));
    let points = points(dir, &scene_frame, &mut warnings)?;
    Ok(SourceCapture {
        name: paths::name(dir),
        format: Format::Nerfies,
        dataset: if dir.join("splits").is_dir() { "dycheck" } else { "nerfies" },
        wants_test: true,
        split_rule: rules.join(", "),
        time_rule: if params.is_static() { "one instant".into() } else { "time id / last time id".into() },
        time_map,
        frames,
        points,
        set_pixels: images.masks.as_ref().map(Masks::set_pixels).unwrap_or_default(),
        cloud: None,
        stated_bounds: StatedBounds::default(),
        quality: None,
        warnings,
    })
}

/// All training and test views in the order of their lists, and the name of the split rule.
///
/// DyCheck's `splits/` take precedence over the ids of `dataset.json`. Without `val_ids`, the ids that are not in `train_ids` are
/// held out. If `train_ids` has none or all of the ids, HyperNeRF's interpolation rule applies: training on every fourth view and
/// testing on the views half-way between.
pub(crate) fn split_views(dir: &Path) -> Result<(Vec<(String, Split)>, &'static str)> {
    let of = |ids: Vec<String>, split| ids.into_iter().map(move |id| (id, split));
    let [train, val] = ["train", "val"].map(|label| dir.join("splits").join(format!("{label}.json")));
    if train.is_file() && val.is_file() {
        let (train, val): (SplitNames, SplitNames) = (parse(&train)?, parse(&val)?);
        return Ok((of(train.frame_names, Split::Train).chain(of(val.frame_names, Split::Test)).collect(), "DyCheck"));
    }
    let dataset: Dataset = parse(&dir.join("dataset.json"))?;
    if !dataset.val_ids.is_empty() {
        let views = of(dataset.train_ids, Split::Train).chain(of(dataset.val_ids, Split::Test));
        return Ok((views.collect(), "official"));
    }
    let own: BTreeSet<&String> = dataset.train_ids.iter().collect();
    let others: Vec<String> = dataset.ids.iter().filter(|id| !own.contains(id)).cloned().collect();
    if !own.is_empty() && !others.is_empty() {
        let views = of(dataset.train_ids, Split::Train).chain(of(others, Split::Test));
        return Ok((views.collect(), "train_ids, tested on the other ids"));
    }
    let train: Vec<_> = dataset.ids.iter().step_by(INTERPOLATION_STEP).cloned().collect();
    // A view after the last training view is not between two training views.
    let between = dataset.ids.iter().skip(INTERPOLATION_STEP / 2).step_by(INTERPOLATION_STEP);
    let test: Vec<_> = between.take(train.len().saturating_sub(1)).cloned().collect();
    Ok((of(train, Split::Train).chain(of(test, Split::Test)).collect(), "interpolation: 1 of 4, tested half-way"))
}

/// All ids of a capture of one camera if its instants are indices of training views, as the notebook of Nerfies writes them: there, a
/// held-out view has the index of the next training view.
fn ids_of_notebook(
    dir: &Path,
    views: &[(String, Split)],
    metadata: &BTreeMap<String, ViewMetadata>,
) -> Option<Vec<String>> {
    let dataset: Dataset = parse(&dir.join("dataset.json")).ok()?;
    let of = |wanted| views.iter().filter(move |(_, split)| *split == wanted).map(|(id, _)| id);
    let (train, held_out): (Vec<&String>, Vec<&String>) = (of(Split::Train).collect(), of(Split::Test).collect());
    let has_rank = |id: &&String| {
        let rank = train.partition_point(|other| other < id);
        metadata.get(*id).is_some_and(|view| view.instant() == Some(rank as u32))
    };
    let camera = |(id, _): &(String, Split)| metadata.get(id).map(|view| view.camera_id);
    let is_one_camera = views.iter().all(|view| camera(view) == camera(&views[0]));
    // A view after all training views has the next index.
    let is_shared = held_out.iter().any(|id| train.last().is_some_and(|last| id < last));
    let is_notebook = is_one_camera && is_shared && train.is_sorted() && train.iter().chain(&held_out).all(has_rank);
    is_notebook.then_some(dataset.ids)
}

/// Refuses ids that a list repeats, or that are both trained and tested on.
fn check_distinct(views: &[(String, Split)]) -> Result<()> {
    let mut seen = BTreeMap::new();
    for (id, split) in views {
        let what = match seen.insert(id, split) {
            None => continue,
            Some(before) if before == split => "is listed twice as a view of one split",
            Some(_) => "is both a training and a test view",
        };
        return Err(bad(format!("view {id} {what}")).hint("list each id once in dataset.json, or in splits/"));
    }
    Ok(())
}

/// The coordinate frame of `scene.json`, or that of the camera files if the file is missing.
pub(crate) fn scene_frame(dir: &Path, warnings: &mut Vec<String>) -> Result<SceneFrame> {
    let path = dir.join("scene.json");
    if !path.is_file() {
        warnings.push("scene.json is missing: coordinates of the camera files are used as they are".into());
        return Ok(SceneFrame { scale: 1.0, center: [0.0; 3] });
    }
    parse::<SceneFrame>(&path)?.check().map_err(|failure| failure.at(path))
}

/// The chosen folder of images.
struct Images {
    dir: PathBuf,
    /// Masks of the same size, if there are any.
    masks: Option<Masks>,
    /// Full size divided by the size of these images.
    factor: u32,
}

impl Images {
    /// Chooses the smallest stored images that are at least as wide as requested, or the largest ones. Published
    /// numbers are measured on the stored pyramid, which the filters of this stage do not reproduce.
    fn choose(dir: &Path, views: &[(String, Split)], params: &Params) -> Result<Self> {
        let mut factors: Vec<u32> = children(&dir.join("rgb")).iter().filter_map(|name| factor(name)).collect();
        factors.sort_unstable();
        let folder = |factor: u32| dir.join("rgb").join(format!("{factor}x"));
        let Some(largest) = factors.first().copied() else {
            let hint = "images belong in rgb/1x, rgb/2x, …: check that the download is complete";
            return Err(Failure::new(FailureKind::MissingData, "there is no folder of images")
                .hint(hint)
                .at(dir.join("rgb")));
        };
        let wide_enough = |factor: &u32| {
            let (Some(width), Some((id, _))) = (params.width, views.first()) else { return false };
            image_size(&stored(&folder(*factor), id)).is_ok_and(|(found, _)| found >= width)
        };
        let factor = factors.iter().rev().copied().find(wide_enough).unwrap_or(largest);
        Ok(Self { dir: folder(factor), masks: Masks::choose(dir, views, factor), factor })
    }
}

/// A folder of masks.
struct Masks {
    folder: PathBuf,
    /// The suffix after a view's id in the name of its mask.
    ending: &'static str,
}

impl Masks {
    /// The first folder with a mask of any view.
    fn choose(dir: &Path, views: &[(String, Split)], factor: u32) -> Option<Self> {
        let folders = MASK_FOLDERS.map(|name| dir.join(name).join(format!("{factor}x")));
        let mut places = folders.iter().flat_map(|folder| [MASK, STATIC_MASK].map(|ending| (folder, ending)));
        let has_mask = |(folder, ending): &(&PathBuf, &'static str)| {
            folder.is_dir() && views.iter().any(|(id, _)| folder.join(format!("{id}{ending}")).is_file())
        };
        places.find(has_mask).map(|(folder, ending)| Self { folder: folder.clone(), ending })
    }

    fn set_pixels(&self) -> SetPixels {
        if self.ending == STATIC_MASK { SetPixels::Static } else { SetPixels::Unstated }
    }

    fn of(&self, id: &str) -> Option<PathBuf> {
        Some(self.folder.join(format!("{id}{}", self.ending))).filter(|path| path.is_file())
    }
}

/// The image of a view: PNG as published, or another kind if the images were converted.
fn stored(folder: &Path, id: &str) -> PathBuf {
    image_named(folder, id).unwrap_or_else(|| folder.join(format!("{id}.png")))
}

/// The factor in a folder name, e.g. 2 for `2x`.
fn factor(name: &str) -> Option<u32> {
    name.strip_suffix('x')?.parse().ok().filter(|factor| *factor > 0)
}

/// The inputs that all frames of a capture share.
struct FrameSource<'a> {
    dir: &'a Path,
    scene_frame: SceneFrame,
    images: &'a Images,
    metadata: &'a BTreeMap<String, ViewMetadata>,
    params: &'a Params,
}

impl FrameSource<'_> {
    fn frame(&self, id: &str, split: Split) -> Result<Frame> {
        let safe = |symbol: char| symbol.is_ascii_alphanumeric() || "-_.".contains(symbol);
        if id.is_empty() || id.starts_with('.') || !id.chars().all(safe) {
            return Err(bad(format!("the view id {id:?} is not a safe file name")).at(self.dir));
        }
        let metadata_path = self.dir.join("metadata.json");
        let metadata = self.metadata.get(id).ok_or_else(|| incomplete(id, "entry").at(&metadata_path))?;
        let no_instant = || bad(format!("view {id} has neither time_id nor warp_id")).at(&metadata_path);
        let instant = metadata.instant().ok_or_else(no_instant)?;
        let stated_in = camera_path(self.dir, id);
        if !stated_in.is_file() {
            return Err(incomplete(id, "camera file").at(stated_in));
        }
        let (lens, camera_from_world) = camera(&stated_in, &self.scene_frame, self.images.factor)?;
        let mask = self.images.masks.as_ref().and_then(|masks| masks.of(id));
        let time_id = if self.params.is_static() { 0 } else { instant };
        Ok(Frame {
            name: id.to_owned(),
            split,
            image: stored(&self.images.dir, id),
            stored_image: None,
            mask,
            depth: None,
            lens,
            camera_from_world,
            camera_index: metadata.camera_id,
            frame_index: time_id,
            time_secs: f64::from(time_id) / self.params.fps,
            stated_in,
        })
    }
}

/// The error for a view without the file or entry that it needs.
fn incomplete(id: &str, what: &str) -> Failure {
    let hint = "complete the download, or remove the id from dataset.json (DyCheck: splits/*.json)";
    Failure::new(FailureKind::MissingData, format!("view {id} has no {what}")).hint(hint)
}

/// Reads `points.npy`, [N, 3], into the normalised frame; the format has no colours.
fn points(dir: &Path, frame: &SceneFrame, warnings: &mut Vec<String>) -> Result<Vec<([f64; 3], [u8; 3])>> {
    let path = dir.join("points.npy");
    if !path.is_file() {
        warnings.push("points.npy is missing: initial points will be random".into());
        return Ok(Vec::new());
    }
    let array = npy_file::read(&path).map_err(|error| bad(error.message).at(&path))?;
    let [_, 3] = *array.shape.as_slice() else {
        return Err(bad(format!("the array has shape {:?} instead of [points, 3]", array.shape)).at(path));
    };
    if let Some(at) = array.values.iter().position(|value| !value.is_finite()) {
        return Err(bad(format!("point {} is not finite", at / 3)).at(path));
    }
    let point = |xyz: &[f64]| (frame.apply(DVec3::from_slice(xyz)).to_array(), [UNKNOWN_COLOR; 3]);
    Ok(array.values.chunks_exact(3).map(point).collect())
}
