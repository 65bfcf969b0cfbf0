//! The protocols of published values, and their differences from a measured group.

use scene::protocol::PRESETS;
use scene::{Protocol, Split};
use serde::{Deserialize, Serialize};

/// A source's protocol. Unstated fields are absent and never assumed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ClaimProtocol {
    /// The benchmark: a value of [`scene::Protocol::dataset`], or the name used in the literature.
    pub dataset: String,
    /// The split, a value of [`scene::Protocol::split`].
    pub split: Option<String>,
    /// The images of the split that were evaluated.
    #[serde(default = "test_images")]
    pub images: Split,
    /// Image width, px.
    pub width: Option<u32>,
    /// Image height, px.
    pub height: Option<u32>,
    /// The filter that gave images that size, a value of [`scene::Protocol::resize`].
    pub resize: Option<String>,
    /// The background, a value of [`scene::Protocol::background`].
    pub background: Option<String>,
    /// The iterate that was scored.
    pub checkpoint: Option<Checkpoint>,
    /// Whether saved 8-bit images or float renders were scored.
    pub levels: Option<Levels>,
}

fn test_images() -> Split {
    Split::Test
}

/// The iterate that a source scores. This project always scores the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Checkpoint {
    /// The last iterate.
    Last,
    /// The iterate with the best value on the test images.
    BestOnTest,
}

/// The precision of the images that a source scores. This project always scores saved 8-bit images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum Levels {
    /// 8-bit files.
    #[serde(rename = "8-bit")]
    Eight,
    /// Float renders, which score about 0.01 dB higher at 35 dB.
    #[serde(rename = "float")]
    Float,
}

/// Benchmarks whose captures carry the name of a file layout: (benchmark, layout).
const LAYOUT_OF: [(&str, &str); 2] = [("hypernerf", "nerfies"), ("n3v", "colmap")];

impl ClaimProtocol {
    /// Whether the source measured on captures of this data set.
    pub(crate) fn is_of(&self, dataset: &str) -> bool {
        self.dataset == dataset || LAYOUT_OF.contains(&(self.dataset.as_str(), dataset))
    }

    /// The protocol in one line; unstated fields are named as such, except for the filter, which images of their original
    /// size do not have.
    pub(crate) fn line(&self) -> String {
        let Self { dataset, split, images: _, width, height, resize, background, checkpoint, levels } = self;
        let split = split.as_ref().map_or("split not stated".into(), |split| format!("{split} split"));
        let size = match (width, height) {
            (Some(width), Some(height)) => format!("{width}×{height}"),
            _ => "resolution not stated".into(),
        };
        let resize = resize.as_ref().map(|filter| format!(" · resize {filter}")).unwrap_or_default();
        let background = background.as_ref().map_or("background not stated".into(), |b| format!("{b} background"));
        let checkpoint = match checkpoint {
            None => "checkpoint rule not stated",
            Some(Checkpoint::Last) => "last iterate",
            Some(Checkpoint::BestOnTest) => "best iterate on the test images",
        };
        let levels = match levels {
            None => "8-bit or float not stated",
            Some(Levels::Eight) => "8-bit images",
            Some(Levels::Float) => "float renders",
        };
        let images = format!("{} images", self.images.name());
        let name = self.preset_name().map(|name| format!("{name} · ")).unwrap_or_default();
        format!("{name}{dataset} · {split} · {images} · {size}{resize} · {background} · {checkpoint} · {levels}")
    }

    /// Name of the only preset that matches the stated images; none unless all fields of the images are stated.
    fn preset_name(&self) -> Option<&'static str> {
        let stated = (self.split.as_ref()?, self.width?, self.height?, self.background.as_ref()?);
        let mut presets = PRESETS.iter().filter(|preset| {
            let named = preset.protocol();
            self.images == Split::Test
                && self.is_of(&named.dataset)
                && self.resize.as_ref().is_none_or(|filter| *filter == named.resize)
                && (&named.split, named.width, named.height, &named.background) == stated
        });
        presets.next().filter(|_| presets.next().is_none()).map(|preset| preset.name)
    }

    /// Every difference from a measured row, and every field that the source leaves open. `ours` and `judged_by` are
    /// those of the row's group; `departures` are those of [`Row::departures`](crate::report::Row::departures).
    pub(crate) fn differences(&self, ours: &Protocol, judged_by: &str, departures: Vec<String>) -> Vec<String> {
        let mut differences = self.differences_of_images(ours, judged_by);
        match self.checkpoint {
            None => differences.push("checkpoint rule not stated".into()),
            Some(Checkpoint::BestOnTest) => {
                differences.push("checkpoint: published best on the test images, measured last".into())
            }
            Some(Checkpoint::Last) => {}
        }
        match self.levels {
            None => differences.push("8-bit or float not stated".into()),
            Some(Levels::Float) => differences.push("levels: published float renders, measured 8-bit images".into()),
            Some(Levels::Eight) => {}
        }
        differences.extend(departures);
        differences
    }

    /// The differences that concern the images themselves: data set, split, resolution, filter, background,
    /// evaluated views.
    pub(crate) fn differences_of_images(&self, ours: &Protocol, judged_by: &str) -> Vec<String> {
        let mut differences = Vec::new();
        if !self.is_of(&ours.dataset) {
            differences.push(format!("data set: published {}, measured {}", self.dataset, ours.dataset));
        }
        match &self.split {
            None => differences.push("split not stated".into()),
            Some(theirs) if *theirs != ours.split => {
                differences.push(format!("split: published {theirs}, measured {}", ours.split));
            }
            Some(_) => {}
        }
        match (self.width, self.height) {
            (Some(width), Some(height)) if (width, height) != (ours.width, ours.height) => {
                differences
                    .push(format!("resolution: published {width}×{height}, measured {}×{}", ours.width, ours.height));
            }
            (Some(_), Some(_)) => differences.extend(self.difference_of_filter(ours)),
            _ => differences.push("resolution not stated".into()),
        }
        match &self.background {
            None => differences.push("background not stated".into()),
            Some(theirs) if *theirs != ours.background => {
                differences.push(format!("background: published {theirs}, measured {}", ours.background));
            }
            Some(_) => {}
        }
        if !judged_by.starts_with(&format!("{} images", self.images.name())) {
            differences.push(format!("images: published {}, measured {judged_by}", self.images.name()));
        }
        differences
    }

    /// The difference between the filters that gave images one size; images of their original size need none.
    fn difference_of_filter(&self, ours: &Protocol) -> Option<String> {
        match &self.resize {
            None => (ours.resize != "none").then(|| "resize filter not stated".into()),
            Some(theirs) => {
                (*theirs != ours.resize).then(|| format!("resize filter: published {theirs}, measured {}", ours.resize))
            }
        }
    }
}
