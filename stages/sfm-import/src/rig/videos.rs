//! The numbered frames of the videos of a rig.

use std::path::{Path, PathBuf};

use super::mp4::{self, Header};
use crate::error::{Result, bad};
use crate::files::image_size;
use crate::image_names::image_names;
use crate::params::Params;
use crate::stored_image::{StoredImage, VideoFrame};

/// Largest relative difference between the stated frame rate and that of a video: 29.97 counts as 30.
const RATE_TOLERANCE: f64 = 0.01;

/// The frames of one camera, in order.
pub(crate) struct Video {
    /// Name of the camera, e.g. `cam00`.
    pub(crate) camera: String,
    /// One image per instant.
    pub(crate) frames: Vec<PathBuf>,
    /// The number of the first frame.
    pub(crate) first: u64,
    /// The header, if the frames are in a video file, which then is the path of each of them.
    header: Option<Header>,
}

/// The images directly in a folder, in natural order.
pub(crate) fn images(folder: &Path) -> Vec<PathBuf> {
    let names = image_names(folder).into_iter().filter(|name| !name.contains('/'));
    names.map(|name| folder.join(name)).collect()
}

impl Video {
    /// The frames of one camera, in the order of the numbers that end their names. Numbers must be consecutive, because a
    /// gap would shift all later frames in time.
    pub(crate) fn new(camera: String, frames: Vec<PathBuf>) -> Result<Self> {
        let numbers = frames.iter().map(|path| number(path)).collect::<Result<Vec<_>>>()?;
        Self::numbered(camera, numbers.into_iter().zip(frames).collect())
    }

    /// Like [`Video::new`], with the number of each frame.
    pub(crate) fn numbered(camera: String, frames: Vec<(u64, PathBuf)>) -> Result<Self> {
        let is_gap = |pair: &[(u64, PathBuf)]| pair[1].0.checked_sub(pair[0].0) != Some(1);
        if let Some(at) = frames.windows(2).position(is_gap) {
            let message = format!("{camera} has frame {} after frame {}", frames[at + 1].0, frames[at].0);
            let hint = "frames must be consecutive and unique; to skip training views, set frame_step";
            return Err(bad(message).hint(hint).at(&frames[at + 1].1));
        }
        let first = frames.first().map_or(0, |(number, _)| *number);
        Ok(Self { camera, frames: frames.into_iter().map(|(_, path)| path).collect(), first, header: None })
    }

    /// The images in `folder`, or else the frames of the video `file`.
    pub(crate) fn in_folder_or_file(camera: String, folder: &Path, file: &Path) -> Result<Self> {
        let images = images(folder);
        if images.is_empty() && file.is_file() { Self::in_file(camera, file) } else { Self::new(camera, images) }
    }

    /// The frames of a video file, numbered from 0.
    fn in_file(camera: String, path: &Path) -> Result<Self> {
        let header = mp4::read(path)?;
        Ok(Self { camera, frames: vec![path.to_owned(); header.frames as usize], first: 0, header: Some(header) })
    }

    /// Width and height of the frames in pixels.
    pub(crate) fn size(&self) -> Result<(u32, u32)> {
        match (self.header, self.frames.first()) {
            (Some(header), _) => Ok(header.size),
            (None, Some(first)) => image_size(first),
            (None, None) => Err(bad(format!("{} has no frames", self.camera))),
        }
    }

    /// The place of the frame of this rank in the video file, if there is one.
    pub(crate) fn stored(&self, rank: u32) -> Option<StoredImage> {
        let header = self.header?;
        let index = u32::try_from(self.first).ok()?.checked_add(rank)?;
        Some(StoredImage::InVideo(VideoFrame { index, size: header.size }))
    }

    fn frames_text(&self) -> String {
        let last = self.first + self.frames.len().saturating_sub(1) as u64;
        format!("{} frames ({} to {last})", self.frames.len(), self.first)
    }

    /// Keeps `count` frames from the number `first` on.
    fn keep(&mut self, first: u64, count: usize) {
        let skipped = usize::try_from(first.saturating_sub(self.first)).unwrap_or(usize::MAX).min(self.frames.len());
        self.frames.drain(..skipped);
        self.frames.truncate(count);
        self.first += skipped as u64;
    }
}

/// The frame rate that the header of a video states, rounded to two digits; `None` if it differs from `fps` by rounding only.
pub(crate) fn other_rate(path: &Path, fps: f64) -> Option<f64> {
    let rate = mp4::read(path).ok()?.fps;
    let differs = !((rate / fps - 1.0).abs() <= RATE_TOLERANCE);
    differs.then(|| (100.0 * rate).round() / 100.0)
}

/// Warns of videos whose frame rate differs from `fps`: all times would be wrong.
pub(crate) fn check_rates(videos: &[Video], fps: f64, warnings: &mut Vec<String>) {
    let differs = |header: &Header| !((header.fps / fps - 1.0).abs() <= RATE_TOLERANCE);
    let other = videos.iter().find_map(|video| Some((video, video.header.filter(differs)?)));
    warnings.extend(other.map(|(video, header)| {
        format!(
            "{} has {:.2} frames per second, but fps = {fps}: set fps to that of the videos",
            video.camera, header.fps
        )
    }));
}

/// Keeps the instants that `first_frame` and `frame_count` select (by default `default_count`), and checks that all
/// videos have them. Returns the difference from all frames, for the protocol.
pub(crate) fn select(
    videos: &mut [Video],
    params: &Params,
    default_count: Option<u32>,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let Some(reference) = videos.first() else { return Err(bad("the rig has no camera")) };
    let (found, first) = (reference.frames.len(), params.first_frame.unwrap_or(reference.first));
    let count = params.frame_count.or(default_count).map_or(usize::MAX, |count| count as usize);
    videos.iter_mut().for_each(|video| video.keep(first, count));
    if params.frame_count.is_none() && found > count {
        warnings.push(format!("only the first {count} of {found} frames are used, as in the literature"));
    }
    same_instants(videos)?;
    let (kept, video) = (videos[0].frames.len(), &videos[0]);
    let lacks = params.frame_count.is_some_and(|wanted| kept < wanted as usize);
    if kept == 0 || lacks || video.first != first {
        let message = format!("{} has {} from number {first} on", video.camera, video.frames_text());
        return Err(bad(message).hint("change first_frame or frame_count, or download the other frames"));
    }
    Ok(())
}

/// Refuses videos with different numbers.
fn same_instants(videos: &[Video]) -> Result<()> {
    let reference = &videos[0];
    let differs = |video: &&Video| (video.first, video.frames.len()) != (reference.first, reference.frames.len());
    let Some(video) = videos.iter().find(differs) else { return Ok(()) };
    let message = format!(
        "{} has {}, but {} has {}",
        video.camera,
        video.frames_text(),
        reference.camera,
        reference.frames_text()
    );
    let hint = "all cameras must show the same instants: extract the frames of both again";
    let folder = video.frames.first().or(reference.frames.first()).and_then(|path| path.parent());
    let failure = bad(message).hint(hint);
    Err(match folder {
        Some(folder) => failure.at(folder),
        None => failure,
    })
}

/// The frame number in a file name, e.g. 12 for `frame_0012.png`.
pub(crate) fn number(path: &Path) -> Result<u64> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let digits = stem.rsplit(|symbol: char| !symbol.is_ascii_digit()).next().unwrap_or_default();
    digits.parse().map_err(|_| {
        bad("the file name does not end in a frame number").hint("name the frames 0000.png, 0001.png, …").at(path)
    })
}
