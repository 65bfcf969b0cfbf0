//! The artifact: an image of the static scene per view, its depth, and a mask of unfilled pixels.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use scene::image_file::{self, RgbImage};
use scene::index_file::{self, ViewFiles};
use scene::{Capture, DepthMap, LabelMap};
use serde::{Deserialize, Serialize};

/// Name of the index file.
const INDEX_FILE: &str = "background.json";
/// What the index describes, for error messages.
const WHAT: &str = "a background";

/// Images of the static scene on disk: the index `background.json` (this structure) and the files that it names.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Background {
    /// The folder of the artifact; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// The origin of filled pixels: `files` or `propagate`.
    pub source: String,
    /// One entry per view of the capture, in its order.
    pub views: Vec<BackgroundView>,
}

/// The index entry of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BackgroundView {
    /// The name of the capture's view.
    pub name: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// The files of the view, if it was filled.
    pub filled: Option<FilledFiles>,
}

/// Files of a filled view, relative to the artifact's folder; [`FilledView`] is their content.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FilledFiles {
    /// 8-bit RGB PNG of the static scene.
    pub image: PathBuf,
    /// EXR: view-space z in scene units; 0 where unknown.
    pub depth: Option<PathBuf>,
    /// 8-bit grey PNG, nonzero where the image is unfilled.
    pub unfilled: PathBuf,
    /// Share of unfilled pixels in the image, in [0, 1].
    pub unfilled_share: f64,
}

/// The static scene as one view shows it, in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct FilledView {
    /// The image without moving objects; the background colour of the capture where unfilled.
    pub image: RgbImage,
    /// View-space depth of the filled image, if known; 0 where unknown.
    pub depth: Option<DepthMap>,
    /// Nonzero where the image is unfilled.
    pub unfilled: LabelMap,
}

impl Background {
    /// Reads a view (an index within the views of the capture); `None` if it was not filled.
    pub fn load_view(&self, view: usize) -> scene::Result<Option<FilledView>> {
        let Some(filled) = &self.views[view].filled else { return Ok(None) };
        let files = self.files(view);
        let image = files.load(Some(&filled.image), image_file::read_rgb, RgbImage::dimensions)?;
        let unfilled = files.load(Some(&filled.unfilled), LabelMap::read, |map| (map.width, map.height))?;
        let depth = files.load(filled.depth.as_deref(), DepthMap::read, |map| (map.width, map.height))?;
        Ok(image.zip(unfilled).map(|(image, unfilled)| FilledView { image, depth, unfilled }))
    }

    /// Mean share of unfilled pixels over the filled views.
    pub(crate) fn unfilled_share(&self) -> f64 {
        let shares: Vec<f64> =
            self.views.iter().filter_map(|view| Some(view.filled.as_ref()?.unfilled_share)).collect();
        shares.iter().sum::<f64>() / shares.len().max(1) as f64
    }

    /// Checks that these images belong to `capture`: the same views, in the same order.
    pub fn check_against(&self, capture: &Capture) -> scene::Result<()> {
        capture.check_names(self.views.iter().map(|view| view.name.as_str()))
    }

    /// Writes one view of `size` (width, height) below `dir` and returns its index entry.
    pub fn write_view(
        dir: &Path,
        name: &str,
        size: (u32, u32),
        filled: Option<&FilledView>,
    ) -> scene::Result<BackgroundView> {
        let path = |kind: &str, extension: &str| {
            index_file::create_dir(&dir.join(kind))?;
            scene::Result::Ok(Path::new(kind).join(format!("{name}.{extension}")))
        };
        let write = |view: &FilledView| {
            let (image, unfilled) = (path("images", "png")?, path("unfilled", "png")?);
            image_file::write_rgb(&dir.join(&image), &view.image)?;
            view.unfilled.write(&dir.join(&unfilled))?;
            let depth = view.depth.as_ref().map(|depth| {
                let file = path("depth", "exr")?;
                depth.write(&dir.join(&file))?;
                scene::Result::Ok(file)
            });
            let count = view.unfilled.labels.iter().filter(|label| **label != 0).count();
            let unfilled_share = count as f64 / view.unfilled.labels.len().max(1) as f64;
            scene::Result::Ok(FilledFiles { image, depth: depth.transpose()?, unfilled, unfilled_share })
        };
        let (width, height) = size;
        Ok(BackgroundView { name: name.into(), width, height, filled: filled.map(write).transpose()? })
    }

