//! Models of fixed cameras that were made from one image per camera: the other frames of each camera are in a folder.

use std::collections::BTreeSet;
use std::path::Path;

use crate::colmap::model::{Model, RegisteredImage};
use crate::image_names::{image_names, images_dir};

/// Registers all frames of every camera with the pose of its image, if no image of the model exists, but each stands for a folder
/// of frames: `cam01.jpg` for `cam01/`, or `image1.jpg` for `cam01/`, as scripts of 4DGaussians (Wu et al. 2024) name them. The
/// first frame is taken as the image that the keypoints belong to. Returns a warning.
pub(super) fn register_frames(dir: &Path, model: &mut Model) -> Option<String> {
    let root = images_dir(dir);
    if model.images.values().any(|image| root.join(&image.name).is_file()) {
        return None;
    }
    let camera = |(id, image): (&u32, &RegisteredImage)| Some((*id, folder_of_frames(&root, &image.name)?));
    let cameras = model.images.iter().map(camera).collect::<Option<Vec<_>>>()?;
    let (_, first) = cameras.first()?;
    let warning =
        format!("the images of the model are read as fixed cameras, whose frames are in folders, e.g. {first}/");
    if cameras.iter().map(|(_, folder)| folder).collect::<BTreeSet<_>>().len() < cameras.len() {
        return None;
    }
    let mut next_id = model.images.keys().max()? + 1;
    for (id, folder) in cameras {
        let mut names = frames(&root, &folder).into_iter();
        let image = model.images.get_mut(&id)?;
        image.name = names.next()?;
        let other = RegisteredImage { observations: Vec::new(), ..image.clone() };
        for name in names {
            model.images.insert(next_id, RegisteredImage { name, ..other.clone() });
            next_id += 1;
        }
    }
    Some(warning)
}

/// The folder of the frames of the camera that an image of the model stands for.
fn folder_of_frames(root: &Path, name: &str) -> Option<String> {
    let stem = Path::new(name).with_extension("").to_string_lossy().into_owned();
    let numbered = stem.strip_prefix("image").map(|number| format!("cam{number:0>2}"));
    [Some(stem), numbered].into_iter().flatten().find(|folder| !frames(root, folder).is_empty())
}

/// The images directly in a folder below `root`, relative to `root`.
fn frames(root: &Path, folder: &str) -> Vec<String> {
    let names = image_names(&root.join(folder)).into_iter().filter(|name| !name.contains('/'));
    names.map(|name| format!("{folder}/{name}")).collect()
}
