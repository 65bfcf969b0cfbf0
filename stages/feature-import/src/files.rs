//! Features of an estimator: visual tokens in `clip/` or `dino/`, one file per view, and prompts with their embeddings, if
//! the estimator has any. Each array may also be a safetensors file with one f32 tensor.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::{Capture, Naming, Split, View, canonical, matched_names};

use crate::array_file::{EXTENSIONS, array_path, read_array, wrong_shape};
use crate::artifact::{TokenGrid, check_vectors};
use crate::layouts::{tokens_of, tokens_of_segments};
use crate::text::TextEmbeddings;

/// Names of the folder of visual tokens.
const VISUAL: [&str; 2] = ["clip", "dino"];
/// Endings of the names of the two files of segments.
const PAIR: [&str; 2] = ["f", "s"];
/// Tokens along the longer side of an image that is given as segments.
const GRID: usize = 32;

/// The feature files of one capture.
pub(crate) struct FeatureFiles {
    /// Prompts and their embeddings, if there are any.
    pub(crate) text: Option<TextEmbeddings>,
    /// Folder of visual tokens.
    visual: PathBuf,
    /// By the name of a view: the name of its file or pair of files, without ending.
    stems: BTreeMap<String, String>,
}

impl FeatureFiles {
    /// Reads prompts and text embeddings.
    pub(crate) fn open(folder: &Path, capture: &Capture, naming: Naming) -> anyhow::Result<Self> {
        let Some(visual) = VISUAL.iter().map(|name| folder.join(name)).find(|visual| visual.is_dir()) else {
            let failure = Failure::new(FailureKind::MissingData, "no such folder of visual tokens");
            let hint = "check --data-root and the recipe's folder; tokens without text belong in dino/";
            return Err(failure.hint(hint).at(folder.join(VISUAL[0])).into());
        };
        let text = TextEmbeddings::find(folder)?;
        let stems = stems(&visual)?;
        let chosen = matched_names(&stems, capture, naming).map_err(|error| error.at(&visual))?;
        let names = capture.views.iter().map(|view| view.name.clone()).zip(chosen);
        let stems = names.filter_map(|(name, key)| Some((name, stems[&key?].clone()))).collect();
        Ok(Self { text, visual, stems })
    }

    /// Reads the tokens of a view, and their dimension. Training views must have tokens; held-out views may lack them.
    pub(crate) fn tokens(&self, view: &View) -> anyhow::Result<Option<(TokenGrid, usize)>> {
        if let Some(stem) = self.stems.get(&view.name) {
            if let Some(path) = array_path(&self.visual.join(stem)) {
                return self.read_tokens(view, &path).map(Some);
            }
            if let [Some(features), Some(segments)] = pair(&self.visual.join(stem)) {
                return self.read_segments(&features, &segments).map(Some);
            }
        }
        if view.split != Split::Train {
            return Ok(None);
        }
        let message = format!("training view {} has no tokens", view.name);
        let path = self.visual.join(format!("{}.npy", view.name));
        Err(Failure::new(FailureKind::MissingData, message).at(path).into())
    }

    fn read_tokens(&self, view: &View, path: &Path) -> anyhow::Result<(TokenGrid, usize)> {
        let (shape, values) = read_array(path)?;
        let size = [view.camera.intrinsics.width, view.camera.intrinsics.height];
        let (tokens, dimension) = tokens_of(&shape, values, self.text_dimension(), size, path)?;
        self.checked(tokens, dimension, path)
    }

    fn read_segments(&self, features: &Path, segments: &Path) -> anyhow::Result<(TokenGrid, usize)> {
        let ((feature_shape, values), (shape, indices)) = (read_array(features)?, read_array(segments)?);
        let [_, dimension] = *feature_shape else { return Err(wrong_shape(&feature_shape, "[segments, F]", features)) };
        let tokens = tokens_of_segments((&shape, &indices), &values, dimension, GRID)
            .ok_or_else(|| wrong_shape(&shape, "[levels, H, W]", segments))?;
        self.checked(tokens, dimension, features)
    }

    fn checked(&self, tokens: TokenGrid, dimension: usize, path: &Path) -> anyhow::Result<(TokenGrid, usize)> {
        if let Some(text) = self.text_dimension().filter(|text| *text != dimension) {
            let message = format!("the tokens have dimension {dimension}, but the text embeddings have {text}");
            let hint = "tokens and text must come from the same estimator, projected to its common space";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into());
        }
        check_vectors(&tokens.values, dimension, path)?;
        Ok((tokens, dimension))
    }

    fn text_dimension(&self) -> Option<usize> {
        self.text.as_ref().map(|text| text.dimension)
    }
}

/// The names of the files in a folder without their endings, by their canonical form; the two files of segments share
/// one.
fn stems(dir: &Path) -> anyhow::Result<BTreeMap<String, String>> {
    let mut stems = BTreeMap::new();
    for entry in fs_err::read_dir(dir)? {
        let name = entry?.file_name();
        let Some((stem, extension)) = name.to_str().and_then(|name| name.rsplit_once('.')) else { continue };
        if !EXTENSIONS.contains(&extension) || stem.starts_with('.') {
            continue;
        }
        let shared = PAIR.iter().find_map(|part| stem.strip_suffix(&format!("_{part}")));
        let shared = shared.filter(|shared| pair(&dir.join(shared)).iter().all(Option::is_some));
        let stem = shared.unwrap_or(stem).to_owned();
        stems.insert(canonical(&stem), stem);
    }
    Ok(stems)
}

/// The features of the segments of a view, and the segment of every pixel.
fn pair(stem: &Path) -> [Option<PathBuf>; 2] {
    PAIR.map(|part| array_path(&PathBuf::from(format!("{}_{part}", stem.display()))))
}
