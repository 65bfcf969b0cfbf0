//! Results by name: links for people, who do not read digests.

use std::fs;
use std::io;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use super::{Store, naming};
use crate::Digest;

impl Store {
    /// The link to the last result of a node, `results/<recipe>/<node>`; the slashes of a node's name make folders.
    pub fn result_link(&self, recipe: &str, node: &str) -> PathBuf {
        self.root.join("results").join(recipe).join(node)
    }

    /// Lets the link of each node lead to the view of its artifact; links that do already are not touched.
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

    /// Makes the folders above `link`. An earlier version of the recipe may have had a node where there is a folder now
    /// (a link, which must not be followed into the store), or the other way round.
    fn make_way(&self, link: &Path) -> io::Result<()> {
        let results = self.root.join("results");
        let folders: Vec<&Path> = link.ancestors().skip(1).take_while(|folder| folder.starts_with(&results)).collect();
        for folder in folders.into_iter().rev() {
            if folder.is_symlink() {
                fs::remove_file(folder).map_err(naming(folder))?;
            }
            if !folder.exists() {
                fs::create_dir(folder).map_err(naming(folder))?;
            }
        }
        let is_folder = fs::symlink_metadata(link).is_ok_and(|meta| meta.is_dir());
        if is_folder { fs::remove_dir_all(link).map_err(naming(link)) } else { Ok(()) }
    }
}
