//! Published curves of quality over training time.

use anyhow::ensure;
use serde::Deserialize;

use super::protocol::ClaimProtocol;

/// The curves of one source.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PublishedCurves {
    /// Author and version of the data.
    pub source: String,
    /// Address of the data.
    pub url: String,
    /// Day on which the values were copied.
    pub taken: String,
    /// Hardware of the measurements.
    pub hardware: String,
    /// Remarks.
    pub notes: Vec<String>,
    /// The protocol.
    pub protocol: ClaimProtocol,
    /// One curve per method and scene.
    pub curve: Vec<PublishedCurve>,
}

/// The curve of one method on one scene.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PublishedCurve {
    /// The method's id in this project.
    pub method: String,
    /// The source's name for the method.
    pub label: String,
    /// The scene's name.
    pub scene: String,
    /// Seconds of training at every evaluation, ascending.
    pub seconds: Vec<f64>,
    /// PSNR on the test views at every evaluation, dB.
    pub psnr: Vec<f64>,
}

/// Parses and checks a file of curves.
pub(crate) fn parse_curves(text: &str) -> anyhow::Result<PublishedCurves> {
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
    use crate::library;

    #[test]
    fn curves_end_at_the_claims_of_their_source() {
        let curves = library::curves().expect("valid curves");
        assert_eq!(curves.curve.len(), 23, "three methods on eight scenes, one of which has no curve");
        let mut n_checked = 0;
        for claim in library::claims().expect("valid claims") {
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
    fn faulty_curves_are_rejected() {
        for (from, to) in [
            ("seconds = [44.5,", "seconds = [nan,"),
            ("seconds = [44.5,", "seconds = ["),
            ("psnr = [7.64,", "psnr = [-1,"),
        ] {
            let file = library::CURVES;
            assert!(file.contains(from) && parse_curves(&file.replacen(from, to, 1)).is_err(), "{to} was accepted");
        }
    }
}
