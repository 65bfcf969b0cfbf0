//! Which camera took an image, and when: both follow from the names of the images.

use std::collections::{BTreeMap, BTreeSet};

use crate::image_names::natural_order;

/// Words that begin the name of a camera, the longest first.
const CAMERA_WORDS: [&str; 2] = ["camera", "cam"];

/// The places of all images of a model.
pub(super) struct Places<'a> {
    /// The camera and the frame number of every image, by name.
    pub(super) of: BTreeMap<&'a str, (u32, u32)>,
    /// How names were read, if not by the rule that a folder is a camera.
    pub(super) note: Option<&'static str>,
}

/// Splits a name into a camera and an instant; `None` if it does not have this form.
type Form = for<'a> fn(&'a str) -> Option<(&'a str, &'a str)>;

/// Numbers cameras and frames. Names like `0001/cam02.png` and `cam02_0001.png` state both if all images have this form;
/// instants are then ranked over all cameras. Otherwise a folder is a camera, and a frame's number is its rank in it.
pub(super) fn places<'a>(names: impl Iterator<Item = &'a str>) -> Places<'a> {
    let names: BTreeSet<&str> = names.collect();
    let forms: [(Form, &str); 2] = [
        (folder_of_instant, "folders of images are read as instants, and their files as cameras"),
        (camera_prefix, "the images are read as frames of the cameras that begin their names"),
    ];
    let stated = forms.into_iter().find_map(|(form, note)| Some((by_form(&names, form)?, note)));
    match stated {
        Some((of, note)) => Places { of, note: Some(note) },
        None => Places { of: by_folder(&names), note: None },
    }
}

/// The places by a form that all names have, with several cameras and instants.
fn by_form<'a>(names: &BTreeSet<&'a str>, form: Form) -> Option<BTreeMap<&'a str, (u32, u32)>> {
    let stated = names.iter().map(|name| Some((*name, form(name)?))).collect::<Option<Vec<_>>>()?;
    let cameras = ranks(stated.iter().map(|(_, (camera, _))| *camera));
    let instants = ranks(stated.iter().map(|(_, (_, instant))| *instant));
    let distinct: BTreeSet<_> = stated.iter().map(|(_, place)| place).collect();
    let is_rig = cameras.len() > 1 && instants.len() > 1 && distinct.len() == names.len();
    is_rig.then(|| stated.into_iter().map(|(name, (camera, at))| (name, (cameras[camera], instants[at]))).collect())
}

fn by_folder<'a>(names: &BTreeSet<&'a str>) -> BTreeMap<&'a str, (u32, u32)> {
    let mut folders: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for name in names {
        folders.entry(name.rsplit_once('/').map_or("", |(folder, _)| folder)).or_default().push(name);
    }
    let cameras = ranks(folders.keys().copied());
    let of_folder = |(folder, mut names): (&str, Vec<&'a str>)| {
        names.sort_by(|a, b| natural_order(a, b));
        let camera = cameras[folder];
        names.into_iter().zip(0..).map(move |(name, frame)| (name, (camera, frame)))
    };
    folders.into_iter().flat_map(of_folder).collect()
}

/// The rank of every distinct text in natural order.
fn ranks<'a>(texts: impl Iterator<Item = &'a str>) -> BTreeMap<&'a str, u32> {
    let distinct: BTreeSet<&str> = texts.collect();
    let mut sorted: Vec<&str> = distinct.into_iter().collect();
    sorted.sort_by(|a, b| natural_order(a, b));
    sorted.into_iter().zip(0..).collect()
}

/// `…/0001/cam02.png`: the camera is the file's name, the instant its folder.
fn folder_of_instant(name: &str) -> Option<(&str, &str)> {
    let (folder, file) = name.rsplit_once('/')?;
    let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
    (after_camera(stem)?.is_empty() && folder.ends_with(|symbol: char| symbol.is_ascii_digit()))
        .then_some((stem, folder))
}

/// `cam02_0001.png`, possibly in a folder: the camera is the beginning of the file's name, the instant its end.
fn camera_prefix(name: &str) -> Option<(&str, &str)> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let file = stem.rsplit_once('/').map_or(stem, |(_, file)| file);
    let rest = after_camera(file)?;
    let instant = rest.strip_prefix(['_', '-', '.'])?;
    instant.ends_with(|symbol: char| symbol.is_ascii_digit()).then(|| (&name[..stem.len() - rest.len()], instant))
}

/// The rest of a text that begins with a camera, e.g. `cam02`, `cam_02` or `Camera-2`.
fn after_camera(text: &str) -> Option<&str> {
    let is_word = |word: &&str| text.get(..word.len()).is_some_and(|start| start.eq_ignore_ascii_case(word));
    let after = &text[CAMERA_WORDS.into_iter().find(is_word)?.len()..];
    let after = after.strip_prefix(['_', '-']).unwrap_or(after);
    let rest = after.trim_start_matches(|symbol: char| symbol.is_ascii_digit());
    (rest.len() < after.len()).then_some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &[&str]) -> (Vec<(u32, u32)>, bool) {
        let places = places(names.iter().copied());
        (names.iter().map(|name| places.of[name]).collect(), places.note.is_some())
    }

    #[test]
    fn cameras_and_instants_follow_from_names() {
        let grid = vec![(0, 0), (1, 0), (0, 1), (1, 1)];
        assert_eq!(of(&["a/9.png", "b/9.png", "a/10.png", "b/10.png"]), (grid.clone(), false));
        assert_eq!(of(&["9/cam2.png", "9/cam10.png", "10/cam2.png", "10/cam10.png"]), (grid.clone(), true));
        assert_eq!(of(&["cam2_9.png", "cam10_9.png", "cam2_10.png", "cam10_10.png"]), (grid.clone(), true));
        assert_eq!(
            of(&["x/Camera_01-f9.png", "x/Camera_02-f9.png", "x/Camera_01-f10.png", "x/Camera_02-f10.png"]).0,
            grid
        );
    }

    #[test]
    fn an_image_that_a_camera_lacks_leaves_a_gap() {
        assert_eq!(of(&["cam0_1.png", "cam0_2.png", "cam1_2.png"]).0, [(0, 0), (0, 1), (1, 1)]);
    }

    #[test]
    fn other_names_are_frames_of_their_folder() {
        let video = (vec![(0, 0), (0, 1)], false);
        assert_eq!(of(&["cam_0001.png", "cam_0002.png"]), video);
        assert_eq!(of(&["cam1_0001.png", "cam1_0002.png"]), video);
        assert_eq!(of(&["cam1_0001.png", "cam2_0001.png"]), video);
        assert_eq!(of(&["cam1_a.png", "campus_1.png"]), video);
        assert_eq!(of(&["0001/cam0.png", "0002/cam0.png"]).0, [(0, 0), (1, 0)]);
    }
}
