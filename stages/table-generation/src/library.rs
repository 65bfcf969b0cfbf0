//! The published values that the binary embeds: all files of `claims/`.

use anyhow::Context as _;

use crate::claims::{Claim, PublishedCurves, parse, parse_curves};
use crate::papers::Paper;

// `PAPERS` and `VALUES`: pairs (file stem, content) of `claims/papers/*.toml` and `claims/values/*.toml`.
include!(concat!(env!("OUT_DIR"), "/claims.rs"));

/// Quality over training time as a third party measured it.
pub(crate) const CURVES: &str = include_str!("../claims/third_party_curves.toml");

/// Names of the papers that recipes can name: the file stems of `claims/papers`.
pub(crate) fn paper_names() -> impl Iterator<Item = &'static str> {
    PAPERS.iter().map(|(name, _)| *name)
}

/// The paper with this file stem.
pub(crate) fn paper(name: &str) -> anyhow::Result<Paper> {
    let (_, text) =
        PAPERS.iter().find(|(known, _)| *known == name).with_context(|| format!("no paper called {name}"))?;
    Paper::parse(text).with_context(|| format!("cannot read the tables of the paper {name}"))
}

/// All papers, in the order of their names.
pub(crate) fn papers() -> anyhow::Result<Vec<Paper>> {
    paper_names().map(paper).collect()
}

/// All claims: those of `claims/values`, and those in the papers' tables about methods of this project.
pub(crate) fn claims() -> anyhow::Result<Vec<Claim>> {
    let mut claims = Vec::new();
    for (name, text) in VALUES {
        claims.extend(parse(text).with_context(|| format!("cannot read the claims {name}"))?);
    }
    for paper in papers()? {
        claims.extend(paper.claims());
    }
    Ok(claims)
}

/// The embedded curves.
pub(crate) fn curves() -> anyhow::Result<PublishedCurves> {
    parse_curves(CURVES)
}
