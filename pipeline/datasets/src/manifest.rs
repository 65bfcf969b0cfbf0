//! The description of a data set.

use std::path::{Component, Path, PathBuf};

use engine::{Digest, Failure, FailureKind};
use serde::Deserialize;

/// The version of the keys below.
const VERSION: u32 = 1;
/// Hex digits of a SHA-256.
const HASH_DIGITS: usize = 64;

/// A data set: what it is, where it comes from, and where it belongs below the data root.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of the keys; 1.
    pub manifest: u32,
    /// Short name, e.g. `dnerf`.
    pub name: String,
    /// Title with its publication.
    pub title: String,
    /// Where the authors describe it.
    pub homepage: String,
    /// Where it comes from, in words.
    pub source: String,
    /// The licence, in words.
    pub licence: String,
    /// Whether fetching needs `--accept-licence`.
    #[serde(default)]
    pub accept_licence: bool,
    /// How it can be obtained.
    pub access: Access,
    /// What to do if `access` is not `open`.
    #[serde(default)]
    pub by_hand: String,
    /// The format of its folders: a value of the key `format` of `sfm-import`.
    pub format: String,
    /// Its folder below the data root.
    pub folder: PathBuf,
    /// Files in words and, under `images`, the pattern of a scene's images with `{scene}` and `{split}`.
    #[serde(default)]
    pub layout: toml::Table,
    /// Differences between published protocols.
    #[serde(default)]
    pub protocol: toml::Table,
    /// The split of each paper.
    #[serde(default)]
    pub splits: toml::Table,
    /// Downloads.
    #[serde(default)]
    pub archive: Vec<Archive>,
    /// Scenes; none for files without scenes.
    #[serde(default)]
    pub scene: Vec<Scene>,
}

/// How a data set can be obtained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Access {
    /// By download.
    Open,
    /// By a web page that programs cannot use.
    Browser,
    /// From its authors, on request.
    Request,
    /// It was not published.
    Unpublished,
}

/// A file to download: a ZIP archive of scenes, or a file that is stored as it is.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Archive {
    /// Its address.
    pub url: String,
    /// Its size in bytes, if known.
    pub size: Option<u64>,
    /// Its SHA-256 as hex digits, if known: all 64, or the first ones.
    pub sha256: Option<String>,
    /// The scenes in it; empty for a file that is stored as it is.
    #[serde(default)]
    pub scenes: Vec<String>,
    /// The destination of a file that is not an archive, below the folder of the data set.
    pub to: Option<PathBuf>,
    /// Maximum number of bytes to which it may unpack. If unset: 20 times its size plus 1 GiB.
    pub unpacked_bytes: Option<u64>,
    /// The day on which a fetch of this address last succeeded.
    pub tried: Option<String>,
}

/// A scene of a data set.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Name in recipes.
    pub name: String,
    /// Its folder below that of the data set, if it differs from the name.
    pub folder: Option<PathBuf>,
    /// The name of its folder in the archive, if it differs from the name.
    pub archived_as: Option<String>,
    /// Its format, if it differs from that of the data set.
    pub format: Option<String>,
    /// Special properties of the scene.
    pub kind: Option<String>,
    /// Known flaws of the scene.
    pub flaw: Option<String>,
    /// Number of training images.
    pub train: Option<u64>,
    /// Number of validation images.
    pub val: Option<u64>,
    /// Number of test images.
    pub test: Option<u64>,
    /// Number of images.
    pub images: Option<u64>,
    /// Number of frames per camera.
    pub frames: Option<u64>,
    /// Number of cameras.
    pub cameras: Option<u64>,
}

impl Manifest {
    /// Parses a manifest; errors name `origin`.
    pub fn parse(text: &str, origin: &Path) -> Result<Self, Failure> {
        let bad = |message: String| Failure::new(FailureKind::BadInput, message).at(origin);
        let manifest: Self = toml::from_str(text).map_err(|error| bad(error.to_string()))?;
        match manifest.problem() {
            Some(problem) => Err(bad(problem)),
            None => Ok(manifest),
        }
    }

