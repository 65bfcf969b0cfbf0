//! Tests of edits and masks by prompts, in films and exports.

use std::path::Path;

use image::RgbImage;
use scene::{Gaussians, image_file};
use shaders::tape::Device;
use training::Edit;

use super::trained_with_prompts;
use crate::export::ply_sequence;
use crate::film::{Film, film_to_folder};
use crate::{Selection, Show};

fn selection<'a>(prompt: &'a str, show: Show) -> Option<Selection<'a>> {
    Some(Selection { prompt, embeddings: None, show })
}

/// Films one frame with a selection.
fn frame(root: &Path, selection: Option<Selection<'_>>, name: &str) -> anyhow::Result<RgbImage> {
    let film = Film { times: &[0.4], views: &[], selection };
    film_to_folder(&root.join("model"), &root.join("capture"), &film, Device::Cpu, &root.join(name))?;
    Ok(image_file::read_rgb(&root.join(name).join("frame_0000.png")).unwrap())
}

/// Exports one time with a selection: the report and the Gaussians of the file.
fn export(root: &Path, selection: Option<Selection<'_>>, name: &str) -> anyhow::Result<(String, Gaussians)> {
    let out = root.join(name);
    let report = ply_sequence(&root.join("model"), &root.join("capture"), &[0.4], selection.as_ref(), &out)?;
    Ok((report, Gaussians::read_ply(&out.join("frame_0000.ply")).unwrap()))
}

#[test]
fn edits_divide_the_gaussians_and_change_images_and_exports() {
    let (dir, ..) = trained_with_prompts();
    let root = dir.path();
    let edits = [Edit::Remove, Edit::Keep, Edit::Recolor([1.0, 0.0, 0.0])].map(Show::Edit);
    let plain = frame(root, None, "plain").unwrap();
    let frames = [0, 1, 2].map(|at| frame(root, selection("sky", edits[at]), &format!("frame{at}")).unwrap());
    assert!(frames.iter().all(|frame| *frame != plain) && frames[0] != frames[1]);

    let (_, all) = export(root, None, "all").unwrap();
    let exports = [0, 1, 2].map(|at| export(root, selection("sky", edits[at]), &format!("export{at}")).unwrap());
    let [(report, removed), (_, kept), (_, recolored)] = &exports;
    assert!(removed.len() + kept.len() == all.len() && !removed.is_empty() && !kept.is_empty(), "{report}");
    assert!(report.starts_with(&format!("\"sky\" selects {} of {} Gaussians", kept.len(), all.len())), "{report}");
    assert!(recolored.positions == all.positions && recolored.sh != all.sh);
    // The remaining Gaussians are unchanged.
    let first = |gaussians: &Gaussians| gaussians.positions[..3].to_vec();
    assert!(all.positions.chunks(3).any(|position| position == first(kept)));
}

#[test]
fn masks_are_black_and_white_and_not_for_export() {
    let (dir, ..) = trained_with_prompts();
    let mask = frame(dir.path(), selection("sky", Show::Mask), "mask").unwrap();
    assert!(mask.as_raw().iter().all(|&level| level == 0 || level == 255));
    let error = export(dir.path(), selection("sky", Show::Mask), "ply").unwrap_err();
    assert!(format!("{error:?}").contains("--edit remove"), "{error:?}");
    assert!(!dir.path().join("ply").exists(), "nothing is written");
}

/// Writes the embedding of one further prompt.
fn write_embedding(folder: &Path, prompt: &str, values: &[f32]) {
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join("prompts.txt"), prompt).unwrap();
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': (1, {}), }}", values.len());
    let mut bytes = [&b"\x93NUMPY\x01\x00\x76\x00"[..], format!("{header:<117}\n").as_bytes()].concat();
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    std::fs::write(folder.join("text.npy"), bytes).unwrap();
}

#[test]
fn free_prompts_come_with_their_embeddings() {
    let (dir, ..) = trained_with_prompts();
    let words = dir.path().join("words");
    let ask = |name: &str| {
        let free = Selection { prompt: "lawn", embeddings: Some(&words), show: Show::Mask };
        frame(dir.path(), Some(free), name)
    };
    assert!(frame(dir.path(), selection("lawn", Show::Mask), "none").is_err());
    // A prompt with the same meaning as another one is nowhere more relevant than that one, so it selects nothing.
    write_embedding(&words, "lawn", &[0.0, 2.0]);
    let [lawn, sky] = [ask("lawn"), frame(dir.path(), selection("sky", Show::Mask), "sky")].map(Result::unwrap);
    let white = |mask: &RgbImage| mask.as_raw().iter().filter(|&&level| level == 255).count();
    assert_eq!(white(&lawn), 0);
    write_embedding(&words, "lawn", &[-2.0, 0.0]);
    assert!(white(&ask("not sky").unwrap()) <= sky.as_raw().len() - white(&sky));
    write_embedding(&words, "lawn", &[0.1, 1.0, 0.0]);
    let error = format!("{:?}", ask("wide").unwrap_err());
    assert!(error.contains("3 dimensions") && error.contains("trained with 2"), "{error}");
}
