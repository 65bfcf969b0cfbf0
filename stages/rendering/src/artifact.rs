//! The artifact of rendering: images of the views of one split, rendered from one model.

mod semantic_maps;
mod surface_maps;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use scene::{Protocol, Split};
use serde::{Deserialize, Serialize};

pub use semantic_maps::SemanticMaps;
pub use surface_maps::SurfaceMaps;

/// The header's file name.
const HEADER: &str = "renders.json";

/// Rendered views: `renders.json` (this structure) and the image files that it names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Renders {
    /// The artifact's folder; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// The method that trained the model.
    pub method: String,
    /// The protocol of the capture that the views belong to.
    pub protocol: Protocol,
    /// The split whose views were rendered.
    pub split: Split,
    /// The prompts that the model was trained with, in the order of [`SemanticMaps::relevancy`]; empty if the method
    /// uses no prompts.
    pub prompts: Vec<String>,
    /// The rendered views, in the capture's order.
    pub views: Vec<RenderedView>,
    /// Number of Gaussians in the model.
    pub n_gaussians: u64,
    /// Size of the model's tensors in bytes.
    pub model_size_bytes: u64,
}

/// One rendered view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderedView {
    /// The name of the capture's view.
    pub name: String,
    /// Index of the camera in a rig.
    pub camera_index: u32,
    /// Frame number within that camera's video.
    pub frame_index: u32,
    /// Time of the view, in seconds of the capture.
    pub time_secs: f64,
    /// Path of the 8-bit RGB PNG, relative to the folder.
    pub image: PathBuf,
    /// Path of the rendered surfaces ([`SurfaceMaps`]), relative to the folder; present if requested.
    pub maps: Option<PathBuf>,
    /// Path of the rendered semantics ([`SemanticMaps`]), relative to the folder; present if requested and the model
    /// has semantic features.
    pub semantics: Option<PathBuf>,
}

impl Renders {
    /// Writes `renders.json`; the images must already be in `dir`.
    pub fn save(&self, dir: &Path) -> anyhow::Result<()> {
        let path = dir.join(HEADER);
        let text = serde_json::to_string_pretty(self)? + "\n";
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    }

    /// The absolute path of a view's image.
    pub fn image_path(&self, view: &RenderedView) -> PathBuf {
        self.dir.join(&view.image)
    }

    /// Loads the surfaces of a view, if they were rendered.
    pub fn load_maps(&self, view: &RenderedView) -> anyhow::Result<Option<SurfaceMaps>> {
        view.maps.as_ref().map(|maps| SurfaceMaps::read(&self.dir.join(maps))).transpose()
    }

    /// Loads the semantics of a view, if they were rendered. There is one relevancy plane per prompt, or none at all.
    pub fn load_semantics(&self, view: &RenderedView) -> anyhow::Result<Option<SemanticMaps>> {
        let Some(path) = view.semantics.as_ref().map(|file| self.dir.join(file)) else { return Ok(None) };
        let maps = SemanticMaps::read(&path)?;
        let (found, prompts) = (maps.relevancy.len(), self.prompts.len());
        ensure!(found == prompts || found == 0, "{found} relevancy planes for {prompts} prompts: {}", path.display());
        Ok(Some(maps))
    }
}

impl engine::Artifact for Renders {
    const NAME: &'static str = "renders";
    const SCHEMA: u32 = 3;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        let path = dir.join(HEADER);
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let renders: Self =
            serde_json::from_str(&text).with_context(|| format!("not a renders header: {}", path.display()))?;
        Ok(Self { dir: dir.to_path_buf(), ..renders })
    }

    fn check(&self) -> anyhow::Result<()> {
        ensure!(!self.views.is_empty(), "no view was rendered");
        let expected = (self.protocol.width, self.protocol.height);
        let mut names = BTreeSet::new();
        for view in &self.views {
            ensure!(names.insert(&view.name), "view {} appears twice", view.name);
            ensure!(view.time_secs.is_finite(), "view {} has no finite time", view.name);
            let path = self.image_path(view);
            let size = image::image_dimensions(&path).with_context(|| format!("cannot read {}", path.display()))?;
            ensure!(size == expected, "image is {size:?} pixels instead of {expected:?}: {}", path.display());
            for file in view.maps.iter().chain(&view.semantics) {
                ensure!(self.dir.join(file).is_file(), "missing maps: {}", self.dir.join(file).display());
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use engine::Artifact as _;

    use super::*;

    fn write_renders(dir: &Path) -> Renders {
        std::fs::create_dir_all(dir.join("images")).unwrap();
        image::RgbImage::new(6, 4).save(dir.join("images/a.png")).unwrap();
        let protocol = Protocol {
            dataset: "synthetic".into(),
            split: "official".into(),
            width: 6,
            height: 4,
            resize: "none".into(),
            background: "black".into(),
            time: "analytic".into(),
        };
        let view = RenderedView {
            name: "a".into(),
            camera_index: 0,
            frame_index: 3,
            time_secs: 0.25,
            image: "images/a.png".into(),
            maps: None,
            semantics: None,
        };
        let renders = Renders {
            dir: dir.to_path_buf(),
            method: "static3dgs".into(),
            protocol,
            split: Split::Test,
            prompts: Vec::new(),
            views: vec![view],
            n_gaussians: 1,
            model_size_bytes: 4,
        };
        renders.save(dir).unwrap();
        renders
    }

    #[test]
    fn saved_renders_read_back_equal() {
        let dir = tempfile::tempdir().unwrap();
        let renders = write_renders(dir.path());
        let read = Renders::open(dir.path()).unwrap();
        read.check().unwrap();
        assert_eq!(read, renders);
    }

    #[test]
    fn wrong_sizes_missing_images_and_duplicate_names_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let renders = write_renders(dir.path());
        let mut duplicate = renders.clone();
        duplicate.views.push(duplicate.views[0].clone());
        assert!(duplicate.check().unwrap_err().to_string().contains("twice"));
        let mut resized = renders.clone();
        resized.protocol.width = 7;
        assert!(resized.check().is_err());
        std::fs::remove_file(dir.path().join("images/a.png")).unwrap();
        assert!(renders.check().is_err());
    }
}
