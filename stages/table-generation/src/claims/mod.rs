//! Published values: what a source prints, under which protocol, and whether a measurement reproduces it.

mod claim;
mod curves;
mod protocol;
mod table;
#[cfg(test)]
mod tests;
mod verdict;

pub(crate) use claim::{Claim, Kind, Published, PublishedMean, parse};
pub(crate) use curves::{PublishedCurve, PublishedCurves, parse_curves};
pub(crate) use protocol::ClaimProtocol;
pub(crate) use table::{ClaimColumn, ClaimTable};
pub(crate) use verdict::Verdict;
