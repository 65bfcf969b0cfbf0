//! Results by name: links for people, who do not read digests.

use std::fs;
use std::io::{self, ErrorKind};
use std::os::unix::fs::symlink;
use std::path::{Component, Path, PathBuf};

use super::{Store, naming};
use crate::Digest;

impl Store {
    /// The link to the last result of a node, `results/<recipe>/<node>`; the slashes of a node's name make folders.
    pub fn result_link(&self, recipe: &str, node: &str) -> PathBuf {
        self.root.join("results").join(recipe).join(node)
    }

    /// Lets the link of each node lead to the view of its artifact; links that do already are not touched, and what the
    /// store did not make is an error.
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
            self.make_way(&link)?;
            // Renamed into place, so that there is a link at any time.
            let new = scratch.path().join("link");
            symlink(&target, &new).map_err(naming(&link))?;
            fs::rename(&new, &link).map_err(naming(&link))?;
        }
        Ok(())
    }

    /// The view as seen from the folder of `link`: relative, so that a store can be moved as a whole.
    fn target_from(&self, link: &Path, content: &Digest) -> PathBuf {
        let depth = link.strip_prefix(&self.root).unwrap_or(link).components().count().saturating_sub(1);
        let up = std::iter::repeat_n("..", depth);
        up.chain(["views", &content.to_string()]).collect()
    }

    /// Makes the folders above `link` and nothing at `link` itself. An earlier version of the recipe may have had a node
    /// where there is a folder now (a link, which must not be followed into the store), or the other way round.
    fn make_way(&self, link: &Path) -> io::Result<()> {
        let results = self.root.join("results");
        let inside = link.strip_prefix(&results).unwrap_or(Path::new(".."));
        if !inside.components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(naming(link)(io::Error::new(
                ErrorKind::InvalidInput,
                "results lie below the store's own folder",
            )));
        }
        let folders: Vec<&Path> = link.ancestors().skip(1).take_while(|folder| folder.starts_with(&results)).collect();
        for folder in folders.into_iter().rev() {
            if folder.is_symlink() {
                remove_own(folder)?;
            }
            if !folder.exists() {
                fs::create_dir(folder).map_err(naming(folder))?;
            }
        }
        remove_own(link)
    }
}

/// Removes a link that the store made, or a folder of such links; anything else stays and is an error.
fn remove_own(path: &Path) -> io::Result<()> {
    match fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => Err(naming(path)(error)),
        Ok(meta) if meta.is_dir() => {
            for entry in fs::read_dir(path).map_err(naming(path))? {
                remove_own(&entry.map_err(naming(path))?.path())?;
            }
            fs::remove_dir(path).map_err(naming(path))
        }
        Ok(_) if is_own(path) => fs::remove_file(path).map_err(naming(path)),
        Ok(_) => {
            let foreign = "this is in the way of a result, and the store did not make it";
            Err(naming(path)(io::Error::new(ErrorKind::AlreadyExists, foreign)))
        }
    }
}

/// Whether this is a link to a view: nothing else in the folder of results is the store's.
pub(super) fn is_own(path: &Path) -> bool {
    let leads_to_view =
        |target: PathBuf| target.is_relative() && target.parent().is_some_and(|up| up.ends_with("views"));
    fs::read_link(path).is_ok_and(leads_to_view)
}
