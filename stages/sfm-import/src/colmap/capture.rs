//! A sparse model and its images as posed, timed and split frames.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use scene::Split;

use crate::bounds::StatedBounds;
use crate::colmap::fixed_cameras;
use crate::colmap::image_folder::{self, ImageFolder, is_reduced};
use crate::colmap::layout::{mask_path, numbered_models, sparse_dir};
use crate::colmap::model::{Model, RegisteredImage};
use crate::colmap::model_files::registered_count;
use crate::colmap::name_gaps;
use crate::colmap::one_instant;
use crate::colmap::places::{Places, places};
use crate::colmap::read_model;
use crate::companion_files::mask_warning;
use crate::error::{Result, bad};
use crate::files::{self, image_size};
use crate::image_names::{sort_by_name, view_name};
use crate::mask_polarity::SetPixels;
use crate::params::{Format, Params};
use crate::source::{Frame, Quality, ReprojectionError, SourceCapture, time_map};
use crate::split;

/// Mean reprojection error in pixels above which poses blur a trained model; good models stay below 1.
const POOR_REPROJECTION_PX: f64 = 2.0;
/// Relative difference between stored and recomputed error above which a warning is issued.
const STORED_TOLERANCE: f64 = 0.1;

/// Reads the model and the names of the images in `dir`.
///
/// Each sub-folder of images is one camera of a rig, unless names and poses show otherwise ([`places`]). A frame's number
/// counts all images, registered or not, so that an image without a pose leaves a gap in time instead of shifting later
/// frames.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let sparse = sparse_dir(dir).ok_or_else(|| bad("no COLMAP model").at(dir))?;
    let mut model = read_model(&sparse)?;
    let foreign_folder = image_folder::drop_foreign_folder(dir, &mut model);
    let fixed_cameras = fixed_cameras::register_frames(dir, &mut model);
    let folder = ImageFolder::choose(dir, &model, params)?;
    let present = folder.names(&model);
    check_registered_share(&model, &present, params, &sparse)?;
    let quality = Quality {
        registered: model.images.len(),
        images: present.len().max(model.images.len()),
        reprojection: model.reprojection_error(),
    };
    let mut warnings = warnings(dir, &sparse, &model, &quality);
    warnings.extend(folder.warnings.iter().cloned());
    warnings.extend(foreign_folder.into_iter().chain(fixed_cameras));
    let places = places(present.iter().map(String::as_str), &model);
    warnings.extend(places.note.filter(|_| !params.is_static()).map(str::to_owned));
    if !params.is_static() {
        warnings.extend(name_gaps::warning(&places));
    }
    let source = FrameSource { dir, folder: &folder, sparse: &sparse, model: &model, params };
    let mut frames = source.frames(&places)?;
    if frames.iter().any(|frame| frame.frame_index != frames[0].frame_index) {
        let has_own = model.cameras.len() > 1 && model.cameras.len() == model.images.len();
        let own = has_own.then(|| "each image has its own intrinsics".to_owned());
        let reason = one_instant::reason(&frames).or(own);
        warnings.extend(reason.map(|reason| format!("{reason}; if all images show one instant, set static = true")));
    }
    warnings.extend(drop_misfit_masks(&mut frames, folder.reduction));
    let mut rules = vec![hold_out(&mut frames, places.moving, params)];
    if folder.reduction > 1 {
        rules.push(format!("images at 1/{}", folder.reduction));
    }
    let time_map = time_map(&frames, params.is_static(), params.fps);
    rules.extend(split::refine(&mut frames, params));
    Ok(SourceCapture {
        name: files::name(dir),
        format: Format::Colmap,
        dataset: "colmap",
        wants_test: params.every_nth > 0,
        split_rule: rules.join(", "),
        time_rule: if params.is_static() { "one instant".into() } else { "sorted frame / (frames - 1)".into() },
        time_map,
        frames,
        points: model.points.values().map(|point| (point.position.to_array(), point.rgb)).collect(),
        set_pixels: SetPixels::Unstated,
        cloud: None,
        stated_bounds: StatedBounds::default(),
        quality: Some(quality),
        warnings,
    })
}

/// Marks test views and returns the rule: those of the fixed cameras next to the `moving` one, which is needed for training.
/// Without a moving camera, the rule for all captures without a split applies.
fn hold_out(frames: &mut [Frame], moving: Option<u32>, params: &Params) -> String {
    let Some(moving) = moving.filter(|_| !params.is_static() && params.every_nth > 0) else {
        return split::hold_out(frames, params.is_static(), params);
    };
    frames.iter_mut().filter(|frame| frame.camera_index != moving).for_each(|frame| frame.split = Split::Test);
    "fixed cameras held out".into()
}

/// Refuses a model that registers fewer images than the parameters require.
fn check_registered_share(model: &Model, present: &[String], params: &Params, sparse: &Path) -> Result<()> {
    let registered = model.images.len();
    let total = registered.max(present.len());
    if registered as f64 >= params.min_registered_share * total as f64 {
        return Ok(());
    }
    let names: BTreeSet<&str> = model.images.values().map(|image| image.name.as_str()).collect();
    let lost = present.iter().filter(|name| !names.contains(name.as_str()));
    let lost: Vec<&str> = lost.take(3).map(String::as_str).collect();
    let percent = 100.0 * registered as f64 / total as f64;
    let message =
        format!("only {registered} of {total} images ({percent:.0} %) have a pose; missing: {}, …", lost.join(", "));
    let hint = format!(
        "mask moving objects in structure from motion, or lower min_registered_share (now {})",
        params.min_registered_share
    );
    Err(bad(message).hint(hint).at(sparse))
}

