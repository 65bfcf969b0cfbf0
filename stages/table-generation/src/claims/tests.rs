//! Claim files are consistent, and faulty ones are rejected.

use super::*;
use crate::library;

#[test]
fn printed_means_match_printed_scenes_unless_noted() {
    let mut n_checked = 0;
    for claim in library::claims().expect("valid claim files") {
        let Some(mean) = &claim.mean else { continue };
        let psnr = |scene: &String| claim.scenes.get(scene).and_then(|values| values.psnr);
        let printed: Option<Vec<f64>> = mean.scenes.iter().map(psnr).collect();
        let (Some(printed), Some(mean_psnr)) = (printed, mean.values.psnr) else { continue };
        let difference = printed.iter().sum::<f64>() / printed.len() as f64 - mean_psnr;
        let explained = claim.notes.iter().any(|note| note.contains("mean"));
        assert!(difference.abs() <= 0.0101 || explained, "{} {}: {difference}", claim.source, claim.label);
        n_checked += 1;
    }
    assert!(n_checked >= 10, "only {n_checked} means were checked");
}

#[test]
fn resize_filters_have_to_agree() {
    let of = |dataset: &str, width| {
        let is_it = |claim: &&Claim| {
            let protocol = &claim.protocol;
            claim.source.starts_with("Wu et al.")
                && (protocol.dataset.as_str(), protocol.width) == (dataset, Some(width))
        };
        library::claims().expect("valid claim files").iter().find(is_it).expect("a claim").protocol.clone()
    };
    let differences = |theirs: &ClaimProtocol, resize: &str| {
        let ours = scene::Protocol {
            dataset: theirs.dataset.clone(),
            split: theirs.split.clone().expect("stated"),
            width: theirs.width.expect("stated"),
            height: theirs.height.expect("stated"),
            resize: resize.into(),
            background: theirs.background.clone().expect("stated"),
            time: "file time".into(),
        };
        theirs.differences(&ours, "test images · 8-bit levels", Vec::new())
    };
    let (resized, original) = (of("n3v", 1352), of("dnerf", 800));
    assert_eq!(differences(&resized, "lanczos3"), [""; 0]);
    assert_eq!(differences(&resized, "area"), ["resize filter: published lanczos3, measured area"]);
    assert!(resized.line().contains("n3v-1352 · ") && resized.line().contains("1352×1014 · resize lanczos3 · "));
    assert_eq!(differences(&original, "none"), [""; 0]);
    assert_eq!(differences(&original, "area"), ["resize filter not stated"]);
}

#[test]
fn faulty_claim_files_are_rejected() {
    let good = r#"[[claim]]
        method = "m"
        label = "M"
        kind = "quoted"
        source = "Table 1"
        protocol = { dataset = "d", split = "s", width = 8, height = 8 }
        scenes = { a = { psnr = 30.0 } }"#;
    assert_eq!(parse(good).expect("valid").len(), 1);
    let planted = [
        ("psnr = 30.0", "psnr = nan"),
        ("psnr = 30.0", "psnr = -1.0"),
        ("psnr = 30.0", "pnsr = 30.0"),
        ("quoted", "guessed"),
        ("scenes = { a = { psnr = 30.0 } }", ""),
        ("dataset = \"d\", ", ""),
    ];
    for (from, to) in planted {
        assert!(parse(&good.replace(from, to)).is_err(), "{to} was accepted");
    }
}
