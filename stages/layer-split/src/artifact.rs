//! The artifact: a mask of moving pixels per view.

use std::path::{Path, PathBuf};

use anyhow::ensure;
use scene::index_file::{self, ViewFiles};
use scene::{Capture, LabelMap};
use serde::{Deserialize, Serialize};

/// Name of the index file.
const INDEX_FILE: &str = "layers.json";
/// What the index describes, for error messages.
const WHAT: &str = "layers";
/// Name of the folder of masks.
const MASKS: &str = "moving";

/// Masks on disk: the index `layers.json` (this structure) and the PNG files that it names.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layers {
    /// The folder of the artifact; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// The evidence for motion: `velocity`, `masks`, `velocity+masks`, `files`, `residual-flow` or
    /// `temporal-median`.
    pub source: String,
    /// One entry per view of the capture, in its order.
    pub views: Vec<LayerView>,
}

/// The mask of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayerView {
    /// The name of the capture's view.
    pub name: String,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// 8-bit grey PNG, nonzero where something moves; `None` for a view without evidence.
    pub moving: Option<PathBuf>,
    /// Share of moving pixels, in [0, 1]; 0 for a view without evidence.
    pub moving_share: f64,
}

impl Layers {
    /// Reads the mask of a view (an index within the views of the capture), nonzero where something moves; `None` if
    /// the view has no mask.
    pub fn load_moving(&self, view: usize) -> scene::Result<Option<LabelMap>> {
        let file = self.views[view].moving.as_deref();
        self.files(view).load(file, LabelMap::read, |map| (map.width, map.height))
    }

    /// Mean share of moving pixels over the views that have a mask.
    pub(crate) fn moving_share(&self) -> f64 {
        let known: Vec<f64> =
            self.views.iter().filter(|view| view.moving.is_some()).map(|view| view.moving_share).collect();
        known.iter().sum::<f64>() / known.len().max(1) as f64
    }

    /// Checks that these masks belong to `capture`: the same views, in the same order.
    pub fn check_against(&self, capture: &Capture) -> scene::Result<()> {
        capture.check_names(self.views.iter().map(|view| view.name.as_str()))
    }

    /// Writes the mask of one view of `size` (width, height) below `dir` and returns its index entry.
    pub fn write_view(dir: &Path, name: &str, size: (u32, u32), moving: Option<&LabelMap>) -> scene::Result<LayerView> {
        let write = |map: &LabelMap| {
            let file = Path::new(MASKS).join(format!("{name}.png"));
            index_file::create_dir(&dir.join(MASKS))?;
            map.write(&dir.join(&file))?;
            scene::Result::Ok(file)
        };
        let share = |map: &LabelMap| {
            map.labels.iter().filter(|label| **label != 0).count() as f64 / map.labels.len().max(1) as f64
        };
        let (width, height) = size;
        let moving_share = moving.map_or(0.0, share);
        Ok(LayerView { name: name.into(), width, height, moving: moving.map(write).transpose()?, moving_share })
    }

    /// Writes the index into `dir`, after the masks of all `views`.
    pub fn save(dir: &Path, source: &str, views: Vec<LayerView>) -> scene::Result<Self> {
        let layers = Self { dir: dir.into(), source: source.into(), views };
        index_file::write(&dir.join(INDEX_FILE), WHAT, &layers)?;
        Ok(layers)
    }

    fn files(&self, view: usize) -> ViewFiles<'_> {
        ViewFiles { dir: &self.dir, size: (self.views[view].width, self.views[view].height) }
    }
}

impl engine::Artifact for Layers {
    const NAME: &'static str = "layers";
    const SCHEMA: u32 = 1;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        Ok(Self { dir: dir.into(), ..index_file::read(&dir.join(INDEX_FILE), WHAT)? })
    }

    fn check(&self) -> anyhow::Result<()> {
        ensure!(self.views.iter().any(|view| view.moving.is_some()), "no view has a mask");
        for (index, view) in self.views.iter().enumerate() {
            let share = view.moving_share;
            ensure!(
                (0.0..=1.0).contains(&share),
                "the share of moving pixels of view {} is {share}, not in [0, 1]",
                view.name
            );
            view.moving.as_ref().map_or(Ok(()), |file| self.files(index).check_image(file))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use engine::Artifact as _;

    use super::*;

    fn save(dir: &Path) -> Layers {
        let mask = LabelMap { width: 4, height: 2, labels: vec![0, 1, 0, 0, 0, 0, 9, 0] };
        let known = Layers::write_view(dir, "a", (4, 2), Some(&mask)).unwrap();
        let unknown = Layers::write_view(dir, "b", (4, 2), None).unwrap();
        Layers::save(dir, "masks", vec![known, unknown]).unwrap()
    }

    #[test]
    fn saved_layers_read_back() {
        let dir = tempfile::tempdir().unwrap();
        save(dir.path());
        let layers = Layers::open(dir.path()).unwrap();
        layers.check().unwrap();
        assert_eq!(layers.load_moving(0).unwrap().unwrap().labels, [0, 1, 0, 0, 0, 0, 9, 0]);
        assert_eq!(layers.load_moving(1).unwrap(), None);
        assert_eq!((layers.views[0].moving_share, layers.moving_share()), (0.25, 0.25));
    }

    #[test]
    fn wrong_sizes_shares_and_missing_files_are_rejected() {
        let dir = tempfile::tempdir().unwrap();
        let layers = save(dir.path());
        let refused = |change: fn(&mut Layers)| {
            let mut changed = layers.clone();
            change(&mut changed);
            changed.check().unwrap_err().to_string()
        };
        assert!(refused(|layers| layers.views[0].width = 5).contains("moving/a.png"));
        assert!(refused(|layers| layers.views[0].moving_share = f64::NAN).contains("share"));
        assert!(refused(|layers| layers.views[0].moving = Some("moving/b.png".into())).contains("moving/b.png"));
        assert!(refused(|layers| layers.views[0].moving = Some("../a.png".into())).contains("leads outside"));
        assert!(refused(|layers| layers.views[0].moving = None).contains("no view has a mask"));
    }
}
