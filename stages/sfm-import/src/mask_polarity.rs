//! What the set pixels of masks show: what moves, or what is static.

use std::path::Path;

use scene::mask_file::MOSTLY_SET;

use crate::files::name;
use crate::pixels::set_share;

/// Number of masks that are decoded to decide what they mark.
const SAMPLED_MASKS: usize = 8;

/// What the set pixels of a capture's masks show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum SetPixels {
    /// The files do not state it.
    #[default]
    Unstated,
    /// What moves, or another subject.
    Moving,
    /// What is static, as structure from motion expects.
    Static,
    /// What nerfstudio trains on: a subject, or all that is static.
    Trained,
}

/// Decides what the set pixels of masks, each with its image, show where the files do not state it, and returns a warning where this may be wrong. Most pixels of a
/// scene are static. Masks with most pixels set therefore mark what is static if they are used like that: nerfstudio trains on set
/// pixels, and COLMAP finds features there, in masks with the names of images, e.g. `a.jpg.png`.
pub(crate) fn decided(stated: SetPixels, masks: &[(&Path, &Path)]) -> (SetPixels, Option<String>) {
    let (Some((first, _)), SetPixels::Unstated | SetPixels::Trained) = (masks.first(), stated) else {
        return (stated, None);
    };
    let named: Vec<&Path> = masks.iter().filter(|(mask, image)| names_image(mask, image)).map(|pair| pair.0).collect();
    let named_like =
        format!("masks are named like those that COLMAP reads, e.g. {}", name(named.first().unwrap_or(first)));
    let sampled = masks.iter().map(|pair| pair.0).step_by(masks.len().div_ceil(SAMPLED_MASKS));
    let are_static = "set pixels count as static, so that the labels are the inverse of the masks; if set pixels move,";
    let (is_trained, are_named) = (stated == SetPixels::Trained, named.len() == masks.len());
    match set_share(sampled) > MOSTLY_SET {
        true if is_trained => {
            let note = "most pixels of the masks of mask_path are set, and nerfstudio trains on these";
            (SetPixels::Static, Some(format!("{note}: {are_static} name the key fg_mask_path")))
        }
        true if are_named => {
            let rename = "remove the extension of the images from the names of the masks";
            let note = format!("{named_like}, and most of their pixels are set: {are_static} {rename}");
            (SetPixels::Static, Some(note))
        }
        true => {
            let note = format!("most pixels of the masks are set, e.g. of {}, and count as moving", name(first));
            (SetPixels::Moving, Some(format!("{note}: if set pixels are static, invert the masks")))
        }
        false if is_trained => {
            let note = "masks of mask_path become instance labels (0 is background), not pixels that training skips";
            (SetPixels::Moving, Some(note.into()))
        }
        false if !named.is_empty() => {
            let note = "but set pixels count as moving: if they are static and to be kept, invert the masks";
            (SetPixels::Moving, Some(format!("{named_like}, {note}")))
        }
        false => (SetPixels::Moving, None),
    }
}

/// Whether the name of a mask contains that of its image with an extension, which may differ in a folder of smaller copies.
fn names_image(mask: &Path, image: &Path) -> bool {
    let name = mask.file_stem().map(Path::new);
    name.is_some_and(|name| name.extension().is_some() && name.file_stem() == image.file_stem())
}
