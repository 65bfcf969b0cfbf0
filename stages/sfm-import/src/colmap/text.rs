//! Readers of the text files: one record per line (two lines per image), with `#` comments.

use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

use engine::Failure;
use glam::{DVec2, DVec3};

use crate::colmap::camera_model::lens;
use crate::colmap::model::{Point, RegisteredImage};
use crate::error::{Result, bad};
use crate::files::read_text;
use crate::lens::Lens;

/// Reads `cameras.txt`: id, model, width, height, parameters.
pub(crate) fn cameras(path: &Path) -> Result<BTreeMap<u32, Lens>> {
    records(path, |words, _| {
        let (id, model, width, height) = (words.next()?, words.word()?, words.next()?, words.next()?);
        let params = words.rest::<f64>()?;
        Ok((id, lens(model, width, height, &params)?))
    })
}

/// Reads `images.txt`: id, quaternion (w, x, y, z), translation, camera id, name; the next line holds the keypoints.
pub(super) fn images(path: &Path) -> Result<BTreeMap<u32, RegisteredImage>> {
    records(path, |words, lines| {
        let id = words.next()?;
        let quaternion = [words.next()?, words.next()?, words.next()?, words.next()?];
        let translation = [words.next()?, words.next()?, words.next()?];
        let camera_id = words.next()?;
        let name = words.remainder()?.to_owned();
        let Some((_, keypoints)) = lines.next() else {
            return Err(bad("the line of keypoints is missing").hint("an image without keypoints needs an empty line"));
        };
        // DUSt3R's exporter writes the word "placeholder".
        let is_placeholder = keypoints.trim().chars().all(char::is_alphabetic);
        let mut keypoints = Words { rest: if is_placeholder { "" } else { keypoints } };
        let mut observations = Vec::new();
        while !keypoints.rest.trim().is_empty() {
            let mut next = || keypoints.next().map_err(|failure: Failure| failure.hint(TWO_LINES));
            let pixel = DVec2::new(next()?, next()?);
            let point = keypoints.next::<i64>().map_err(|failure| failure.hint(TWO_LINES))?;
            observations.push((pixel, u64::try_from(point).ok()));
        }
        Ok((id, RegisteredImage { name, camera_id, quaternion, translation, observations }))
    })
}

/// The number of images in `images.txt`, without reading their numbers; 0 if the file cannot be read.
pub(super) fn image_count(path: &Path) -> usize {
    let text = read_text(path).unwrap_or_default();
    let mut lines = numbered_lines(&text);
    let is_image = |(_, line): (usize, &str)| !line.trim().is_empty();
    let mut count = 0;
    while lines.any(is_image) {
        count += 1;
        lines.next(); // keypoints
    }
    count
}

/// Hint for keypoints that cannot be read: hand-written files often lack their lines.
const TWO_LINES: &str =
    "each image has two lines: its pose, and its keypoints X Y POINT3D_ID, which may be an empty line";

/// Reads `points3D.txt`: id, position, colour, error, track.
pub(super) fn points(path: &Path) -> Result<BTreeMap<u64, Point>> {
    records(path, |words, _| {
        let id = words.next()?;
        let position = DVec3::new(words.next()?, words.next()?, words.next()?);
        let rgb = [words.next()?, words.next()?, words.next()?];
        let error_px = words.next()?;
        let mut track = Vec::new();
        while !words.rest.trim().is_empty() {
            track.push((words.next()?, words.next()?));
        }
        Ok((id, Point { position, rgb, error_px, track }))
    })
}

/// The numbered lines of a file.
type Lines<'a> = dyn Iterator<Item = (usize, &'a str)> + 'a;

/// The lines of a text that are no comments.
fn numbered_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().filter(|(_, line)| !line.starts_with('#'))
}

/// Reads keyed records; errors name the file and the line.
fn records<K: Ord + std::fmt::Display + Copy, V>(
    path: &Path,
    mut read: impl FnMut(&mut Words, &mut Lines) -> Result<(K, V)>,
) -> Result<BTreeMap<K, V>> {
    let text = read_text(path)?;
    let mut lines = numbered_lines(&text);
    let mut records = BTreeMap::new();
    while let Some((number, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let blame = |message: String| bad(format!("line {}: {message}", number + 1)).at(path);
        let (key, value) = read(&mut Words { rest: line }, &mut lines).map_err(|failure| {
            let hint = failure.hint.clone();
            let blamed = blame(failure.message);
            if let Some(hint) = hint { blamed.hint(hint) } else { blamed }
        })?;
        if records.insert(key, value).is_some() {
            return Err(blame(format!("id {key} occurs twice")));
        }
    }
    Ok(records)
}

struct Words<'a> {
    rest: &'a str,
}

impl<'a> Words<'a> {
    fn word(&mut self) -> Result<&'a str> {
        let trimmed = self.rest.trim_start();
        let end = trimmed.find(char::is_whitespace).unwrap_or(trimmed.len());
        let (word, rest) = trimmed.split_at(end);
        self.rest = rest;
        if word.is_empty() { Err(bad("the line ends too early")) } else { Ok(word) }
    }

    fn next<T: FromStr>(&mut self) -> Result<T> {
        let word = self.word()?;
        word.parse().map_err(|_| bad(format!("{word:?} is not a valid number here")))
    }

    fn rest<T: FromStr>(&mut self) -> Result<Vec<T>> {
        let mut values = Vec::new();
        while !self.rest.trim().is_empty() {
            values.push(self.next()?);
        }
        Ok(values)
    }

    /// The rest of the line; names may contain spaces.
    fn remainder(&mut self) -> Result<&'a str> {
        let name = std::mem::take(&mut self.rest).trim();
        if name.is_empty() { Err(bad("the line ends too early")) } else { Ok(name) }
    }
}
