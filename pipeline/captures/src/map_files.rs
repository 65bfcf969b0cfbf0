//! Finds the stored maps of views: one file per view, or one array with the maps of a whole video.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use engine::{Failure, FailureKind};
use scene::maps::formats::{self, Content};
use scene::{Capture, FloatImage, Naming, Videos, View, ViewFolder};

use crate::view_files::match_required;

/// The stored map of one view.
#[derive(Clone, Debug)]
pub struct MapFile {
    /// The file.
    pub path: PathBuf,
    content: Content,
    /// The maps of the whole video and the index of this one, if the file holds all of them.
    frame: Option<(Arc<Vec<FloatImage>>, usize)>,
}

/// The stored maps of the views of a capture.
pub struct MapFiles {
    /// One entry per view, in the order of the capture.
    pub files: Vec<Option<MapFile>>,
    /// Number of files that belong to no view.
    pub unused: usize,
}

impl MapFile {
    /// The stored values.
    pub fn read(&self) -> scene::Result<FloatImage> {
        match &self.frame {
            Some((maps, index)) => Ok(maps[*index].clone()),
            None => formats::read(&self.path, self.content),
        }
    }

    /// Whether the file is a PNG image.
    pub fn is_png(&self) -> bool {
        self.path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
    }
}

impl MapFiles {
    /// No map for any view.
    pub fn none(capture: &Capture) -> Self {
        Self { files: vec![None; capture.views.len()], unused: 0 }
    }

    /// Finds the map of every view: in an array of all frames, if that is the only file of the folder and has neither
    /// the name nor the number of a view; otherwise in a separate file, as [`match_required`] does. For an array,
    /// `ends` are the frame of the first map and the number of frames at the ends that may lack a map.
    pub fn find(
        folder: &ViewFolder,
        content: Content,
        capture: &Capture,
        naming: Naming,
        ends: [u32; 2],
        needs: impl Fn(&View) -> bool,
    ) -> anyhow::Result<Self> {
        if let Some(path) = whole_video(folder, capture) {
            return Ok(Self { files: frames(path, content, capture, ends)?, unused: 0 });
        }
        let matched = match_required(folder, capture, naming, needs)?;
        let one = |path: &Path| MapFile { path: path.into(), content, frame: None };
        Ok(Self { files: matched.files.into_iter().map(|path| path.map(one)).collect(), unused: matched.unused })
    }
}

/// The only file of a folder, if it is an array with neither the name nor the number of a view: the maps of a whole
/// video.
fn whole_video<'f>(folder: &'f ViewFolder, capture: &Capture) -> Option<&'f Path> {
    let (stem, path) = folder.only_file().filter(|_| capture.views.len() > 1)?;
    let extension = path.extension()?.to_str()?.to_lowercase();
    let is_of_one_frame = stem.parse::<u32>().is_ok() || capture.views.iter().any(|view| view.name == stem);
    Some(path).filter(|_| formats::VIDEO_EXTENSIONS.contains(&extension.as_str()) && !is_of_one_frame)
}

/// The number of frames of the only video of a capture, and the frame number of every view. The error names `path` if
/// there are several videos.
pub fn frame_numbers(capture: &Capture, path: &Path) -> anyhow::Result<(u32, Vec<u32>)> {
    let videos = Videos::of(capture);
    let numbers: Option<Vec<u32>> = capture.views.iter().map(|view| videos.number(view)).collect();
    let several = || {
        let message = "one file for a whole video, but the views belong to several videos";
        Failure::new(FailureKind::BadInput, message).hint("write one file per view, with its name").at(path)
    };
    let numbers = numbers.ok_or_else(several)?;
    Ok((numbers.iter().max().map_or(0, |last| last + 1), numbers))
}

/// The map of every view from an array with one map per frame of the video.
fn frames(
    path: &Path,
    content: Content,
    capture: &Capture,
    [first, missing]: [u32; 2],
) -> anyhow::Result<Vec<Option<MapFile>>> {
    let (frames, numbers) = frame_numbers(capture, path)?;
    let maps = Arc::new(formats::read_video(path, content)?);
    let first = match frames.checked_sub(maps.len() as u32) {
        Some(0) => 0,
        Some(fewer) if fewer == missing => first,
        _ => {
            let message = format!("{} maps in one array for a video of {frames} frames", maps.len());
            let hint = "the estimator must read the frames of the capture, no more and no less";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into());
        }
    };
    let map = |number: u32| {
        let index = number.checked_sub(first).map(|index| index as usize).filter(|index| *index < maps.len())?;
        Some(MapFile { path: path.into(), content, frame: Some((maps.clone(), index)) })
    };
    Ok(numbers.into_iter().map(map).collect())
}
