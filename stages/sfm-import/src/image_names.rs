//! The images of a folder and the natural order of their names.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use walkdir::WalkDir;

/// Extensions of image files, in lower case.
pub(crate) const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "webp", "tif", "tiff"];

/// The folder that image names are relative to: `images` if it exists, otherwise `dir`.
pub(crate) fn images_dir(dir: &Path) -> PathBuf {
    let images = dir.join("images");
    if images.is_dir() { images } else { dir.to_owned() }
}

/// The names of all images in natural order, with `/` between folders. The folder `masks` and hidden files are skipped:
/// archives of macOS have a file `._a.jpg` next to each `a.jpg`. Links to files and folders are followed.
pub(crate) fn image_names(images_dir: &Path) -> Vec<String> {
    let is_skipped = |entry: &walkdir::DirEntry| {
        let name = entry.file_name().to_string_lossy();
        entry.depth() == 1 && name == "masks" || entry.depth() > 0 && name.starts_with('.')
    };
    let walk =
        WalkDir::new(images_dir).follow_links(true).into_iter().filter_entry(|entry| !is_skipped(entry)).flatten();
    let is_image = |path: &Path| {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str()))
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

/// The image name without its extension, safe as a file name.
pub(crate) fn view_name(name: &str) -> String {
    let stem = Path::new(name).with_extension("");
    let safe = |symbol: char| if symbol.is_ascii_alphanumeric() || "-.".contains(symbol) { symbol } else { '_' };
    let name: String = stem.to_string_lossy().chars().map(safe).collect();
    if name.starts_with('.') { format!("_{name}") } else { name }
}

/// Compares runs of digits by value, so that `frame_9` comes before `frame_10`, and equal values by spelling.
pub(crate) fn natural_order(a: &str, b: &str) -> Ordering {
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

/// Splits a text into maximal runs of digits and of other symbols.
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

    #[cfg(unix)]
    #[test]
    fn links_to_images_and_folders_are_followed() {
        let (store, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        std::fs::create_dir(store.path().join("cam0")).unwrap();
        std::fs::write(store.path().join("cam0/1.png"), "").unwrap();
        std::os::unix::fs::symlink(store.path().join("cam0"), dir.path().join("cam0")).unwrap();
        std::os::unix::fs::symlink(store.path().join("cam0/1.png"), dir.path().join("2.png")).unwrap();
        std::os::unix::fs::symlink(dir.path(), dir.path().join("loop")).unwrap();
        assert_eq!(image_names(dir.path()), ["2.png", "cam0/1.png"]);
    }

    #[test]
    fn hidden_files_are_not_images() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["1.png", "._1.png", ".cache/1.png"] {
            std::fs::create_dir_all(dir.path().join(name).parent().unwrap()).unwrap();
            std::fs::write(dir.path().join(name), "").unwrap();
        }
        assert_eq!(image_names(dir.path()), ["1.png"]);
    }

    #[test]
    fn names_sort_by_the_value_of_their_numbers() {
        let mut names = ["f10.png", "f9.png", "f09.png", "a/2.png", "a/10.png", "f0.png"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["a/2.png", "a/10.png", "f0.png", "f09.png", "f9.png", "f10.png"]);
    }
}
