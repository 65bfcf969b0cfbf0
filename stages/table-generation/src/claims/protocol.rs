//! How published numbers came to be, and in what that differs from a group of ours.

use scene::Split;
use scene::protocol::PRESETS;
use serde::{Deserialize, Serialize};

use crate::report::{Group, Row};

/// A source's protocol; what it does not state is absent and never taken for granted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClaimProtocol {
    /// The benchmark, as [`scene::Protocol::dataset`] or by the name that the literature gives it.
    pub dataset: String,
    /// As [`scene::Protocol::split`].
    pub split: Option<String>,
    /// Which of the split's images were judged.
    #[serde(default = "test_images")]
    pub images: Split,
    /// Pixels per row.
    pub width: Option<u32>,
    /// Rows.
    pub height: Option<u32>,
    /// As [`scene::Protocol::background`].
    pub background: Option<String>,
    /// Which iterate was scored.
    pub checkpoint: Option<Checkpoint>,
    /// Whether saved 8-bit images or float renders were scored.
    pub levels: Option<Levels>,
}

fn test_images() -> Split {
    Split::Test
}

/// Which iterate a source scores; ours is always the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Checkpoint {
    /// The last one.
    Last,
    /// The one with the best value on the test images.
    BestOnTest,
}

/// What a source scores; ours are always saved 8-bit images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Levels {
    /// 8-bit files.
    #[serde(rename = "8-bit")]
    Eight,
    /// Float renders, which score about 0.01 dB higher at 35 dB.
    #[serde(rename = "float")]
    Float,
}

/// Benchmarks whose captures are imported under the name of a file layout.
const LAYOUT_OF: [(&str, &str); 2] = [("hypernerf", "nerfies"), ("n3v", "colmap")];

impl ClaimProtocol {
    /// Whether captures of this data set are what the source measured on.
    pub fn is_of(&self, dataset: &str) -> bool {
        self.dataset == dataset || LAYOUT_OF.contains(&(self.dataset.as_str(), dataset))
    }

    /// One line, with what is not stated.
    pub fn line(&self) -> String {
        let Self { dataset, split, images: _, width, height, background, checkpoint, levels } = self;
        let split = split.as_ref().map_or("split not stated".into(), |split| format!("{split} split"));
        let size = match (width, height) {
            (Some(width), Some(height)) => format!("{width}×{height}"),
            _ => "resolution not stated".into(),
        };
        let background = background.as_ref().map_or("background not stated".into(), |b| format!("{b} background"));
        let checkpoint = match checkpoint {
            None => "checkpoint rule not stated",
            Some(Checkpoint::Last) => "last iterate",
            Some(Checkpoint::BestOnTest) => "best iterate on the test images",
        };
        let levels = match levels {
            None => "8 bit or float not stated",
            Some(Levels::Eight) => "8-bit images",
            Some(Levels::Float) => "float renders",
        };
        let images = format!("{} images", self.images_judged());
        let name = self.preset_name().map(|name| format!("{name} · ")).unwrap_or_default();
        format!("{name}{dataset} · {split} · {images} · {size} · {background} · {checkpoint} · {levels}")
    }

    /// The only protocol by name that agrees with what is stated of the images, where all of that is stated.
    fn preset_name(&self) -> Option<&'static str> {
        let stated = (self.split.as_ref()?, self.width?, self.height?, self.background.as_ref()?);
        let mut presets = PRESETS.iter().filter(|preset| {
            let named = preset.protocol();
            self.images == Split::Test
                && self.is_of(&named.dataset)
                && (&named.split, named.width, named.height, &named.background) == stated
        });
        presets.next().filter(|_| presets.next().is_none()).map(|preset| preset.name)
    }

    fn images_judged(&self) -> &'static str {
        match self.images {
            Split::Train => "train",
            Split::Val => "val",
            Split::Test => "test",
        }
    }

    /// Everything in which this protocol differs from that of a row of a group, or leaves open whether it does.
    pub fn differences(&self, group: &Group, row: &Row) -> Vec<String> {
        let mut differences = self.differences_of_images(group);
        match self.checkpoint {
            None => differences.push("checkpoint rule not stated".into()),
            Some(Checkpoint::BestOnTest) => differences.push("best iterate on the test images there, last here".into()),
            Some(Checkpoint::Last) => {}
        }
        match self.levels {
            None => differences.push("8 bit or float not stated".into()),
            Some(Levels::Float) => differences.push("float renders there, 8-bit images here".into()),
            Some(Levels::Eight) => {}
        }
        differences.extend(row.shortened.as_ref().map(|how| format!("{how} here")));
        differences
    }

    /// The same without how images were scored: whether the images themselves are those of a group.
    pub fn differences_of_images(&self, group: &Group) -> Vec<String> {
        let ours = &group.protocol;
        let mut differences = Vec::new();
        if !self.is_of(&ours.dataset) {
            differences.push(format!("data set {} there, {} here", self.dataset, ours.dataset));
        }
        match &self.split {
            None => differences.push("split not stated".into()),
            Some(theirs) if *theirs != ours.split => {
                differences.push(format!("split {theirs} there, {} here", ours.split));
            }
            Some(_) => {}
        }
        match (self.width, self.height) {
            (Some(width), Some(height)) if (width, height) != (ours.width, ours.height) => {
                differences.push(format!("resolution {width}×{height} there, {}×{} here", ours.width, ours.height));
            }
            (Some(_), Some(_)) => {}
            _ => differences.push("resolution not stated".into()),
        }
        match &self.background {
            None => differences.push("background not stated".into()),
            Some(theirs) if *theirs != ours.background => {
                differences.push(format!("{theirs} background there, {} here", ours.background));
            }
            Some(_) => {}
        }
        if !group.judged_by.starts_with(&format!("{} images", self.images_judged())) {
            differences.push(format!("{} images there, {} here", self.images_judged(), group.judged_by));
        }
        differences
    }
}