    /// Writes the index into `dir`, after the files of all `views`.
    pub fn save(dir: &Path, source: &str, views: Vec<BackgroundView>) -> scene::Result<Self> {
        let background = Self { dir: dir.into(), source: source.into(), views };
        index_file::write(&dir.join(INDEX_FILE), WHAT, &background)?;
        Ok(background)
    }

    fn files(&self, view: usize) -> ViewFiles<'_> {
        ViewFiles { dir: &self.dir, size: (self.views[view].width, self.views[view].height) }
    }
}

impl engine::Artifact for Background {
    const NAME: &'static str = "background";
    const SCHEMA: u32 = 1;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        Ok(Self { dir: dir.into(), ..index_file::read(&dir.join(INDEX_FILE), WHAT)? })
    }

    fn check(&self) -> anyhow::Result<()> {
        ensure!(self.views.iter().any(|view| view.filled.is_some()), "no view was filled");
        for (index, view) in self.views.iter().enumerate() {
            let Some(filled) = &view.filled else { continue };
            let (files, share) = (self.files(index), filled.unfilled_share);
            ensure!(
                (0.0..=1.0).contains(&share),
                "the share of unfilled pixels of view {} is {share}, not in [0, 1]",
                view.name
            );
            files.check_image(&filled.image)?;
            files.check_image(&filled.unfilled)?;
            filled.depth.as_ref().map_or(Ok(()), |depth| files.check_floats(depth, &[&DepthMap::CHANNELS]))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use engine::Artifact as _;
    use scene::image_file::Rgb;

    use super::*;

    fn filled() -> FilledView {
        FilledView {
            image: RgbImage::from_fn(3, 2, |x, y| Rgb([x as u8, y as u8, 7])),
            depth: Some(DepthMap { width: 3, height: 2, depth_view: vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0] }),
            unfilled: LabelMap { width: 3, height: 2, labels: vec![255, 0, 0, 0, 0, 0] },
        }
    }

    fn save(dir: &Path) -> Background {
        let first = Background::write_view(dir, "a", (3, 2), Some(&filled())).unwrap();
        let second = Background::write_view(dir, "b", (3, 2), None).unwrap();
        Background::save(dir, "files", vec![first, second]).unwrap()
    }

    #[test]
    fn a_saved_background_reads_back() {
        let dir = tempfile::tempdir().unwrap();
        save(dir.path());
        let background = Background::open(dir.path()).unwrap();
        background.check().unwrap();
        assert_eq!(background.load_view(0).unwrap(), Some(filled()));
        assert_eq!(background.load_view(1).unwrap(), None);
        assert_eq!(background.unfilled_share(), 1.0 / 6.0);
    }

    #[test]
    fn wrong_sizes_and_missing_files_are_rejected() {
        let dir = tempfile::tempdir().unwrap();
        let background = save(dir.path());
        let mut larger = background.clone();
        larger.views[0].height = 3;
        assert!(larger.check().unwrap_err().to_string().contains("images/a.png"));
        let mut empty = background.clone();
        empty.views[0].filled = None;
        assert!(empty.check().unwrap_err().to_string().contains("no view was filled"));
        std::fs::remove_file(dir.path().join("depth/a.exr")).unwrap();
        assert!(background.check().unwrap_err().to_string().contains("depth/a.exr"));
    }
}
