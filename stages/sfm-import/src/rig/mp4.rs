//! The header of an MP4 or MOV file: size, number and rate of the frames of its video. A plan needs them, and must not depend
//! on whether a decoder is installed.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use super::boxes::{BOX_START, boxes, child, number};
use super::edits::{Edit, edits, shown};
use crate::error::{Result, bad};

/// Larger headers indicate damage: the header of an hour of video has a few megabytes.
const MAX_HEADER: u64 = 256 << 20;
/// More frames indicate damage: this number is nine hours at 30 frames per second.
const MAX_FRAMES: u32 = 1_000_000;
/// Upright images: the first and the last two of the matrix's upper left four numbers, in 16.16 fixed point.
const UPRIGHT: [u32; 4] = [1 << 16, 0, 0, 1 << 16];

/// The video of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Header {
    /// Width and height of a frame in pixels.
    pub(crate) size: (u32, u32),
    /// Number of frames that are shown.
    pub(crate) frames: u32,
    /// Frames per second, on average.
    pub(crate) fps: f64,
}

/// Reads the header; no frame is decoded.
pub(crate) fn read(path: &Path) -> Result<Header> {
    let blame = |why: &str| bad(format!("not a readable MP4 video ({why})")).hint("download it again").at(path);
    let movie = movie(path).map_err(|error| blame(&error.to_string()))?;
    let movie = movie.ok_or_else(|| blame("it has no header: the file may be cut off"))?;
    let mut tracks = boxes(&movie).filter(|(name, _)| name == b"trak").map(|(_, track)| track);
    let video = tracks.find(|track| child(track, b"mdia").and_then(kind) == Some(*b"vide"));
    let video = video.ok_or_else(|| blame("it has no video"))?;
    let edits = edits(video).ok_or_else(|| blame("its edit list is damaged"))?;
    if edits.len() > 1 {
        let error = blame("it is composed of several parts");
        return Err(error.hint("encode it again, in one part: ffmpeg -i IN -fps_mode passthrough OUT.mp4"));
    }
    let header = header(&movie, video, edits.first().copied()).ok_or_else(|| blame("its header is damaged"))?;
    if header.frames == 0 || header.size.0 == 0 || header.size.1 == 0 {
        return Err(blame("its video is empty, or in fragments").hint("convert it: ffmpeg -i IN -c copy OUT.mp4"));
    }
    if child(video, b"tkhd").and_then(matrix).is_none_or(|matrix| matrix != UPRIGHT) {
        let hint =
            "it is unknown whether the poses are those of the rotated images: extract frames that match the poses";
        return Err(bad("the video has a rotation flag").hint(hint).at(path));
    }
    Ok(header)
}

/// The content of the box `moov`, wherever it is.
fn movie(path: &Path) -> std::io::Result<Option<Vec<u8>>> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut at = 0;
    while at + BOX_START as u64 <= length {
        let mut start = [0; 16];
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(&mut start[..BOX_START])?;
        let short = u64::from(number(&start, 0).unwrap_or(0));
        let (size, skipped) = match short {
            0 => (length - at, 8),
            1 => {
                file.read_exact(&mut start[8..])?;
                let [high, low] = [8, 12].map(|at| u64::from(number(&start, at).unwrap_or(0)));
                (high << 32 | low, 16)
            }
            size => (size, 8),
        };
        let Some(content) = size.checked_sub(skipped).filter(|_| size <= length - at) else { return Ok(None) };
        if start[4..8] == *b"moov" {
            let mut movie = Vec::new();
            file.take(content.min(MAX_HEADER)).read_to_end(&mut movie)?;
            return Ok(Some(movie));
        }
        at += size;
    }
    Ok(None)
}

/// What a track contains, e.g. `vide`.
fn kind(media: &[u8]) -> Option<[u8; 4]> {
    child(media, b"hdlr")?.get(8..12)?.try_into().ok()
}

/// The upper left part of a track's display matrix.
fn matrix(header: &[u8]) -> Option<[u32; 4]> {
    let at = if header.first()? == &1 { 52 } else { 40 };
    let [a, b, c, d] = [0, 4, 12, 16].map(|offset| number(header, at + offset));
    Some([a?, b?, c?, d?])
}

/// The header of a track, of which `edit` is the part that is shown.
fn header(movie: &[u8], track: &[u8], edit: Option<Edit>) -> Option<Header> {
    let media = child(track, b"mdia")?;
    let table = child(child(media, b"minf")?, b"stbl")?;
    let entry = child(table, b"stsd")?.get(16..)?; // version, count, and the start of the first entry
    let sizes = number(entry, 24)?;
    let stored = frame_count(child(table, b"stsz")?)?;
    let [ticks_per_second, ticks] = duration(child(media, b"mdhd")?)?;
    let frames = match edit {
        Some(edit) => {
            let [movie_ticks_per_second, _] = duration(child(movie, b"mvhd")?)?;
            shown(table, stored, edit, ticks_per_second / movie_ticks_per_second)?
        }
        None => stored,
    };
    Some(Header { size: (sizes >> 16, sizes & 0xFFFF), frames, fps: f64::from(stored) * ticks_per_second / ticks })
}

/// The number of stored frames; each has its size in bytes in the table, unless all have one size.
fn frame_count(sizes: &[u8]) -> Option<u32> {
    let (common, count) = (number(sizes, 4)?, number(sizes, 8)?);
    let is_listed = common != 0 || (sizes.len() - 12) / 4 >= count as usize;
    (is_listed && count <= MAX_FRAMES).then_some(count)
}

/// Ticks per second, and ticks.
fn duration(media: &[u8]) -> Option<[f64; 2]> {
    if media.first()? == &1 {
        let [high, low] = [24, 28].map(|at| number(media, at));
        return Some([f64::from(number(media, 20)?), f64::from(high?) * 4_294_967_296.0 + f64::from(low?)]);
    }
    Some([f64::from(number(media, 12)?), f64::from(number(media, 16)?)])
}
