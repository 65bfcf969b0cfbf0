//! Frames of a video inpainter, with their depth.

use std::path::{Path, PathBuf};

use captures::{MapFile, MapFiles, frame_numbers, match_required, open_folder};
use engine::{Failure, FailureKind};
use scene::image_file::{self, RgbImage};
use scene::maps::alignment::fit_scale_shift;
use scene::maps::fit_to_view;
use scene::maps::formats::{self, Content};
use scene::{Capture, DepthMap, FloatImage, Mask, ResizeFilter, Split, View, pixels};

use crate::continuation::continued;
use crate::static_view::StaticView;
use crate::{FilledView, Params, video};

/// The folder in which ProPainter saves frames, next to its video.
const SAVED: &str = "frames";
/// File extensions of frames.
const IMAGES: [&str; 3] = ["png", "jpg", "jpeg"];
/// Inner and outer radius of the ring of static pixels around moving pixels on which depth is aligned: close enough to
/// close the seam, but beyond blurred edges. Depth is also continued from beyond the inner radius.
const RING_PX: [u32; 2] = [5, 20];

/// An inpainted frame: a file, or a frame of a decoded video.
enum Inpainted {
    File(PathBuf),
    Decoded(RgbImage),
}

/// The files of an inpainter, one entry per view of a capture.
pub(crate) struct Frames<'a> {
    params: &'a Params,
    images: Vec<Option<Inpainted>>,
    depths: Vec<Option<MapFile>>,
}

impl<'a> Frames<'a> {
    /// Finds the files. Every training view needs a frame and, if a folder of depth is given, a depth map.
    pub(crate) fn find(
        images: &Path,
        depths: Option<&Path>,
        capture: &Capture,
        params: &'a Params,
    ) -> anyhow::Result<Self> {
        let is_required = |view: &View| view.split == Split::Train;
        // The results of ProPainter: a folder of frames, if they were saved, and a video.
        let saved = images.join(SAVED);
        let images = if saved.is_dir() { saved.as_path() } else { images };
        let folder = open_folder(images, &IMAGES, "inpainted frames")?;
        let video = if folder.is_empty() { video::find(images)? } else { None };
        let images = match video {
            Some(path) => video_frames(&path, capture)?,
            None => {
                let matched = match_required(&folder, capture, params.naming, is_required)?;
                matched.files.into_iter().map(|path| path.map(|path| Inpainted::File(path.into()))).collect()
            }
        };
        let maps = |dir: &Path| {
            let folder = open_folder(dir, &formats::EXTENSIONS, "depth of inpainted frames")?;
            MapFiles::find(&folder, Content::Depth, capture, params.naming, [0, 0], is_required)
        };
        let depths = depths.map(maps).transpose()?.unwrap_or_else(|| MapFiles::none(capture)).files;
        Ok(Self { params, images, depths })
    }

    /// The inpainted frame of a view at this size, if there is one.
    fn image(&self, index: usize, (width, height): (u32, u32)) -> scene::Result<Option<RgbImage>> {
        let image = match &self.images[index] {
            Some(Inpainted::File(path)) => image_file::read_rgb(path)?,
            Some(Inpainted::Decoded(image)) => image.clone(),
            None => return Ok(None),
        };
        // Inpainters round sizes to multiples of 8.
        FloatImage::from_rgb(&image).resized(width, height, ResizeFilter::Lanczos3).to_rgb8().map(Some)
    }

    /// The mean difference, in grey levels, between the frame of the view `file` and the static pixels of another view; none
    /// without such a frame.
    pub(crate) fn misfit(&self, view: &StaticView, file: usize) -> anyhow::Result<Option<f64>> {
        let size = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let Some(frame) = self.image(file, size)? else { return Ok(None) };
        let all = view.image.pixels().zip(frame.pixels()).zip(&view.moving.inside);
        let still = all.filter(|(_, moving)| !**moving).map(|((a, b), _)| (a.0, b.0));
        Ok(pixels::mean_difference(still))
    }

