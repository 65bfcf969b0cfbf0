//! The images of a folder and the natural order of their names.

use std::cmp::Ordering;
use std::collections::BTreeSet;
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
    sort_by_name(&mut names, String::as_str);
    names
}

/// Sorts by name: in natural order, or by value if the names are decimal numbers.
pub(crate) fn sort_by_name<T>(items: &mut [T], name: impl Fn(&T) -> &str) {
    if are_decimals(items.iter().map(&name)) {
        let value = |item: &T| decimal(name(item)).map_or(f64::NAN, |(value, _)| value);
        items.sort_by(|a, b| natural_order(folder(name(a)), folder(name(b))).then(value(a).total_cmp(&value(b))));
    } else {
        items.sort_by(|a, b| natural_order(name(a), name(b)));
    }
}

fn folder(name: &str) -> &str {
    name.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// Whether the names of all files are decimal numbers, such as seconds, with a varying number of decimals. Programs print them
/// without closing zeros; names like `1.10` are a camera and a frame.
pub(crate) fn are_decimals<'a>(names: impl Iterator<Item = &'a str>) -> bool {
    let places = |name| decimal(name).map(|(_, decimals)| decimals).filter(|it| it.len() < 2 || !it.ends_with('0'));
    let counts: Option<BTreeSet<usize>> = names.map(|name| Some(places(name)?.len())).collect();
    counts.is_some_and(|counts| counts.len() > 1)
}

/// The value and the decimals of a file name that is a decimal number, with or without the extension of an image.
pub(crate) fn decimal(name: &str) -> Option<(f64, &str)> {
    let file = name.rsplit_once('/').map_or(name, |(_, file)| file);
    let is_extension = |text: &str| EXTENSIONS.contains(&text.to_lowercase().as_str());
    let stem = file.rsplit_once('.').filter(|(_, extension)| is_extension(extension)).map_or(file, |(stem, _)| stem);
    let (whole, decimals) = stem.split_once('.').unwrap_or((stem, ""));
    let is_number =
        !whole.is_empty() && [whole, decimals].iter().all(|it| it.bytes().all(|byte| byte.is_ascii_digit()));
    is_number.then(|| Some((stem.parse().ok()?, decimals)))?
}

/// The image in `folder` with this name and any extension, in lower or upper case.
pub(crate) fn image_named(folder: &Path, name: &str) -> Option<PathBuf> {
    let extensions = EXTENSIONS.map(str::to_owned).into_iter().chain(EXTENSIONS.map(str::to_uppercase));
    extensions.map(|extension| folder.join(format!("{name}.{extension}"))).find(|path| path.is_file())
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

/// The name without its extension.
pub(crate) fn without_extension(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// The number in each name, if the names differ in one number only, or are decimal numbers.
pub(crate) fn varying_number(names: &[&str]) -> Option<Vec<f64>> {
    if are_decimals(names.iter().copied()) {
        return names.iter().map(|name| Some(decimal(name)?.0)).collect();
    }
    let split: Vec<Vec<&str>> = names.iter().map(|name| chunks(without_extension(name)).collect()).collect();
    let first = split.first().filter(|first| split.iter().all(|parts| parts.len() == first.len()))?;
    let mut varying = (0..first.len()).filter(|at| split.iter().any(|parts| parts[*at] != first[*at]));
    let (at, None) = (varying.next()?, varying.next()) else { return None };
    split.iter().map(|parts| parts[at].parse().ok().filter(|_| is_number(parts[at]))).collect()
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

/// Whether a part of [`chunks`] is a run of digits.
pub(crate) fn is_number(chunk: &str) -> bool {
    chunk.starts_with(|symbol: char| symbol.is_ascii_digit())
}

/// Splits a text into maximal runs of digits and of other symbols.
pub(crate) fn chunks(text: &str) -> impl Iterator<Item = &str> {
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
    fn seconds_sort_by_their_value() {
        let sorted = |mut names: Vec<&'static str>| {
            sort_by_name(&mut names, |name| name);
            names
        };
        let seconds = vec!["9.5.png", "10.0.png", "10.25.png", "10.5.png", "11.png"];
        assert_eq!(sorted(seconds.iter().rev().copied().collect()), seconds);
        assert_eq!(sorted(vec!["10.5", "10.25", "9.75"]), ["9.75", "10.25", "10.5"]);
        assert_eq!(sorted(vec!["b/1.25.png", "a/1.5.png", "a/1.25.png"]), ["a/1.25.png", "a/1.5.png", "b/1.25.png"]);
        // These are cameras and frames.
        assert_eq!(sorted(vec!["1.10.png", "1.9.png", "2.9.png"]), ["1.9.png", "1.10.png", "2.9.png"]);
        assert!(!are_decimals(["1.05.png", "1.50.png"].into_iter()), "natural order is that of the values");
        assert!(!are_decimals(["1.5.png", "f1.25.png"].into_iter()));
    }

    #[test]
    fn names_sort_by_the_value_of_their_numbers() {
        let mut names = ["f10.png", "f9.png", "f09.png", "a/2.png", "a/10.png", "f0.png"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["a/2.png", "a/10.png", "f0.png", "f09.png", "f9.png", "f10.png"]);
    }
}
