//! Where a COLMAP workspace keeps its model, images and masks.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use walkdir::WalkDir;

/// The folder of the sparse model: the first of `sparse/0`, `sparse/1`, …, else `sparse`, else `dir`.
///
/// Below `sparse` one file of a model is enough, so that the missing ones are named by whoever reads it.
pub fn sparse_dir(dir: &Path) -> Option<PathBuf> {
    let below = numbered_models(dir).into_iter().chain([dir.join("sparse")]);
    let here = (has(dir, "cameras") && has(dir, "images")).then(|| dir.to_owned());
    below.into_iter().find(|candidate| is_model(candidate)).or(here)
}

/// `sparse/N`, by number. More than one means that structure from motion broke the scene into parts.
pub fn numbered_models(dir: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir.join("sparse")).into_iter().flatten().flatten().map(|entry| entry.path());
    let number = |path: &Path| path.file_name()?.to_str()?.parse::<u32>().ok();
    let mut models: Vec<_> = entries.filter(|path| is_model(path)).filter_map(|p| Some((number(&p)?, p))).collect();
    models.sort();
    models.into_iter().map(|(_, path)| path).collect()
}

fn is_model(dir: &Path) -> bool {
    has(dir, "cameras") || has(dir, "images")
}

/// Whether one of a model's files is there, binary or text.
fn has(dir: &Path, name: &str) -> bool {
    ["bin", "txt"].iter().any(|extension| dir.join(format!("{name}.{extension}")).is_file())
}

/// The folder that image names are relative to: `images` where it exists, else `dir`.
pub fn images_dir(dir: &Path) -> PathBuf {
    let images = dir.join("images");
    if images.is_dir() { images } else { dir.to_owned() }
}

/// Names of all images, with `/` between folders, in natural order. Masks are not images.
pub fn image_names(images_dir: &Path) -> Vec<String> {
    let is_mask_dir = |entry: &walkdir::DirEntry| entry.depth() == 1 && entry.file_name() == "masks";
    let walk = WalkDir::new(images_dir).into_iter().filter_entry(|entry| !is_mask_dir(entry)).flatten();
    let is_image = |path: &Path| {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        matches!(extension.as_deref(), Some("png" | "jpg" | "jpeg"))
    };
    let files = walk.filter(|entry| entry.file_type().is_file() && is_image(entry.path()));
    let mut names: Vec<String> = files.filter_map(|entry| relative_name(images_dir, entry.path())).collect();
    names.sort_by(|a, b| natural_order(a, b));
    names
}

fn relative_name(dir: &Path, path: &Path) -> Option<String> {
    let parts = path.strip_prefix(dir).ok()?.components().map(|part| part.as_os_str().to_string_lossy().into_owned());
    Some(parts.collect::<Vec<_>>().join("/"))
}

/// The mask of an image: `masks/` beside the images, the same name with `.png` in place of or after its extension.
pub fn mask_path(dir: &Path, name: &str) -> Option<PathBuf> {
    let stem = Path::new(name).with_extension("png");
    let candidates = [dir.join("masks").join(stem), dir.join("masks").join(format!("{name}.png"))];
    candidates.into_iter().find(|path| path.is_file())
}

/// Runs of digits compare by value, so that `frame_9` comes before `frame_10`; equal values by spelling.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (chunks(a), chunks(b));
    loop {
        let order = match (left.next(), right.next()) {
            (None, None) => return a.cmp(b),
            (None, _) => Ordering::Less,
            (_, None) => Ordering::Greater,
            (Some(x), Some(y)) if is_number(x) && is_number(y) => {
                let (x, y) = (x.trim_start_matches('0'), y.trim_start_matches('0'));
                x.len().cmp(&y.len()).then_with(|| x.cmp(y))
            }
            (Some(x), Some(y)) => x.cmp(y),
        };
        if order.is_ne() {
            return order;
        }
    }
}

fn is_number(chunk: &str) -> bool {
    chunk.starts_with(|symbol: char| symbol.is_ascii_digit())
}

/// Maximal runs of digits and of anything else.
fn chunks(text: &str) -> impl Iterator<Item = &str> {
    let mut rest = text;
    std::iter::from_fn(move || {
        let first = rest.chars().next()?;
        let other = |symbol: char| symbol.is_ascii_digit() != first.is_ascii_digit();
        let (chunk, tail) = rest.split_at(rest.find(other).unwrap_or(rest.len()));
        rest = tail;
        Some(chunk)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_sort_by_value() {
        let mut names = ["f10.png", "f9.png", "f09.png", "a/2.png", "a/10.png", "f0.png"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["a/2.png", "a/10.png", "f0.png", "f09.png", "f9.png", "f10.png"]);
    }
}