    /// Checks the values that the types do not restrict.
    fn problem(&self) -> Option<String> {
        if self.manifest != VERSION {
            return Some(format!("manifest = {}, but this program reads version {VERSION}", self.manifest));
        }
        let scene_folders = self.scene.iter().filter_map(|scene| scene.folder.as_deref());
        let files = self.archive.iter().filter_map(|archive| archive.to.as_deref());
        let outside =
            |path: &&Path| path.components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir));
        if let Some(path) = [&*self.folder].into_iter().chain(scene_folders).chain(files).find(outside) {
            return Some(format!("the path {} is not below the data root", path.display()));
        }
        // The name is that of a folder of downloads.
        if Path::new(&self.name).file_name() != Some(self.name.as_ref()) {
            return Some(format!("{:?} is not the name of a data set", self.name));
        }
        let nameless = |scene: &&Scene| outside(&Path::new(&scene.name)) || scene.name.is_empty();
        if let Some(scene) = self.scene.iter().find(nameless) {
            return Some(format!("{:?} is not the name of a scene", scene.name));
        }
        self.archive.iter().find_map(|archive| archive.problem(self))
    }

    /// The scene of a name.
    pub fn scene(&self, name: &str) -> Option<&Scene> {
        self.scene.iter().find(|scene| scene.name == name)
    }

    /// The folder of a scene.
    pub fn folder_of(&self, scene: &Scene, data_root: &Path) -> PathBuf {
        let below = scene.folder.as_deref().unwrap_or(Path::new(&scene.name));
        data_root.join(&self.folder).join(below).components().collect()
    }

    /// The scene whose folder contains `path`.
    pub fn scene_at(&self, path: &Path, data_root: &Path) -> Option<&Scene> {
        self.scene.iter().find(|scene| path.starts_with(self.folder_of(scene, data_root)))
    }
}

impl Archive {
    fn problem(&self, manifest: &Manifest) -> Option<String> {
        let is_hash = |hash: &String| hash.len() <= HASH_DIGITS && hash.bytes().all(|digit| digit.is_ascii_hexdigit());
        if !(self.url.starts_with("https://") || self.url.starts_with("http://")) {
            return Some(format!("{} is not an address", self.url));
        }
        if !self.sha256.as_ref().is_none_or(is_hash) {
            return Some(format!("the sha256 of {} is not hexadecimal", self.url));
        }
        if self.scenes.is_empty() == self.to.is_none() {
            return Some(format!("{} needs either scenes or to", self.url));
        }
        let unknown = self.scenes.iter().find(|name| manifest.scene(name).is_none());
        unknown.map(|name| format!("{} has an unknown scene {name}", self.url))
    }

    /// Whether the whole SHA-256 is known.
    pub fn has_hash(&self) -> bool {
        self.sha256.as_ref().is_some_and(|hash| hash.len() == HASH_DIGITS)
    }

    /// Whether a SHA-256 is the stated one, as far as that is stated.
    pub(crate) fn fits(&self, sha256: &str) -> bool {
        self.sha256.as_ref().is_none_or(|stated| sha256.starts_with(&stated.to_lowercase()))
    }

    /// Where a file that is no archive belongs.
    pub fn file(&self, manifest: &Manifest, data_root: &Path) -> Option<PathBuf> {
        Some(data_root.join(&manifest.folder).join(self.to.as_ref()?).components().collect())
    }

    /// The file name of a download: digits of the hash of its address, since many archives are called `data.zip`, and the
    /// last part of the address.
    pub(crate) fn stored_as(&self) -> String {
        let digits = Digest::of(self.url.as_bytes()).short();
        let path = self.url.split(['?', '#']).next().unwrap_or_default();
        let name = path.rsplit('/').next().unwrap_or_default();
        let safe = |symbol: char| if symbol.is_ascii_alphanumeric() || "-_.".contains(symbol) { symbol } else { '_' };
        let name: String = name.chars().map(safe).collect();
        let name = if name.trim_matches('.').is_empty() { "download" } else { &name };
        format!("{digits}-{name}")
    }
}
