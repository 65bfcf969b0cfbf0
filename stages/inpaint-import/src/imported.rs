//! Frames of a video inpainter, and their depth.

use std::path::{Path, PathBuf};

use depth_flow_import::alignment::fit_scale_shift;
use depth_flow_import::depth::inverse_depths;
use depth_flow_import::folder::ViewFolder;
use depth_flow_import::formats::{self, Content};
use depth_flow_import::params::DepthParams;
use depth_flow_import::raster;
use engine::{Failure, FailureKind};
use layer_split::Mask;
use scene::image_file::{self, RgbImage};
use scene::{Capture, DepthMap, FloatImage, ResizeFilter, Split};

use crate::still::StillView;
use crate::{FilledView, Params};

/// Endings of frames.
const IMAGES: [&str; 3] = ["png", "jpg", "jpeg"];
/// Depth is aligned on the pixels at rest between these distances from what moves: near, so that the seam closes, but
/// not at the blurred edge.
const RING_PX: [u32; 2] = [5, 20];

/// The files of the views of a capture.
pub struct Frames<'a> {
    params: &'a Params,
    images: Vec<Option<PathBuf>>,
    depths: Vec<Option<PathBuf>>,
}

impl<'a> Frames<'a> {
    /// Finds the files; every training view needs a frame, and depth where a folder of it is named.
    pub fn find(images: &Path, depths: Option<&Path>, capture: &Capture, params: &'a Params) -> anyhow::Result<Self> {
        let files = |dir: &Path, extensions: &[&str]| -> anyhow::Result<Vec<Option<PathBuf>>> {
            let missing = || Failure::new(FailureKind::MissingData, "no such folder").at(dir);
            let folder = ViewFolder::open(dir, extensions)?.ok_or_else(missing)?;
            let (found, _) = folder.of_views(capture, |view| view.split == Split::Train)?;
            Ok(found.into_iter().map(|path| path.map(Path::to_path_buf)).collect())
        };
        let depths = match depths {
            Some(dir) => files(dir, &formats::EXTENSIONS)?,
            None => vec![None; capture.views.len()],
        };
        Ok(Self { params, images: files(images, &IMAGES)?, depths })
    }

    /// The inpainted frame of a view where something moves, and the view itself elsewhere.
    pub fn fill(&self, index: usize, view: &StillView) -> anyhow::Result<FilledView> {
        let path = self.images[index].as_deref().expect("every training view has a frame");
        let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let frame = FloatImage::from_rgb(&image_file::read_rgb(path)?);
        // Inpainters work at sizes that are multiples of 8.
        let frame = frame.resized(width, height, ResizeFilter::Lanczos3).to_rgb8()?;
        let pick = |x: u32, y: u32| {
            let moves = view.moving.inside[y as usize * width as usize + x as usize];
            if moves { *frame.get_pixel(x, y) } else { *view.image.get_pixel(x, y) }
        };
        let image = RgbImage::from_fn(width, height, pick);
        let depth = self.depths[index].as_ref().map(|path| self.depth(path, view)).transpose()?;
        Ok(FilledView { image, depth, unfilled: Mask::empty(width, height).to_labels() })
    }

    /// The view's depth where it is at rest, and elsewhere that of the inpainted frame, in the view's scale: scale and
    /// shift of inverse depth are fitted on the ring around what moves.
    fn depth(&self, path: &Path, view: &StillView) -> anyhow::Result<DepthMap> {
        let no_depth = || Failure::new(FailureKind::BadInput, "inpainted depth needs the depth of the view itself");
        let hint = "wire priors with depth to the port priors, or remove depth_folder";
        let own = view.depth.as_ref().ok_or_else(|| no_depth().hint(hint).at(path))?;
        let kind = DepthParams { kind: self.params.depth_kind, ..DepthParams::default() };
        let (values, _) = raster::fitted(formats::read(path, Content::Depth)?, &view.camera.intrinsics, path)?;
        let inverse_depths = inverse_depths(&values, &view.camera, &kind).map_err(|error| error.at(path))?;
        if view.moving.count() == 0 {
            return Ok(own.clone());
        }
        let ring = view.moving.dilated(RING_PX[1]).without(&view.moving.dilated(RING_PX[0]));
        let on_ring = (0..ring.inside.len()).filter(|at| ring.inside[*at]);
        let samples: Vec<_> =
            on_ring.filter_map(|at| Some((inverse_depths[at]?, 1.0 / view.still_depth(at)?))).collect();
        let [inner, outer] = RING_PX;
        let message = || format!("inpainted depth does not continue that of the view {inner} to {outer} px outside");
        let not_aligned = || Failure::new(FailureKind::BadInput, message()).hint("is depth_kind right?").at(path);
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
