//! Frames of a video inpainter, with their depth.

use std::path::{Path, PathBuf};

use captures::{MapFile, MapFiles, match_required, open_folder};
use engine::{Failure, FailureKind};
use scene::image_file::{self, RgbImage};
use scene::maps::alignment::fit_scale_shift;
use scene::maps::fit_to_view;
use scene::maps::formats::{self, Content};
use scene::{Capture, DepthMap, FloatImage, Mask, ResizeFilter, Split, View};

use crate::static_view::StaticView;
use crate::{FilledView, Params};

/// File extensions of frames.
const IMAGES: [&str; 3] = ["png", "jpg", "jpeg"];
/// Inner and outer distance from moving pixels of the ring of static pixels on which depth is aligned: near, so that
/// the seam closes, but beyond blurred edges.
const RING_PX: [u32; 2] = [5, 20];

/// The files of an inpainter, one entry per view of a capture.
pub(crate) struct Frames<'a> {
    params: &'a Params,
    images: Vec<Option<PathBuf>>,
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
        let folder = open_folder(images, &IMAGES, "inpainted frames")?;
        let matched = match_required(&folder, capture, params.naming, is_required)?;
        let images = matched.files.into_iter().map(|path| path.map(Path::to_path_buf)).collect();
        let maps = |dir: &Path| {
            let folder = open_folder(dir, &formats::EXTENSIONS, "depth of inpainted frames")?;
            MapFiles::find(&folder, Content::Depth, capture, params.naming, [0, 0], is_required)
        };
        let depths = depths.map(maps).transpose()?.unwrap_or_else(|| MapFiles::none(capture)).files;
        Ok(Self { params, images, depths })
    }

    /// Fills the moving pixels of a view from its inpainted frame.
    pub(crate) fn fill(&self, index: usize, view: &StaticView) -> anyhow::Result<FilledView> {
        let path = self.images[index].as_deref().expect("every training view has a frame");
        let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let frame = FloatImage::from_rgb(&image_file::read_rgb(path)?);
        // Inpainters round sizes to multiples of 8.
        let frame = frame.resized(width, height, ResizeFilter::Lanczos3).to_rgb8()?;
        let pick = |x: u32, y: u32| {
            let moves = view.moving.inside[y as usize * width as usize + x as usize];
            if moves { *frame.get_pixel(x, y) } else { *view.image.get_pixel(x, y) }
        };
        let image = RgbImage::from_fn(width, height, pick);
        let depth = self.depths[index].as_ref().map(|file| self.depth(file, view)).transpose()?;
        Ok(FilledView { image, depth, unfilled: Mask::empty(width, height).to_labels() })
    }

    /// The depth of the view where it is static, and the depth of the inpainted frame elsewhere. The latter is brought
    /// to the scale of the view by a scale and a shift of inverse depth, fitted on a ring around the moving pixels.
    fn depth(&self, file: &MapFile, view: &StaticView) -> anyhow::Result<DepthMap> {
        let path = &file.path;
        let no_depth = || {
            Failure::new(FailureKind::BadInput, "inpainted depth cannot be aligned: the view has no depth of its own")
        };
        let hint = "wire priors with depth to the port priors, or remove depth_folder";
        let own = view.depth.as_ref().ok_or_else(|| no_depth().hint(hint).at(path))?;
        let (values, _) = fit_to_view(file.read()?, &view.camera.intrinsics, path)?;
        let inverse_depths = self.params.depth_kind.inverse_depths(&values, &view.camera, 1.0);
        let inverse_depths = inverse_depths.map_err(|error| error.at(path))?;
        if view.moving.count() == 0 {
            return Ok(own.clone());
        }
        let ring = view.moving.dilated(RING_PX[1]).without(&view.moving.dilated(RING_PX[0]));
        let on_ring = (0..ring.inside.len()).filter(|at| ring.inside[*at]);
        let samples: Vec<_> =
            on_ring.filter_map(|at| Some((inverse_depths[at]?, 1.0 / view.static_depth(at)?))).collect();
        let [inner, outer] = RING_PX;
        let message = || {
            format!("inpainted depth does not continue the depth of the view {inner} to {outer} px around what moves")
        };
        let not_aligned = || Failure::new(FailureKind::BadInput, message()).hint("check depth_kind").at(path);
        let fit = fit_scale_shift(&samples).ok_or_else(not_aligned)?;
        let filled = |at: usize| {
            let inverse_depth = inverse_depths[at].map(|value| fit.apply(value)).filter(|value| *value > 0.0);
            inverse_depth.map_or(0.0, |inverse_depth| (1.0 / inverse_depth) as f32)
        };
        let pick = |at: usize| if view.moving.inside[at] { filled(at) } else { own.depth_view[at] };
        let depth_view = (0..own.depth_view.len()).map(pick).collect();
        Ok(DepthMap { depth_view, ..*own })
    }
}
