//! Tests of edits and masks by prompts, in films and exports.

use std::path::Path;

use image::RgbImage;
use scene::{Gaussians, image_file};
use shaders::tape::Device;
use training::{Edit, Player};

use super::trained_with_prompts;
use crate::export::ply_sequence;
use crate::film::{Film, film_to_folder};
use crate::prompts::Prompt;
use crate::{Selection, Show};

fn selection<'a>(prompt: &'a str, show: Show) -> Option<Selection<'a>> {
    Some(Selection { prompt, embeddings: None, show })
}

/// Films one frame with a selection: the summary and the frame.
fn film(root: &Path, selection: Option<Selection<'_>>, name: &str) -> anyhow::Result<(String, RgbImage)> {
    let film = Film { times: &[0.4], views: &[], selection };
    let summary = film_to_folder(&root.join("model"), &root.join("capture"), &film, Device::Cpu, &root.join(name))?;
    Ok((summary, image_file::read_rgb(&root.join(name).join("frame_0000.png")).unwrap()))
}

/// Films one frame with a selection.
fn frame(root: &Path, selection: Option<Selection<'_>>, name: &str) -> anyhow::Result<RgbImage> {
    Ok(film(root, selection, name)?.1)
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
    let selects = format!("\"sky\" selects {} of {} Gaussians\n", kept.len(), all.len());
    assert!(report.starts_with(&selects), "{report}");
    for (index, show) in [edits[0], Show::Mask, Show::Highlight].into_iter().enumerate() {
        let (summary, _) = film(root, selection("sky", show), &format!("counted{index}")).unwrap();
        assert!(summary.starts_with(&format!("{selects}1 frame of ")), "{summary}");
    }
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

/// Writes the embeddings of prompts.
fn write_embeddings(folder: &Path, prompts: &[(&str, &[f32])]) {
    std::fs::create_dir_all(folder).unwrap();
    let names: Vec<&str> = prompts.iter().map(|(name, _)| *name).collect();
    std::fs::write(folder.join("prompts.txt"), names.join("\n")).unwrap();
    let shape = (prompts.len(), prompts[0].1.len());
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape:?}, }}");
    let mut bytes = [&b"\x93NUMPY\x01\x00\x76\x00"[..], format!("{header:<117}\n").as_bytes()].concat();
    prompts.iter().flat_map(|(_, values)| *values).for_each(|value| bytes.extend(value.to_le_bytes()));
    std::fs::write(folder.join("text.npy"), bytes).unwrap();
}

#[test]
fn free_prompts_come_with_their_embeddings() {
    let (dir, ..) = trained_with_prompts();
    let words = dir.path().join("words");
    let ask = |name: &str| {
        let free = Selection { prompt: "lawn", embeddings: Some(&words), show: Show::Highlight };
        frame(dir.path(), Some(free), name)
    };
    assert!(frame(dir.path(), selection("lawn", Show::Highlight), "none").is_err());
    // It selects what "sky" selected, which now means what "ground" means.
    write_embeddings(&words, &[("lawn", &[2.0, 0.0]), ("sky", &[0.0, 4.0])]);
    assert_eq!(ask("lawn").unwrap(), frame(dir.path(), selection("sky", Show::Highlight), "sky").unwrap());
    write_embeddings(&words, &[("lawn", &[0.1, 1.0, 0.0])]);
    let error = format!("{:?}", ask("wide").unwrap_err());
    assert!(error.contains("3 dimensions") && error.contains("trained with 2"), "{error}");
}

#[test]
fn prompts_that_select_nothing_are_refused_and_write_nothing() {
    let (dir, model, _) = trained_with_prompts();
    let words = dir.path().join("words");
    // A prompt with the same meaning as another one is nowhere more relevant than that one.
    write_embeddings(&words, &[("lawn", &[0.0, 2.0])]);
    for show in [Show::Highlight, Show::Mask, Show::Edit(Edit::Keep)] {
        let free = Some(Selection { prompt: "lawn", embeddings: Some(&words), show });
        let mut errors = vec![film(dir.path(), free, "film").map(drop).unwrap_err()];
        errors.extend(matches!(show, Show::Edit(_)).then(|| export(dir.path(), free, "ply").map(drop).unwrap_err()));
        for error in errors {
            let error = error.to_string();
            assert!(
                error.contains("\"lawn\" selects none of ") && error.contains("competes with \"ground\""),
                "{error}"
            );
        }
    }
    assert!(["film", "ply"].iter().all(|name| !dir.path().join(name).exists()));

    let player = Player::new(&model).unwrap();
    let everything = Prompt { embeddings: player.prompts().unwrap(), row: 0, selected: [60, 60] };
    let error = everything.edit(player, Edit::Remove).map(drop).unwrap_err().to_string();
    assert!(error.contains("the prompt selects all 60 Gaussians; nothing would be left"), "{error}");
}
