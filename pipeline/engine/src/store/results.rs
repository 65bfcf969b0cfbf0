//! Links to results by name, for users.

use std::io::{self, ErrorKind};
use std::os::unix::fs::symlink;
use std::path::{Component, Path, PathBuf};

use fs_err as fs;

use super::{Store, at_path};
use crate::Digest;

impl Store {
    /// The link to the last result of a node, `results/<recipe>/<node>`. Slashes in the node's name become folders.
    pub fn result_link(&self, recipe: &str, node: &str) -> PathBuf {
        self.root.join("results").join(recipe).join(node)
    }

    /// Points the link of each node to the view of its artifact. Correct links are not touched. A file that the store
    /// did not make is never replaced; it is an error.
    pub fn link_results<'a>(
        &self,
        recipe: &str,
        contents: impl IntoIterator<Item = (&'a str, &'a Digest)>,
    ) -> anyhow::Result<()> {
        let _in_use = self.lock_shared()?;
        let scratch = self.scratch("links")?;
        for (node, content) in contents {
            let link = self.result_link(recipe, node);
            let target = self.target_from(&link, content);
            if fs::read_link(&link).is_ok_and(|found| found == target) {
                continue;
            }
            self.view(content)?;
            self.clear_path(&link)?;
            // Renamed into place, so that the link always exists.
            let new = scratch.path().join("link");
            symlink(&target, &new).map_err(at_path(&link))?;
            fs::rename(&new, &link)?;
        }
        Ok(())
    }

    /// The path of the view relative to the folder of `link`, so that the store can be moved as a whole.
    fn target_from(&self, link: &Path, content: &Digest) -> PathBuf {
        let depth = link.strip_prefix(&self.root).unwrap_or(link).components().count().saturating_sub(1);
        let up = std::iter::repeat_n("..", depth);
        up.chain(["views", &content.to_string()]).collect()
    }

    /// Creates the folders above `link` and removes a folder at `link`; an old link stays, to be replaced. An earlier version of the recipe
    /// may have had a node whose link is now in the place of a folder (it must not be followed into the store), or vice
    /// versa.
    fn clear_path(&self, link: &Path) -> io::Result<()> {
        let results = self.root.join("results");
        let inside = link.strip_prefix(&results).unwrap_or(Path::new(".."));
        if !inside.components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(at_path(link)(io::Error::new(
                ErrorKind::InvalidInput,
                "results must be below the store's folder",
            )));
        }
        let folders: Vec<&Path> = link.ancestors().skip(1).take_while(|folder| folder.starts_with(&results)).collect();
        for folder in folders.into_iter().rev() {
            if folder.is_symlink() {
                remove_own(folder)?;
            }
            if !folder.exists() {
                fs::create_dir(folder)?;
            }
        }
        if is_own(link) { Ok(()) } else { remove_own(link) }
    }
}

/// Removes a link that the store made, or a folder of such links. Anything else is kept and is an error.
fn remove_own(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
        Ok(meta) if meta.is_dir() => {
            for entry in fs::read_dir(path)? {
                remove_own(&entry?.path())?;
            }
            fs::remove_dir(path)
        }
        Ok(_) if is_own(path) => fs::remove_file(path),
        Ok(_) => {
            let foreign = "a file that the store did not create occupies the place of a result";
            Err(at_path(path)(io::Error::new(ErrorKind::AlreadyExists, foreign)))
        }
    }
}

/// Whether this is a link to a view. The store makes no other files in the folder of results.
pub(super) fn is_own(path: &Path) -> bool {
    let leads_to_view =
        |target: PathBuf| target.is_relative() && target.parent().is_some_and(|up| up.ends_with("views"));
    fs::read_link(path).is_ok_and(leads_to_view)
}
