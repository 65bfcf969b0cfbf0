//! Masks and depth maps of images: stated by the file, or found next to the images.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::listed::{ListedFrame, find, relative};
use crate::companion_files::{self, mask_warning};
use crate::depth;
use crate::files::image_size;
use crate::mask_polarity::SetPixels;

/// The file that belongs to an image, if there is one.
pub(super) type Companions = Option<PathBuf>;

/// Folders of masks next to images, and the extensions in them.
const MASKS: (&[&str], &[&str]) = (&companion_files::MASKS, &["png"]);
/// What precedes an image's stem in the names of instant-ngp's masks of what moves, which lie in the folder of the images.
const DYNAMIC: &str = "dynamic_mask_";
/// Folders of depth maps next to images, and the extensions in them.
const DEPTHS: (&[&str], &[&str]) = (&companion_files::DEPTHS, &["exr", "npy", "png"]);

/// The mask of every frame: `mask_path`, or a file next to the images.
pub(super) fn masks(
    dir: &Path,
    listed: &[ListedFrame<'_>],
    size: (u32, u32),
    warnings: &mut Vec<String>,
) -> Vec<Companions> {
    let mut found = found(dir, listed, "mask_path", |frame| frame.stated.mask_path(), MASKS, warnings);
    let misfits = drop_if(&mut found, |path| !image_size(path).is_ok_and(|found| found == size));
    let used = found.iter().flatten().count();
    warnings.extend(mask_warning(used + misfits, used, found.len()));
    found
}

/// What the set pixels of masks show, by the keys that name them.
pub(crate) fn set_pixels(listed: &[ListedFrame<'_>]) -> SetPixels {
    match () {
        () if listed.iter().any(|frame| frame.stated.subject_mask_path().is_some()) => SetPixels::Moving,
        () if listed.iter().any(|frame| frame.stated.mask_path().is_some()) => SetPixels::Trained,
        () => SetPixels::Unstated,
    }
}

/// The depth map of every frame: `depth_file_path`, or a file next to the images.
pub(super) fn depths(dir: &Path, listed: &[ListedFrame<'_>], warnings: &mut Vec<String>) -> Vec<Companions> {
    let mut found = found(dir, listed, "depth_file_path", |frame| frame.stated.depth_path(), DEPTHS, warnings);
    let previews = drop_if(&mut found, depth::is_preview);
    warnings.extend(count_warning(previews, "depth files are skipped: 8-bit previews have no scale"));
    found
}

/// The companion of every frame. A file that would belong to several images is dropped.
fn found(
    dir: &Path,
    listed: &[ListedFrame<'_>],
    key: &str,
    stated: impl for<'f> Fn(&'f ListedFrame<'_>) -> Option<&'f str>,
    (folders, extensions): (&[&str], &[&str]),
    warnings: &mut Vec<String>,
) -> Vec<Companions> {
    let mut missing = 0;
    let mut companion = |frame: &ListedFrame<'_>| match stated(frame).filter(|path| !path.is_empty()) {
        None => beside(dir, &frame.image, folders, extensions),
        Some(path) => {
            let path = find(dir, &relative(path));
            missing += usize::from(path.is_none());
            path
        }
    };
    let mut found: Vec<Companions> = listed.iter().map(&mut companion).collect();
    warnings.extend(count_warning(missing, &format!("files that {key} names are missing")));
    let mut uses: BTreeMap<PathBuf, usize> = BTreeMap::new();
    found.iter().flatten().for_each(|path| *uses.entry(path.clone()).or_default() += 1);
    let shared = drop_if(&mut found, |path| uses.get(path).is_some_and(|uses| *uses > 1));
    warnings.extend(count_warning(shared, "images would share a mask or depth file with another image, and get none"));
    found
}

fn count_warning(count: usize, text: &str) -> Option<String> {
    (count > 0).then(|| format!("{count} {text}"))
}

/// Removes the files for which `is_bad` holds and returns their number.
fn drop_if(found: &mut [Companions], is_bad: impl Fn(&Path) -> bool) -> usize {
    let dropped = found.iter_mut().filter_map(|path| path.take_if(|path| is_bad(path)));
    dropped.count()
}

/// The file with an image's stem or name, or with its stem and e.g. `_mask`, in one of the folders: below `dir` under
/// the image's own sub-folder or in place of its first one, or next to the image, or next to the image's folder; or a mask of instant-ngp.
fn beside(dir: &Path, image: &Path, folders: &[&str], extensions: &[&str]) -> Companions {
    let parent = image.strip_prefix(dir).ok()?.parent()?;
    let without_first: PathBuf = parent.components().skip(1).collect();
    let above = parent.parent().unwrap_or(parent);
    let places = folders.iter().flat_map(|folder| {
        [
            dir.join(folder).join(parent),
            dir.join(folder).join(&without_first),
            dir.join(parent).join(folder),
            dir.join(above).join(folder),
        ]
    });
    let (stem, name) = (image.file_stem()?.to_string_lossy(), image.file_name()?.to_string_lossy());
    let suffix = folders[0].trim_end_matches('s');
    let bases = [stem.to_string(), name.to_string(), format!("{stem}_{suffix}")];
    let extensions = extensions.iter().flat_map(|extension| [extension.to_string(), extension.to_uppercase()]);
    let names: Vec<String> =
        extensions.flat_map(|extension| bases.each_ref().map(|base| format!("{base}.{extension}"))).collect();
    let mut candidates = places.flat_map(|place| names.iter().map(move |name| place.join(name)));
    let dynamic = (folders == companion_files::MASKS).then(|| image.with_file_name(format!("{DYNAMIC}{stem}.png")));
    candidates.find(|path| path.is_file() && path != image).or(dynamic.filter(|path| path.is_file()))
}
