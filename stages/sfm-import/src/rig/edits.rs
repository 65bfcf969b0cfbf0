//! The part of a video that its edit list shows. A cut without re-encoding stores all frames from the key frame before its
//! start on, and hides those outside the cut (ISO/IEC 14496-12, 8.6.6); decoders do not return hidden frames.

use super::boxes::{child, number};

/// A part of the stored video.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edit {
    /// Time of presentation of its first frame, in ticks of the video.
    start: i64,
    /// Its duration in ticks of the movie; 0 if it is that of the video.
    duration: u64,
}

/// The parts that a track shows, in order; none if it shows everything. `None` if the list is damaged. Parts without
/// content, which delay the start, are left out.
pub(super) fn edits(track: &[u8]) -> Option<Vec<Edit>> {
    let Some(list) = child(track, b"edts").and_then(|edits| child(edits, b"elst")) else { return Some(Vec::new()) };
    let count = number(list, 4)? as usize;
    let is_wide = *list.first()? == 1;
    let entries: Vec<&[u8]> = list.get(8..)?.chunks_exact(if is_wide { 20 } else { 12 }).take(count).collect();
    let parsed = entries.iter().map(|entry| if is_wide { wide(entry) } else { narrow(entry) });
    let parsed: Vec<Edit> = parsed.collect::<Option<_>>()?;
    (entries.len() == count).then(|| parsed.into_iter().filter(|edit| edit.start >= 0).collect())
}

fn narrow(entry: &[u8]) -> Option<Edit> {
    Some(Edit { duration: number(entry, 0)?.into(), start: number(entry, 4)?.cast_signed().into() })
}

fn wide(entry: &[u8]) -> Option<Edit> {
    let long = |at| Some(u64::from(number(entry, at)?) << 32 | u64::from(number(entry, at + 4)?));
    Some(Edit { duration: long(0)?, start: long(8)?.cast_signed() })
}

/// The number of the first `frames` frames of a table of samples that `edit` shows, where a tick of the movie has
/// `ticks_per_movie_tick` ticks of the video. `None` if the table is damaged.
pub(super) fn shown(table: &[u8], frames: u32, edit: Edit, ticks_per_movie_tick: f64) -> Option<u32> {
    let duration = (edit.duration as f64 * ticks_per_movie_tick).round();
    let end = if edit.duration == 0 { f64::INFINITY } else { edit.start as f64 + duration };
    let durations = runs(child(table, b"stts")?);
    // Frames that are stored in another order than they are shown have offsets.
    let offsets = child(table, b"ctts").into_iter().flat_map(runs).chain(std::iter::repeat(0));
    let (mut decoded, mut known, mut shown) = (0_i64, 0, 0);
    for (duration, offset) in durations.zip(offsets).take(frames as usize) {
        let time = decoded + i64::from(offset.cast_signed());
        shown += u32::from(time >= edit.start && (time as f64) < end);
        (decoded, known) = (decoded + i64::from(duration), known + 1);
    }
    (known == frames).then_some(shown)
}

/// The values of a table of runs: the number of equal values, and the value.
fn runs(table: &[u8]) -> impl Iterator<Item = u32> {
    let entries = table.get(8..).unwrap_or_default().chunks_exact(8);
    let entries = entries.filter_map(|entry| Some((number(entry, 0)? as usize, number(entry, 4)?)));
    entries.flat_map(|(count, value)| std::iter::repeat_n(value, count))
}
