//! The step `masks`: the folder of masks in the capture, and the masks that COLMAP reads.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use scene::mask_file::MOSTLY_SET;

use crate::error::{Result, bad, io};
use crate::frames::{IMAGES, image_names, image_size, in_work, link_all};
use crate::masks;
use crate::request::Request;
use crate::steps::{Step, Steps};

/// The folder of masks in the capture, set where something moves.
pub(crate) const MASKS: &str = "masks";
/// The folder of COLMAP's masks.
const FOR_COLMAP: &str = "colmap-masks";

/// The folder that COLMAP reads, relative to the capture, if there is one.
pub(crate) fn for_colmap(dir: &Path) -> Option<String> {
    let folder = in_work(FOR_COLMAP);
    dir.join(&folder).is_dir().then_some(folder)
}

/// Puts the masks into the capture, and inverts them for COLMAP. Without masks, features come from all pixels.
pub(crate) fn masks(steps: &mut Steps<'_>, request: &Request) -> Result<()> {
    let own = steps.dir.join(MASKS);
    let given = request.masks.as_ref().map(|path| path.canonicalize().map_err(|error| io(&error, path))).transpose()?;
    let input = given.clone().unwrap_or(own.clone());
    let inputs = vec![("masks", input.clone()), ("images", IMAGES.into())];
    let images = image_names(&steps.dir.join(IMAGES));
    let names = mask_names(&input);
    let target = in_work(FOR_COLMAP);
    if names.is_empty() {
        return match given {
            Some(path) => {
                Err(bad("no masks in this folder").hint("masks are PNG files with the names of the images").at(path))
            }
            None if own.is_dir() => {
                steps.note("masks/ has no PNG files: poses are estimated from all pixels");
                crate::steps::remove(&steps.dir.join(&target))
            }
            None => crate::steps::remove(&steps.dir.join(&target)),
        };
    }
    let mut outputs = vec![target.as_str()];
    let is_elsewhere = input != own;
    if is_elsewhere {
        outputs.push(MASKS);
    }
    let command = "invert MASKS for images".to_owned();
    let step = Step { name: "masks", commands: vec![command], tool: Ok("pipeline".into()), inputs, outputs };
    steps.run(step, |steps| {
        let pairs = paired(&input, &names, &images)?;
        check_sizes(&steps.dir.join(IMAGES), &pairs)?;
        let scratch = steps.scratch(FOR_COLMAP)?;
        let share = invert_all(&input, &pairs, &scratch)?;
        if is_elsewhere {
            let copies = steps.scratch(MASKS)?;
            link_all(&input, &names, &copies)?;
            steps.publish(&copies, MASKS)?;
        }
        steps.publish(&scratch, &target)?;
        let of = if pairs.len() == images.len() { String::new() } else { format!(" of {} images", images.len()) };
        Ok((Vec::new(), format!("{} masks{of}, {:.1} % of the pixels move", pairs.len(), 100.0 * share)))
    })
}

/// The PNG files of a folder and of its sub-folders (of cameras, or of objects), relative to it.
fn mask_names(dir: &Path) -> Vec<String> {
    let is_png = |name: &String| name.to_lowercase().ends_with(".png");
    image_names(dir).into_iter().filter(is_png).collect()
}

/// The name without its extension; masks may be called `a.jpg.png`.
fn stem(name: &str) -> String {
    Path::new(name).with_extension("").display().to_string()
}

/// Every image that has masks, with its masks: those with its name, also in folders of several objects. Numbers are
/// never guessed: a mask without an image is an error.
pub(crate) fn paired(dir: &Path, masks: &[String], images: &[String]) -> Result<Vec<(String, Vec<PathBuf>)>> {
    let mut used = BTreeSet::new();
    let mut pairs = Vec::new();
    for image in images {
        let fits = |mask: &&String| {
            let mask_stem = stem(mask);
            let last = mask_stem.rsplit('/').next().unwrap_or_default().to_owned();
            [&mask_stem, &last].into_iter().any(|stem_of| *stem_of == stem(image) || stem_of == image)
        };
        let found: Vec<&String> = masks.iter().filter(fits).collect();
        used.extend(found.iter().copied().cloned());
        if !found.is_empty() {
            pairs.push((image.clone(), found.iter().map(|mask| dir.join(mask)).collect()));
        }
    }
    match masks.iter().find(|mask| !used.contains(*mask)) {
        None => Ok(pairs),
        Some(stranger) => {
            let (first, last) = (&images[0], &images[images.len() - 1]);
            let message =
                format!("{} of {} masks belong to no image, e.g. {stranger}", masks.len() - used.len(), masks.len());
            let hint = format!(
                "masks have the names of the images, here {first} to {last}: rename them. Numbers are never shifted, because \
                 a shift by one frame is easily missed"
            );
            Err(bad(message).hint(hint).at(dir))
        }
    }
}

/// Refuses masks of other sizes than their images, because the import skips them.
pub(crate) fn check_sizes(images: &Path, pairs: &[(String, Vec<PathBuf>)]) -> Result<()> {
    for (image, files) in pairs {
        let (width, height) = image_size(&images.join(image))?;
        for file in files {
            let (mask_width, mask_height) = image_size(file)?;
            if (mask_width, mask_height) != (width, height) {
                let message =
                    format!("the mask is {mask_width}×{mask_height}, but its image {image} is {width}×{height}");
                let hint =
                    format!("draw the masks on the images in {}, or resize them by nearest pixel", images.display());
                return Err(bad(message).hint(hint).at(file));
            }
        }
    }
    Ok(())
}

/// Writes the masks for COLMAP and returns the mean share of set pixels. The masks of an image have its size.
pub(crate) fn invert_all(input: &Path, pairs: &[(String, Vec<PathBuf>)], out: &Path) -> Result<f64> {
    let least = masks::least_level(pairs.iter().flat_map(|(_, files)| files).map(PathBuf::as_path))?;
    let mut sum = 0.0;
    for (image, files) in pairs {
        let mut mask = masks::read(&files[0], least)?;
        for file in &files[1..] {
            mask = mask.or(&masks::read(file, least)?);
        }
        sum += masks::share(&mask);
        let path = out.join(format!("{image}.png"));
        let parent = path.parent().unwrap_or(out);
        std::fs::create_dir_all(parent).map_err(|error| io(&error, parent))?;
        masks::write_for_colmap(&mask, &path)?;
    }
    let share = sum / pairs.len().max(1) as f64;
    if share > MOSTLY_SET {
        let message = format!("{:.0} % of the pixels of the masks are set", 100.0 * share);
        let hint =
            "masks are set where something moves: if yours mark what is static (like those of COLMAP), invert them";
        return Err(bad(message).hint(hint).at(input));
    }
    Ok(share)
}
