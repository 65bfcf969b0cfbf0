//! The weights of LPIPS: files that torchvision and the authors of LPIPS publish, verified by hash.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Digest, Failure, FailureKind};

use super::torch_file::{self, Tensor};
use super::{Backbone, Lpips};

/// A published file and the beginning of its SHA-256 (torchvision publishes the first eight digits in the file name).
struct Published {
    file: &'static str,
    sha256: &'static str,
}

const fn published(file: &'static str, sha256: &'static str) -> Published {
    Published { file, sha256 }
}

const ALEX: &[Published] =
    &[published("alexnet-owt-7be5be79.pth", "7be5be79"), published("alexnet-owt-4df8aa71.pth", "4df8aa71")];
const VGG: &[Published] = &[published("vgg16-397923af.pth", "397923af")];
const SQUEEZE: &[Published] =
    &[published("squeezenet1_1-b8a52dc0.pth", "b8a52dc0"), published("squeezenet1_1-f364aa15.pth", "f364aa15")];
const ALEX_HEAD: &[Published] =
    &[published("alex.pth", "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0")];
const VGG_HEAD: &[Published] =
    &[published("vgg.pth", "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868")];
const SQUEEZE_HEAD: &[Published] =
    &[published("squeeze.pth", "4a5350f23600cb79923ce65bb07cbf57dca461329894153e05a1346bd531cf76")];

impl Backbone {
    /// The file of the classifier (two names if torchvision published the same weights twice), and the file of LPIPS's own
    /// weights, version 0.1.
    fn files(self) -> [&'static [Published]; 2] {
        match self {
            Self::Alex => [ALEX, ALEX_HEAD],
            Self::Vgg => [VGG, VGG_HEAD],
            Self::Squeeze => [SQUEEZE, SQUEEZE_HEAD],
        }
    }
}

/// The published files of each network of LPIPS: the network, the file of its classifier, and LPIPS's own file.
pub fn lpips_files() -> [(&'static str, [&'static str; 2]); 3] {
    [("alex", Backbone::Alex), ("vgg", Backbone::Vgg), ("squeeze", Backbone::Squeeze)]
        .map(|(name, backbone)| (name, backbone.files().map(|files| files[0].file)))
}

/// The reason why LPIPS with this classifier is unavailable with the files in `folder`, if it is.
pub(crate) fn missing_file(folder: &Path, backbone: Backbone) -> Option<String> {
    backbone.files().into_iter().find_map(|files| find(folder, files).err())
}

/// LPIPS with one classifier, or the reason why it is unavailable.
pub(crate) enum Weights {
    /// The weights are loaded.
    Ready(Box<Lpips>),
    /// A file is missing; the text names it.
    Missing(String),
}

impl Weights {
    /// Reads the files of a classifier in `folder`.
    ///
    /// # Errors
    /// A file with a published name and another content.
    pub(crate) fn open(folder: &Path, backbone: Backbone) -> Result<Self, Failure> {
        let [body, head] = backbone.files().map(|files| find(folder, files));
        let (body, head) = match (body, head) {
            (Ok(body), Ok(head)) => (body, head),
            (Err(missing), _) | (_, Err(missing)) => return Ok(Self::Missing(missing)),
        };
        let [body, head] = [read_verified(&body)?, read_verified(&head)?];
        let lpips = Lpips::new(backbone, &body, &head);
        let refused =
            |reason| Failure::new(FailureKind::BadInput, format!("these are weights of another network: {reason}"));
        lpips.map(|lpips| Self::Ready(Box::new(lpips))).map_err(|reason| refused(reason).at(folder))
    }
}

/// Reads and verifies LPIPS's own weights without a classifier.
#[cfg(test)]
pub(super) fn read_head(folder: &Path, backbone: Backbone) -> Result<BTreeMap<String, Tensor>, Failure> {
    let missing = |missing| Failure::new(FailureKind::MissingData, missing);
    read_verified(&find(folder, backbone.files()[1]).map_err(missing)?)
}

/// A file and the beginning of its published hash.
type Found = (PathBuf, &'static str);

/// The first existing file and its hash; the error names a missing file.
fn find(folder: &Path, files: &'static [Published]) -> Result<Found, String> {
    let at = |published: &Published| Some((folder.join(published.file), published.sha256));
    let found = files.iter().filter_map(at).find(|(path, _)| path.is_file());
    let file = files[0].file;
    // The classifiers' names end with a hash; LPIPS's own files are named after the classifier alone.
    let from = match file.contains('-') {
        true => format!("torchvision publishes it: https://download.pytorch.org/models/{file}"),
        false => format!("it is part of the Python package lpips: lpips/weights/v0.1/{file}"),
    };
    let get = "`pipeline data fetch lpips` puts it into the folder lpips below the data root";
    found.ok_or_else(|| format!("{file} is missing in the folder of LPIPS weights; {get}; {from}"))
}

fn read_verified((path, sha256): &Found) -> Result<BTreeMap<String, Tensor>, Failure> {
    let failure = |kind, message: String| Failure::new(kind, message).at(path);
    let bytes = std::fs::read(path).map_err(|error| failure(FailureKind::World, format!("cannot read: {error}")))?;
    let found = Digest::of(&bytes).to_string();
    if !found.starts_with(sha256) {
        let message = format!("the SHA-256 is {found}, but that of the published file begins with {sha256}");
        return Err(failure(FailureKind::BadInput, message).hint("download the file again"));
    }
    torch_file::read(&bytes)
        .map_err(|reason| failure(FailureKind::BadInput, format!("cannot read the weights: {reason}")))
}
