//! Files next to the images that are not photos: masks, depth and other maps.

/// Folders of masks.
pub(crate) const MASKS: [&str; 2] = ["masks", "mask"];
/// Folders of depth maps.
pub(crate) const DEPTHS: [&str; 2] = ["depth", "depths"];

/// Words, without a final s, in the names of folders of masks, maps and features.
const WORDS: [&str; 21] = [
    "mask",
    "matte",
    "alpha",
    "bgmtv",
    "rvm",
    "seg",
    "segmentation",
    "semantic",
    "instance",
    "label",
    "annotation",
    "depth",
    "depthmap",
    "disparity",
    "flow",
    "normal",
    "map",
    "track",
    "feature",
    "conf",
    "confidence",
];

/// Whether a folder's name says that its files are not photos, e.g. `masks`, `flow_fwd` or `depth-maps`.
pub(crate) fn is_companion_folder(name: &str) -> bool {
    let lower = name.to_lowercase();
    let mut words = lower.split(|symbol: char| !symbol.is_alphabetic());
    words.any(|word| WORDS.contains(&word.strip_suffix('s').unwrap_or(word)))
}

/// A warning about `found` masks of which only `used` have the size of their image, or about images without a mask.
pub(crate) fn mask_warning(found: usize, used: usize, images: usize) -> Option<String> {
    match found - used {
        0 if used == 0 || used == images => None,
        0 => Some(format!(
            "only {used} of {images} images have a mask; if the names are numbers, check that masks and images start with the \
             same number"
        )),
        misfits => Some(format!("{misfits} masks are skipped: their size differs from that of their image")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_folders_distinguish_maps_from_photos() {
        let maps = ["masks", "Masks_SAM2", "bgmtv2", "depth", "depth-maps", "flow_fwd", "normals", "labels", "maps"];
        assert!(maps.into_iter().all(is_companion_folder));
        let photos = ["input", "rgb", "frames", "images_2", "photos", "flowers", "cam01", "undistorted", "color"];
        assert!(!photos.into_iter().any(is_companion_folder));
        assert!(MASKS.into_iter().chain(DEPTHS).all(is_companion_folder));
    }
}
