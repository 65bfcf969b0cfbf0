//! Where the map of a view is stored: in a file of its own, or in an array with the maps of a whole video.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use engine::{Failure, FailureKind};
use scene::maps::formats::{self, Content};
use scene::{Capture, FloatImage, Videos, ViewFolder};

/// The stored map of one view.
#[derive(Clone, Debug)]
pub(crate) struct MapFile {
    /// The file.
    pub(crate) path: PathBuf,
    /// The maps of the whole video and the index of this one, if the file holds all of them.
    frame: Option<(Arc<Vec<FloatImage>>, usize)>,
}

impl MapFile {
    /// A file with a single map.
    pub(crate) fn one(path: &Path) -> Self {
        Self { path: path.into(), frame: None }
    }

    /// The stored values.
    pub(crate) fn read(&self, content: Content) -> scene::Result<FloatImage> {
        match &self.frame {
            Some((maps, index)) => Ok(maps[*index].clone()),
            None => formats::read(&self.path, content),
        }
    }

    /// Whether the file is a PNG image.
    pub(crate) fn is_png(&self) -> bool {
        self.path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
    }
}

/// The only file of a folder, if it is an array that bears neither the name nor the number of a view: the maps of a whole
/// video.
pub(crate) fn whole_video<'f>(folder: &'f ViewFolder, capture: &Capture) -> Option<&'f Path> {
    let (stem, path) = folder.only_file().filter(|_| capture.views.len() > 1)?;
    let extension = path.extension()?.to_str()?.to_lowercase();
    let is_of_one_frame = stem.parse::<u32>().is_ok() || capture.views.iter().any(|view| view.name == stem);
    Some(path).filter(|_| formats::VIDEO_EXTENSIONS.contains(&extension.as_str()) && !is_of_one_frame)
}

/// The map of every view from an array with one map per frame of the video. `first` is the frame of the first map, and
/// `missing` the number of frames at the ends that may lack one.
pub(crate) fn frames(
    path: &Path,
    content: Content,
    capture: &Capture,
    [first, missing]: [u32; 2],
) -> anyhow::Result<Vec<Option<MapFile>>> {
    let videos = Videos::of(capture);
    let numbers: Option<Vec<u32>> = capture.views.iter().map(|view| videos.number(view)).collect();
    let failure = |message: String, hint: &str| Failure::new(FailureKind::BadInput, message).hint(hint).at(path);
    let Some(numbers) = numbers else {
        let message = "the maps of a whole video in one array, but the views belong to several videos".into();
        return Err(failure(message, "write one file per view, with its name").into());
    };
    let maps = Arc::new(formats::read_video(path, content)?);
    let frames = numbers.iter().max().map_or(0, |last| last + 1);
    let first = match frames.checked_sub(maps.len() as u32) {
        Some(0) => 0,
        Some(fewer) if fewer == missing => first,
        _ => {
            let message = format!("{} maps in one array for a video of {frames} frames", maps.len());
            return Err(
                failure(message, "the estimator must read the frames of the capture, no more and no less").into()
            );
        }
    };
    let map = |number: u32| {
        let index = number.checked_sub(first).map(|index| index as usize).filter(|index| *index < maps.len())?;
        Some(MapFile { path: path.into(), frame: Some((maps.clone(), index)) })
    };
    Ok(numbers.into_iter().map(map).collect())
}
