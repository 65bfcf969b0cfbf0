//! Fakes of every data set that the recipes of the papers name, below one data root.

use std::path::Path;

use serde_json::json;

use super::{Fake, write};

/// Images of one grey level at the size of the real ones: a plan reads names, poses and headers.
fn blank(cameras: usize, frames: usize, size: (u32, u32)) -> Fake {
    Fake { size, is_still: true, is_blank: true, ..Fake::small(cameras, frames) }
}

/// Writes every scene of the papers' recipes with the layout, the size of images and, where a recipe requests it, the
/// number of frames of the real one. Scenes of one data set are links to its first scene.
pub fn papers(root: &Path) {
    let of = |folder: &str, scenes: &[&str], make: &dyn Fn(&Path)| {
        let first = root.join(folder).join(scenes[0]);
        make(&first);
        for scene in &scenes[1..] {
            link(&first, &root.join(folder).join(scene));
        }
    };
    let dnerf = ["bouncingballs", "hellwarrior", "hook", "jumpingjacks", "lego", "mutant", "standup", "trex"];
    of("dnerf", &dnerf, &|dir| blank(4, 5, (800, 800)).dnerf(dir));
    let n3v = ["coffee_martini", "cook_spinach", "cut_roasted_beef", "flame_salmon", "flame_steak", "sear_steak"];
    of("n3v", &n3v, &|dir| blank(2, 300, (2704, 2028)).neural_3d_video(dir));
    let two_cameras = ["broom2", "vrig-3dprinter", "vrig-chicken", "vrig-peel-banana"];
    of("hypernerf", &two_cameras, &|dir| blank(2, 6, (536, 960)).nerfies(dir, 2));
    let one_camera = ["aleks-teapot", "chickchicken", "cut-lemon1", "hand1-dense-v2", "slice-banana", "torchocolate"];
    of("hypernerf", &one_camera, &|dir| blank(1, 12, (536, 960)).nerfies(dir, 2));
    let nerfies =
        ["badminton", "beanie", "broom", "curls", "drinking", "glasses", "kitchen", "lamp", "tail", "toby-sit"];
    of("nerfies", &nerfies, &|dir| blank(2, 6, (270, 480)).nerfies(dir, 4));
    let dycheck = ["apple", "block", "paper-windmill", "space-out", "spin", "teddy", "wheel"];
    of("dycheck", &dycheck, &|dir| blank(2, 6, (360, 480)).dycheck(dir));
    let enerf = ["actor1_4", "actor2_3", "actor5_6"];
    of("enerf-outdoor", &enerf, &|dir| blank(9, 1200, (1920, 1080)).easy_volcap(dir));
    of("mobilestage", &["dance3"], &|dir| blank(6, 1600, (1920, 1080)).easy_volcap(dir));
    let studio = ["basketball", "box", "softball"];
    of("cmu-panoptic-hd", &studio, &|dir| blank(31, 4, (1920, 1080)).panoptic_studio(dir));
    let clips: Vec<String> = (1..=15).map(|number| format!("video-{number:02}")).collect();
    let clips: Vec<&str> = clips.iter().map(String::as_str).collect();
    of("generated", &clips, &|dir| blank(1, 30, (832, 480)).colmap(dir));
}

impl Fake {
    /// DyCheck: the layout of Nerfies at half size, with `splits/{train,val}.json` and masks of what both cameras see.
    fn dycheck(&self, dir: &Path) {
        self.nerfies(dir, 2);
        for (camera, split) in ["train", "val"].iter().enumerate() {
            let names: Vec<String> = (0..self.frames).map(|frame| format!("{camera}_{frame:05}")).collect();
            let ids = vec![camera; self.frames];
            let text = json!({ "frame_names": names, "camera_ids": ids }).to_string();
            write(&dir.join(format!("splits/{split}.json")), text);
        }
        for frame in 0..self.frames {
            super::write_mask(&dir.join(format!("covisible/2x/val/1_{frame:05}.png")), self.size, |_, _| true);
        }
    }
}

/// Makes `to` another name of a folder.
#[cfg(unix)]
fn link(folder: &Path, to: &Path) {
    std::os::unix::fs::symlink(folder, to).expect("a new name");
}

/// Makes `to` another name of a folder; links to folders may not be allowed here, so its files are linked instead.
#[cfg(not(unix))]
fn link(folder: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("the temporary folder can be written");
    for entry in std::fs::read_dir(folder).expect("readable").flatten() {
        let (from, to) = (entry.path(), to.join(entry.file_name()));
        if from.is_dir() { link(&from, &to) } else { std::fs::hard_link(from, to).expect("one disk") }
    }
}