    /// Fills the moving pixels of a view from its inpainted frame.
    pub(crate) fn fill(&self, index: usize, view: &StaticView) -> anyhow::Result<FilledView> {
        let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let frame = self.image(index, (width, height))?.expect("every training view has a frame");
        let pick = |x: u32, y: u32| {
            let moves = view.moving.inside[y as usize * width as usize + x as usize];
            if moves { *frame.get_pixel(x, y) } else { *view.image.get_pixel(x, y) }
        };
        let image = RgbImage::from_fn(width, height, pick);
        let depth = match &self.depths[index] {
            Some(file) => Some(self.depth(file, view)?),
            None => view.depth.as_ref().map(|own| {
                let continued = continued(own, &view.moving.dilated(RING_PX[0]));
                replaced(own, &view.moving, |at| continued.depth_view[at])
            }),
        };
        Ok(FilledView { image, depth, unfilled: Mask::empty(width, height).to_labels() })
    }

    /// The depth of the view where it is static, and the depth of the inpainted frame elsewhere. The latter is fitted
    /// to the view by a scale and a shift of inverse depth, on a ring around the moving pixels.
    fn depth(&self, file: &MapFile, view: &StaticView) -> anyhow::Result<DepthMap> {
        let path = &file.path;
        let no_depth = || {
            Failure::new(FailureKind::BadInput, "inpainted depth cannot be aligned: the view has no depth of its own")
        };
        let hint = "wire priors with depth to the port priors, or remove depth_folder";
        let own = view.depth.as_ref().ok_or_else(|| no_depth().hint(hint).at(path))?;
        let (values, _) = fit_to_view(file.read()?, &view.camera.intrinsics, path)?;
        let kind = self.params.depth_kind;
        let inverse_depths = kind.inverse_depths(&values, &view.camera, 1.0);
        let inverse_depths = inverse_depths.map_err(|error| error.at(path))?;
        if view.moving.count() == 0 {
            return Ok(own.clone());
        }
        let ring = view.moving.dilated(RING_PX[1]).without(&view.moving.dilated(RING_PX[0]));
        let on_ring = (0..ring.inside.len()).filter(|at| ring.inside[*at]);
        let samples: Vec<_> = on_ring
            .filter_map(|at| Some((inverse_depths[at]?, kind.affine_quantity(view.static_depth(at)?))))
            .collect();
        let [inner, outer] = RING_PX;
        let message = || {
            format!(
                "inpainted depth does not continue the depth of the view {inner} to {outer} px around the moving pixels"
            )
        };
        let not_aligned = || Failure::new(FailureKind::BadInput, message()).hint("check depth_kind").at(path);
        let fit = fit_scale_shift(&samples).ok_or_else(not_aligned)?;
        let filled = |at: usize| {
            let inverse_depth = inverse_depths[at].map(|value| fit.apply(value)).filter(|value| *value > 0.0);
            inverse_depth.map_or(0.0, |fitted| kind.affine_quantity(fitted) as f32)
        };
        Ok(replaced(own, &view.moving, filled))
    }
}

/// The depth of a view, with that of its moving pixels replaced.
fn replaced(own: &DepthMap, moving: &Mask, behind: impl Fn(usize) -> f32) -> DepthMap {
    let pick = |at: usize| if moving.inside[at] { behind(at) } else { own.depth_view[at] };
    DepthMap { depth_view: (0..own.depth_view.len()).map(pick).collect(), ..*own }
}

/// The frame of every view from a video, which must have exactly the frames of the capture.
fn video_frames(path: &Path, capture: &Capture) -> anyhow::Result<Vec<Option<Inpainted>>> {
    let (count, numbers) = frame_numbers(capture, path)?;
    let mut frames = Vec::new();
    captures::video::decode(path, None, |_, image| {
        frames.push(image);
        Ok(())
    })?;
    if frames.len() != count as usize {
        let message = format!("{} frames in this video for a capture of {count}", frames.len());
        let hint = "the inpainter must read the frames of the capture, no more and no less";
        return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into());
    }
    Ok(numbers.into_iter().map(|number| Some(Inpainted::Decoded(frames[number as usize].clone()))).collect())
}
