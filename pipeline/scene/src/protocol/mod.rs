//! Evaluation protocols: how the evaluated images were made. Numbers are comparable only under equal protocols.

mod presets;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

pub use presets::{PRESETS, Preset};

/// The part of the evaluation protocol that the data determines.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Protocol {
    /// The benchmark or source, e.g. `dnerf` or `synthetic`.
    pub dataset: String,
    /// The assignment of images to splits, e.g. `official` or `every 8th`.
    pub split: String,
    /// Width of the evaluated images in pixels.
    pub width: u32,
    /// Height of the evaluated images in pixels.
    pub height: u32,
    /// The filter that gave images that size: `none`, `area`, `lanczos3` or `analytic`.
    pub resize: String,
    /// The colour behind transparent pixels: `white`, `black` or `none` (opaque images).
    pub background: String,
    /// The normalisation of time to [0, 1], e.g. `file time / max` or `index / (count - 1)`.
    pub time: String,
}

/// Number of hexadecimal digits of a hash: enough for the protocols in use to differ.
const HASH_DIGITS: usize = 8;

impl Protocol {
    /// One line with the name of the preset, if it is one, the hash and every field. Lines are equal exactly if
    /// protocols are.
    pub fn line(&self) -> String {
        let name = self.preset().map(|preset| format!("{} ", preset.name)).unwrap_or_default();
        format!("{name}[{}] {}", self.hash(), self.fields())
    }

    /// The first eight hexadecimal digits of the SHA-256 of all fields; the same on every machine.
    pub fn hash(&self) -> String {
        let digest = Sha256::digest(self.fields());
        digest.iter().map(|byte| format!("{byte:02x}")).take(HASH_DIGITS / 2).collect()
    }

    /// The preset that equals this protocol in every field.
    pub fn preset(&self) -> Option<&'static Preset> {
        PRESETS.iter().find(|preset| preset.protocol() == *self)
    }

    /// Every difference from `other`, e.g. `background black instead of white`.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let pairs = self.named().into_iter().zip(other.named());
        let differs = |((name, ours), (_, theirs)): (&(&str, String), &(&str, String))| {
            (ours != theirs).then(|| format!("{name} {ours} instead of {theirs}"))
        };
        pairs.filter_map(|(ours, theirs)| differs((&ours, &theirs))).collect()
    }

    /// The fields with their names; width and height are one field.
    fn named(&self) -> [(&'static str, String); 6] {
        let Self { dataset, split, width, height, resize, background, time } = self;
        [
            ("dataset", dataset.clone()),
            ("split", split.clone()),
            ("size", format!("{width}×{height}")),
            ("resize", resize.clone()),
            ("background", background.clone()),
            ("time", time.clone()),
        ]
    }

    /// All fields as one text.
    fn fields(&self) -> String {
        let Self { dataset, split, width, height, resize, background, time } = self;
        format!(
            "{dataset} · {split} split · {width}×{height} · resize {resize} · {background} background · time {time}"
        )
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn white() -> Protocol {
        Preset::named("dnerf-800-white").unwrap().protocol()
    }

    #[test]
    fn presets_are_found_by_name_and_by_fields() {
        let names: BTreeSet<_> = PRESETS.iter().map(|preset| preset.name).collect();
        assert_eq!(names.len(), PRESETS.len());
        for preset in PRESETS {
            assert_eq!(Preset::named(preset.name).map(|found| found.name), Some(preset.name));
            assert_eq!(preset.protocol().preset().map(|found| found.name), Some(preset.name), "two presets are equal");
        }
        assert!(Preset::named("dnerf-801-white").is_none());
    }

    /// The hash is published next to numbers, so it must not change between versions.
    #[test]
    fn hashes_are_stable_and_depend_on_every_field() {
        assert_eq!(white().hash(), "d1704790");
        let changes: [fn(&mut Protocol); 7] = [
            |p| p.dataset = "dnerf2".into(),
            |p| p.split = "official, tested on val".into(),
            |p| p.width = 400,
            |p| p.height = 400,
            |p| p.resize = "area".into(),
            |p| p.background = "black".into(),
            |p| p.time = "index".into(),
        ];
        let mut seen = BTreeSet::from([white().hash()]);
        for change in changes {
            let mut changed = white();
            change(&mut changed);
            assert!(seen.insert(changed.hash()), "{}", changed.line());
            assert_eq!(changed.differences(&white()).len(), 1);
        }
    }

    #[test]
    fn lines_begin_with_name_and_hash() {
        assert!(white().line().starts_with("dnerf-800-white [d1704790] dnerf · official split · 800×800"));
        let own = Protocol { width: 200, height: 200, ..white() };
        assert!(own.line().starts_with(&format!("[{}] dnerf", own.hash())) && own.preset().is_none());
        assert_eq!(own.differences(&white()), ["size 200×200 instead of 800×800"]);
    }

    #[test]
    fn quoted_means_apply_at_any_size() {
        let own = Protocol { width: 200, height: 200, ..white() };
        let [eight, seven] = own.quoted_means() else { panic!("D-NeRF has two means") };
        assert_eq!((eight.len(), seven.len()), (8, 7));
        assert!(eight.contains(&"lego") && !seven.contains(&"lego"));
        assert!(Protocol { dataset: "synthetic".into(), ..own }.quoted_means().is_empty());
    }
}
