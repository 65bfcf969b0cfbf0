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