fn warnings(dir: &Path, sparse: &Path, model: &Model, quality: &Quality) -> Vec<String> {
    let mut warnings = Vec::new();
    let models = sparse.parent().map(numbered_models).unwrap_or_default();
    if models.len() > 1 && models.contains(&sparse.to_owned()) {
        let used = sparse.strip_prefix(dir).unwrap_or(sparse).display();
        let count = |model: &PathBuf| format!("{} in {}", registered_count(model), files::name(model));
        warnings.push(format!(
            "sparse/ contains {} models, because structure from motion split the scene: only {used} is used, which has the most \
             images ({})",
            models.len(),
            models.iter().map(count).collect::<Vec<_>>().join(", ")
        ));
    }
    if model.points.is_empty() {
        warnings.push("the model has no points: initial points will be random".into());
    }
    let lost = quality.images - quality.registered;
    if lost > 0 {
        warnings.push(format!("{lost} of {} images have no pose and are skipped", quality.images));
    }
    if let Some(factor) = model.lost_scale() {
        warnings.push(format!(
            "the distance of the points differs by a factor of {factor:.0e} between images: structure from motion lost the \
             scale where the camera only turned, and the poses are unusable; `pipeline prepare` tries other settings"
        ));
    }
    let reprojection = quality.reprojection.filter(ReprojectionError::is_plausible);
    if reprojection.is_none() && quality.reprojection.is_some() {
        warnings.push("points reproject far outside the images: the poses are wrong".into());
    }
    if let Some(error) = reprojection.filter(|error| !(error.recomputed_px <= POOR_REPROJECTION_PX)) {
        warnings
            .push(format!("the mean reprojection error is {:.1} px: the poses are inaccurate", error.recomputed_px));
    }
    let differs =
        |error: &ReprojectionError| !((error.recomputed_px / error.stored_px - 1.0).abs() <= STORED_TOLERANCE);
    if let Some(error) = reprojection.filter(|error| error.stored_px > 0.0 && differs(error)) {
        let ReprojectionError { recomputed_px, stored_px } = error;
        warnings.push(format!(
            "the mean reprojection error is {recomputed_px:.2} px, but COLMAP stored {stored_px:.2} px: the model was \
             resized or undistorted later, or its poses were edited"
        ));
    }
    warnings
}

/// The inputs that all frames of a model share.
struct FrameSource<'a> {
    dir: &'a Path,
    folder: &'a ImageFolder,
    sparse: &'a Path,
    model: &'a Model,
    params: &'a Params,
}

impl FrameSource<'_> {
    /// All registered images: those of a static capture in the natural order of their names, others by camera and frame.
    fn frames(&self, places: &Places) -> Result<Vec<Frame>> {
        let mut registered: Vec<&RegisteredImage> = self.model.images.values().collect();
        sort_by_name(&mut registered, |image| &image.name);
        if !self.params.is_static() {
            // In the natural order of names, 9.5 precedes 9.25.
            registered.sort_by_key(|image| places.of[image.name.as_str()]);
        }
        let frame =
            |(index, image): (usize, &&RegisteredImage)| self.frame(index, image, places.of[image.name.as_str()]);
        registered.iter().enumerate().map(frame).collect()
    }

    /// The `index`-th registered image, as a training view; test views are chosen later.
    fn frame(&self, index: usize, image: &RegisteredImage, (camera, frame): (u32, u32)) -> Result<Frame> {
        let is_static = self.params.is_static();
        Ok(Frame {
            name: view_name(&image.name),
            split: Split::Train,
            image: self.folder.file(&image.name).map_err(|failure| failure.at(self.sparse))?,
            stored_image: None,
            mask: mask_path(self.dir, &image.name),
            depth: None,
            lens: self.folder.lenses[&image.camera_id],
            camera_from_world: image.camera_from_world(),
            camera_index: if is_static { index as u32 } else { camera },
            frame_index: if is_static { 0 } else { frame },
            time_secs: if is_static { 0.0 } else { f64::from(frame) / self.params.fps },
            stated_in: self.sparse.to_owned(),
        })
    }
}

/// Drops masks whose size is neither that of their image nor that of the model, of which the images are `reduction` times
/// smaller. Returns a warning about them, or about images without masks.
fn drop_misfit_masks(frames: &mut [Frame], reduction: u32) -> Option<String> {
    let stated = frames.iter().filter(|frame| frame.mask.is_some()).count();
    for frame in &mut *frames {
        let (width, height) = (frame.lens.intrinsics.width, frame.lens.intrinsics.height);
        let fits = |(w, h)| [1, reduction].iter().any(|&by| is_reduced(w, width, by) && is_reduced(h, height, by));
        frame.mask.take_if(|mask| !image_size(mask).is_ok_and(fits));
    }
    let used = frames.iter().filter(|frame| frame.mask.is_some()).count();
    mask_warning(stated, used, frames.len())
}
