//! The masks of masked metrics: names, sources, and the pixels that they select.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// The name of a mask, by which tables look up masked values: values of different names never share a column. Those of two
/// folders under one name do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaskName {
    /// Pixels that training cameras also see (DyCheck).
    CoVisibility,
    /// Pixels of the moving object.
    Foreground,
    /// The capture's instance labels.
    Labels,
    /// A mask of the user's own.
    Other,
}

impl MaskName {
    /// Every name, in the order of tables.
    pub const ALL: [Self; 4] = [Self::CoVisibility, Self::Foreground, Self::Labels, Self::Other];

    /// The name in files and parameters.
    pub fn key(self) -> &'static str {
        match self {
            Self::CoVisibility => "co_visibility",
            Self::Foreground => "foreground",
            Self::Labels => "labels",
            Self::Other => "other",
        }
    }

    /// The name in tables.
    pub fn heading(self) -> &'static str {
        match self {
            Self::CoVisibility => "co-visibility",
            Self::Foreground => "foreground",
            Self::Labels => "labels",
            Self::Other => "other mask",
        }
    }

    /// The parameter that names the folder of the mask.
    pub(crate) fn folder_key(self) -> &'static str {
        match self {
            Self::CoVisibility => "masks.co_visibility.folder",
            Self::Foreground => "masks.foreground.folder",
            Self::Labels => "masks.labels",
            Self::Other => "masks.other.folder",
        }
    }
}

/// The masks of an evaluation.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Masks {
    /// Pixels that training cameras also see (DyCheck: `covisible/2x/val`).
    pub co_visibility: MaskFiles,
    /// Pixels of the moving object, e.g. those that U²-Net finds.
    pub foreground: MaskFiles,
    /// The capture's instance labels.
    pub labels: LabelMask,
    /// A mask of your own.
    pub other: MaskFiles,
}

/// A mask in files.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaskFiles {
    /// Folder with one mask `VIEW.png` per view, relative to the data root; if empty, the mask is not used.
    pub folder: PathBuf,
    /// Mask values that select pixels.
    pub keeps: Keep,
    /// Whether the folder may be missing: the metrics of this mask are then undefined, and all others are measured.
    pub allow_missing: bool,
}

/// The mask values that select pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Keep {
    /// All values but 0.
    #[default]
    Nonzero,
    /// The value 0, for masks that mark excluded pixels.
    Zero,
    /// Values above 127, for soft masks such as those of U²-Net.
    Half,
}

impl Keep {
    /// Whether a mask value selects its pixel.
    pub(crate) fn selects(self, value: u8) -> bool {
        match self {
            Self::Nonzero => value > 0,
            Self::Zero => value == 0,
            Self::Half => value > 127,
        }
    }
}

/// The instances that the capture's labels select.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelMask {
    /// The mask is not used.
    #[default]
    None,
    /// All instances.
    Nonzero,
    /// The background.
    Zero,
}

/// A mask in use.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mask<'a> {
    pub(crate) name: MaskName,
    pub(crate) keeps: Keep,
    /// Where the mask is in files.
    pub(crate) files: Option<&'a MaskFiles>,
}

impl Masks {
    /// The masks in use, in the order of tables.
    pub(crate) fn used(&self) -> impl Iterator<Item = Mask<'_>> {
        let labels = match self.labels {
            LabelMask::None => None,
            LabelMask::Nonzero => Some(Keep::Nonzero),
            LabelMask::Zero => Some(Keep::Zero),
        };
        let labels = labels.map(|keeps| Mask { name: MaskName::Labels, keeps, files: None });
        let in_files = self.folders().map(|(name, files)| Mask { name, keeps: files.keeps, files: Some(files) });
        let mut used: Vec<Mask<'_>> = in_files.chain(labels).collect();
        used.sort_by_key(|mask| mask.name);
        used.into_iter()
    }

    /// The masks with a folder.
    pub(crate) fn folders(&self) -> impl Iterator<Item = (MaskName, &MaskFiles)> {
        let all = [
            (MaskName::CoVisibility, &self.co_visibility),
            (MaskName::Foreground, &self.foreground),
            (MaskName::Other, &self.other),
        ];
        all.into_iter().filter(|(_, files)| !files.folder.as_os_str().is_empty())
    }
}
