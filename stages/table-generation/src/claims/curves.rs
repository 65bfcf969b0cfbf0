//! Quality over seconds as others measured it.

use anyhow::ensure;
use serde::Deserialize;

use super::ClaimProtocol;

const FILE: &str = include_str!("../../claims/third_party_curves.toml");

/// The curves of one source.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedCurves {
    /// Who measured, with the version of the data.
    pub source: String,
    /// Where it lies.
    pub url: String,
    /// The day on which the figures were taken from there.
    pub taken: String,
    /// What it ran on.
    pub hardware: String,
    /// What a reader should know.
    pub notes: Vec<String>,
    /// Under which protocol.
    pub protocol: ClaimProtocol,
    /// One per method and scene.
    pub curve: Vec<PublishedCurve>,
}

/// One method on one scene.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedCurve {
    /// The method's id here.
    pub method: String,
    /// What the source calls it.
    pub label: String,
    /// The scene.
    pub scene: String,
    /// Seconds of training of every evaluation, ascending.
    pub seconds: Vec<f64>,
    /// PSNR on the test views, dB.
    pub psnr: Vec<f64>,
}

/// The curves that are compiled in.
pub fn built_in() -> anyhow::Result<PublishedCurves> {
    parse(FILE)
}

fn parse(text: &str) -> anyhow::Result<PublishedCurves> {
    let curves: PublishedCurves = toml::from_str(text)?;
    for curve in &curves.curve {
        let name = format!("curve of {} on {}", curve.label, curve.scene);
        ensure!(!curve.seconds.is_empty() && curve.seconds.len() == curve.psnr.len(), "{name}: lists differ in length");
        ensure!(curve.seconds.is_sorted(), "{name}: seconds do not ascend");
        ensure!(curve.seconds.iter().chain(&curve.psnr).all(|v| v.is_finite() && *v >= 0.0), "{name}: not a number");
    }
    Ok(curves)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curves_agree_with_the_claims_of_the_same_source() {
        let curves = built_in().expect("valid curves");
        assert_eq!(curves.curve.len(), 23, "three methods on eight scenes, one of which has no curve");
        let mut n_checked = 0;
        for claim in crate::built_in_claims().expect("valid claims") {
            let same = |scene: &String| {
                curves.curve.iter().find(|curve| curve.method == claim.method && curve.scene == *scene)
            };
            if !curves.source.starts_with("R. Lanza") || !claim.source.starts_with("R. Lanza") {
                continue;
            }
            for (scene, printed) in &claim.scenes {
                let last = same(scene).and_then(|curve| curve.psnr.last().copied()).expect("a curve");
                assert!((last - printed.psnr.expect("a PSNR")).abs() <= 0.006, "{} on {scene}", claim.label);
                n_checked += 1;
            }
        }
        assert_eq!(n_checked, 21);
    }

    #[test]
    fn faulty_curves_are_refused() {
        for (from, to) in [
            ("seconds = [44.5,", "seconds = [nan,"),
            ("seconds = [44.5,", "seconds = ["),
            ("psnr = [7.64,", "psnr = [-1,"),
        ] {
            assert!(FILE.contains(from) && parse(&FILE.replacen(from, to, 1)).is_err(), "{to} was accepted");
        }
    }
}
