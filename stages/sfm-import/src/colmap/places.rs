//! Which camera took an image, and when: both follow from the names of the images, checked against poses where names alone
//! are ambiguous.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;
use scene::statistics::median;

use crate::colmap::model::{Model, RegisteredImage};
use crate::image_names::{are_decimals, sort_by_name, varying_number, without_extension};

/// Words that begin the name of a camera, the longest first.
const CAMERA_WORDS: [&str; 2] = ["camera", "cam"];
/// Largest distance between the images of a fixed camera, relative to the distance of the next camera: poses that structure
/// from motion estimates for each image differ by less.
const FIXED: f64 = 0.1;
/// Symbols between a camera and an instant.
const SEPARATORS: [char; 3] = ['_', '-', '.'];

const FOLDERS_ARE_INSTANTS: &str = "folders of images are read as instants, and their files as cameras";
const RANKED: &str = "each folder of images is read as a camera, and their files have different names: the first files of all \
                      folders are taken as one instant, and so on";
const SAME_NAMES: &str = "each folder of images is read as a camera, and files with one name as one instant; if the folders are clips \
                          that one camera recorded one after the other, give no two files the same number";
const ONE_VIDEO: &str = "the folders of images are read as parts of one video, because all images are from one COLMAP camera, and no two \
                         have the same number; if each folder is a camera, give the images of one instant the same name";
const CAMERAS_BEGIN: &str = "the images are read as frames of the cameras that begin their names";
const CAMERAS_END: &str = "the images are read as frames of the cameras that end their names";
const REPEATED: &str = "numbers that end the names repeat, e.g. a_0001.png and b_0001.png: all images are read as successive \
                        frames of one camera; if the beginnings are cameras that film at the same time, let them start with cam \
                        and a number (cam0_0001.png) in the folder and in the model";
/// More beginnings of names than this are unlikely to be cameras.
const MOST_CAMERAS: usize = 30;

/// The cameras and frame numbers of all images of a model.
pub(super) struct Places<'a> {
    /// The camera and the frame number of every image, by name.
    pub(super) of: ByName<'a>,
    /// How names were read, if not by the rule that a folder is a camera.
    pub(super) note: Option<&'static str>,
    /// The camera that moves, if all others are fixed.
    pub(super) moving: Option<u32>,
}

/// Where the registered images of a camera were taken.
struct Registered {
    /// Their COLMAP cameras.
    ids: BTreeSet<u32>,
    /// The mean of their centres.
    mean: DVec3,
    /// The distances of their centres from the mean.
    from_mean: Vec<f64>,
}

/// Cameras and frame numbers by name.
type ByName<'a> = BTreeMap<&'a str, (u32, u32)>;
/// The registered images of each camera, without cameras that have none.
type Cameras = BTreeMap<u32, Registered>;
/// Splits a name into a camera and an instant; `None` if it does not have this form.
type Form = for<'a> fn(&'a str) -> Option<(&'a str, &'a str)>;

/// Numbers cameras and frames of the images of the model and of those in `present`. Names like `0001/cam02.png` and
/// `cam02_0001.png` state both if all images have this form; instants are then ranked over all cameras. Names like
/// `0001/left.png`, `left_0001.png` and `0001_left.png` do so if the model agrees that these are cameras, and not the folders.
/// Otherwise each folder is a camera. If most folders have most of the file names, a frame's number is the rank of its name among
/// those of all folders, so that an image that a folder lacks leaves a gap; otherwise it is its rank in its folder, or in the
/// [one video](one_video) of all folders. Decimal numbers are no pairs of a camera and an instant.
pub(super) fn places<'a>(present: impl Iterator<Item = &'a str>, model: &'a Model) -> Places<'a> {
    let names: BTreeSet<&str> = present.chain(model.images.values().map(|image| image.name.as_str())).collect();
    let by_words: [(Form, &str); 2] = [(instant_of_cameras, FOLDERS_ARE_INSTANTS), (camera_prefix, CAMERAS_BEGIN)];
    let by_model: [(Form, &str); 3] =
        [(instant_of_files, FOLDERS_ARE_INSTANTS), (prefix, CAMERAS_BEGIN), (suffix, CAMERAS_END)];
    let with_cameras = |of: ByName<'a>| {
        let cameras = by_camera(&of, model);
        (of, cameras)
    };
    let stated = by_words.into_iter().find_map(|(form, note)| Some((with_cameras(by_form(&names, form)?), Some(note))));
    let of_folders = by_form(&names, folder_of_camera).filter(is_grid).map(with_cameras);
    let are_folders = of_folders.as_ref().is_some_and(|(_, cameras)| are_cameras(cameras));
    let is_ruled_out = are_folders || are_decimals(names.iter().copied());
    let agreed = || {
        let of_form = |(form, note)| Some((with_cameras(by_form(&names, form)?), Some(note)));
        let mut found = by_model.into_iter().filter(|_| !is_ruled_out).filter_map(of_form);
        found.find(|((of, cameras), _)| is_grid(of) && are_cameras(cameras) || moving(of, cameras).is_some())
    };
    let ((of, cameras), note) = match (stated.or_else(agreed), of_folders) {
        (Some(read), _) => read,
        (None, Some(read)) => {
            let is_known = are_folders || are_named(&names) || moving(&read.0, &read.1).is_some();
            (read, (!is_known).then_some(SAME_NAMES))
        }
        (None, None) => {
            let (of, note) = by_rank_in_folder(&names);
            let ranked = with_cameras(of);
            let is_known = are_cameras(&ranked.1) || are_named(&names);
            match one_video(&names, model).filter(|_| !is_known) {
                Some(of) => (with_cameras(of), Some(ONE_VIDEO)),
                None => (ranked, note),
            }
        }
    };
    let moving = moving(&of, &cameras);
    Places { of, note, moving }
}

/// The places by a form that all names have, with several cameras and instants.
fn by_form<'a>(names: &BTreeSet<&'a str>, form: Form) -> Option<ByName<'a>> {
    let stated = names.iter().map(|name| Some((*name, form(name)?))).collect::<Option<Vec<_>>>()?;
    let cameras = ranks(stated.iter().map(|(_, (camera, _))| *camera));
    let instants = ranks(stated.iter().map(|(_, (_, instant))| *instant));
    let distinct: BTreeSet<_> = stated.iter().map(|(_, place)| place).collect();
    let is_rig = cameras.len() > 1 && instants.len() > 1 && distinct.len() == names.len();
    is_rig.then(|| stated.into_iter().map(|(name, (camera, at))| (name, (cameras[camera], instants[at]))).collect())
}

/// Whether the folders of all images are named like cameras.
fn are_named(names: &BTreeSet<&str>) -> bool {
    let folder = |name: &&str| Some(name.rsplit_once('/')?.0.rsplit('/').next()?.to_owned());
    names.iter().all(|name| folder(name).is_some_and(|folder| after_camera(&folder) == Some("")))
}

/// The frames of one video whose files are spread over several folders, e.g. `train/0001.png` and `test/0000.png`, in the order of the
/// numbers in their names.
fn one_video<'a>(names: &BTreeSet<&'a str>, model: &Model) -> Option<ByName<'a>> {
    let split: Vec<(&str, &str)> = names.iter().map(|name| name.rsplit_once('/')).collect::<Option<_>>()?;
    let folders: BTreeSet<&str> = split.iter().map(|(folder, _)| *folder).collect();
    let cameras: BTreeSet<u32> = model.images.values().map(|image| image.camera_id).collect();
    let files: Vec<&str> = split.iter().map(|(_, file)| *file).collect();
    let mut numbered: Vec<(f64, &str)> = varying_number(&files)?.into_iter().zip(names.iter().copied()).collect();
    numbered.sort_by(|a, b| a.0.total_cmp(&b.0));
    let is_one = folders.len() > 1 && cameras.len() == 1 && numbered.windows(2).all(|pair| pair[0].0 < pair[1].0);
    is_one.then(|| numbered.into_iter().zip(0..).map(|((_, name), frame)| (name, (0, frame))).collect())
}

/// Whether there are images for more than half of the pairs of a camera and an instant.
fn is_grid(of: &ByName<'_>) -> bool {
    let cameras: BTreeSet<u32> = of.values().map(|(camera, _)| *camera).collect();
    let instants: BTreeSet<u32> = of.values().map(|(_, instant)| *instant).collect();
    2 * of.len() > cameras.len() * instants.len()
}

/// The registered images of each camera.
fn by_camera(of: &ByName<'_>, model: &Model) -> Cameras {
    let mut cameras: BTreeMap<u32, Vec<&RegisteredImage>> = BTreeMap::new();
    for image in model.images.values() {
        cameras.entry(of[image.name.as_str()].0).or_default().push(image);
    }
    cameras.into_iter().map(|(camera, images)| (camera, Registered::of(&images))).collect()
}

impl Registered {
    fn of(images: &[&RegisteredImage]) -> Self {
        let centers: Vec<DVec3> = images.iter().map(|image| image.camera_from_world().inverse().translation).collect();
        // Relative to the first, the mean of equal centres is exact.
        let mean = centers[0] + centers.iter().map(|center| center - centers[0]).sum::<DVec3>() / centers.len() as f64;
        let from_mean = centers.iter().map(|center| center.distance(mean)).collect();
        Self { ids: images.iter().map(|image| image.camera_id).collect(), mean, from_mean }
    }
}

fn are_cameras(cameras: &Cameras) -> bool {
    have_own_intrinsics(cameras) || are_fixed(cameras)
}

/// Whether the images of each camera share a COLMAP camera, which is not that of all images.
fn have_own_intrinsics(cameras: &Cameras) -> bool {
    let ids: BTreeSet<&BTreeSet<u32>> = cameras.values().map(|images| &images.ids).collect();
    ids.len() > 1 && ids.iter().all(|ids| ids.len() == 1)
}

/// Whether the images of a camera are much nearer to each other than to those of the next camera, by medians.
fn are_fixed(cameras: &Cameras) -> bool {
    let within = cameras.values().filter(|images| images.from_mean.len() > 1).flat_map(|images| &images.from_mean);
    match (median(within.copied()), to_next(cameras)) {
        (Some(within), Some(between)) => within < FIXED * between,
        _ => false,
    }
}

/// The median distance of a camera to the next one; infinite for a single camera.
fn to_next(cameras: &Cameras) -> Option<f64> {
    let means: Vec<DVec3> = cameras.values().map(|images| images.mean).collect();
    let next = |at: usize| {
        let others = means.iter().enumerate().filter(|(other, _)| *other != at);
        others.map(|(_, mean)| mean.distance(means[at])).fold(f64::INFINITY, f64::min)
    };
    median((0..means.len()).map(next))
}

/// The camera that moves, if the others are fixed and film only at its instants, as in captures of DyCheck (Gao et al. 2022): the
/// images of each other camera are much nearer to each other than those of this one, which moves farther than the images of a
/// fixed camera differ ([`are_fixed`]).
fn moving(of: &ByName<'_>, cameras: &Cameras) -> Option<u32> {
    let extents: BTreeMap<u32, f64> = cameras
        .iter()
        .map(|(camera, images)| Some((*camera, median(images.from_mean.iter().copied())?)))
        .collect::<Option<_>>()?;
    let (&moving, widest) = extents.iter().max_by(|a, b| a.1.total_cmp(b.1))?;
    let is_fixed = |(camera, extent): (&u32, &f64)| cameras[camera].from_mean.len() > 1 && *extent < FIXED * widest;
    let are_others_fixed = extents.iter().filter(|(camera, _)| **camera != moving).all(is_fixed);
    let leaves_its_place = *widest > FIXED * to_next(cameras)?;
    (leaves_its_place && are_others_fixed && has_all_instants(of, moving)).then_some(moving)
}

/// Whether a camera has images of all instants.
fn has_all_instants(of: &ByName<'_>, camera: u32) -> bool {
    let all: BTreeSet<u32> = of.values().map(|(_, instant)| *instant).collect();
    let own: BTreeSet<u32> = of.values().filter(|(other, _)| *other == camera).map(|(_, instant)| *instant).collect();
    own.len() == all.len()
}

/// Whether the beginnings of names may be cameras, because one of few has the numbers of all.
fn repeat_numbers(names: &BTreeSet<&str>) -> bool {
    let of = by_form(names, prefix).filter(|_| !are_decimals(names.iter().copied())).unwrap_or_default();
    let cameras: BTreeSet<u32> = of.values().map(|(camera, _)| *camera).collect();
    cameras.len() <= MOST_CAMERAS && cameras.into_iter().any(|camera| has_all_instants(&of, camera))
}

/// Each folder is a camera, and a frame's number is its rank in it. The second value is a warning.
fn by_rank_in_folder<'a>(names: &BTreeSet<&'a str>) -> (ByName<'a>, Option<&'static str>) {
    let mut folders: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for name in names {
        folders.entry(name.rsplit_once('/').map_or("", |(folder, _)| folder)).or_default().push(name);
    }
    let videos = folders.values().filter(|names| names.len() > 1).count();
    let is_repeated = || (folders.len() == 1 && repeat_numbers(names)).then_some(REPEATED);
    let note = (videos > 1).then_some(RANKED).or_else(is_repeated);
    let cameras = ranks(folders.keys().copied());
    let of_folder = |(folder, mut names): (&str, Vec<&'a str>)| {
        sort_by_name(&mut names, |name| name);
        let camera = cameras[folder];
        names.into_iter().zip(0..).map(move |(name, frame)| (name, (camera, frame)))
    };
    (folders.into_iter().flat_map(of_folder).collect(), note)
}

/// The rank of every distinct text in natural order.
fn ranks<'a>(texts: impl Iterator<Item = &'a str>) -> BTreeMap<&'a str, u32> {
    let distinct: BTreeSet<&str> = texts.collect();
    let mut sorted: Vec<&str> = distinct.into_iter().collect();
    sort_by_name(&mut sorted, |text| text);
    sorted.into_iter().zip(0..).collect()
}

/// `…/0001/cam02.png`: the camera is the file's name, the instant its folder.
fn instant_of_cameras(name: &str) -> Option<(&str, &str)> {
    let (folder, file) = without_extension(name).rsplit_once('/')?;
    (after_camera(file)?.is_empty() && ends_with_digit(folder)).then_some((file, folder))
}

/// `left/0001.png`: the camera is the folder.
fn folder_of_camera(name: &str) -> Option<(&str, &str)> {
    without_extension(name).rsplit_once('/')
}

/// `…/0001/left.png`: the same with any name of a file, unless the folder has the name of a camera.
fn instant_of_files(name: &str) -> Option<(&str, &str)> {
    let (folder, file) = without_extension(name).rsplit_once('/')?;
    let is_instant = |part: &str| after_camera(part).is_none() && part.contains(|symbol: char| symbol.is_ascii_digit());
    folder.split('/').any(is_instant).then_some((file, folder))
}

/// `left_0001.png`, possibly in a folder: the camera is the beginning of the name, the instant its end.
fn prefix(name: &str) -> Option<(&str, &str)> {
    without_extension(name).rsplit_once(SEPARATORS).filter(|(_, instant)| ends_with_digit(instant))
}

/// `0001_left.png`: the instant is the beginning of the name, the camera its end.
fn suffix(name: &str) -> Option<(&str, &str)> {
    let (instant, camera) = without_extension(name).rsplit_once(SEPARATORS)?;
    ends_with_digit(instant).then_some((camera, instant))
}

fn ends_with_digit(text: &str) -> bool {
    text.ends_with(|symbol: char| symbol.is_ascii_digit())
}

/// `cam02_0001.png`, possibly in a folder: the camera is the beginning of the file's name, the instant its end.
fn camera_prefix(name: &str) -> Option<(&str, &str)> {
    let stem = without_extension(name);
    let file = stem.rsplit_once('/').map_or(stem, |(_, file)| file);
    let rest = after_camera(file)?;
    let instant = rest.strip_prefix(SEPARATORS)?;
    ends_with_digit(instant).then(|| (&name[..stem.len() - rest.len()], instant))
}

/// The rest of a text that begins with a camera, e.g. `cam02`, `cam_02` or `Camera-2`.
pub(super) fn after_camera(text: &str) -> Option<&str> {
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
        of_model(names, &Model::default())
    }

    fn of_model(names: &[&str], model: &Model) -> (Vec<(u32, u32)>, bool) {
        let places = places(names.iter().copied(), model);
        (names.iter().map(|name| places.of[name]).collect(), places.note.is_some())
    }

    #[test]
    fn cameras_and_instants_follow_from_names() {
        let grid = vec![(0, 0), (1, 0), (0, 1), (1, 1)];
        assert_eq!(of(&["cam1/9.png", "cam2/9.png", "cam1/10.png", "cam2/10.png"]), (grid.clone(), false));
        assert_eq!(of(&["9/cam2.png", "9/cam10.png", "10/cam2.png", "10/cam10.png"]), (grid.clone(), true));
        assert_eq!(of(&["cam2_9.png", "cam10_9.png", "cam2_10.png", "cam10_10.png"]), (grid.clone(), true));
        assert_eq!(
            of(&["x/Camera_01-f9.png", "x/Camera_02-f9.png", "x/Camera_01-f10.png", "x/Camera_02-f10.png"]).0,
            grid
        );
    }

    /// Images with the ids of their cameras and the x coordinates of their centres.
    fn model(images: &[(&str, u32, f64)]) -> Model {
        let image = |(name, camera_id, x): &(&str, u32, f64)| RegisteredImage {
            name: (*name).to_owned(),
            camera_id: *camera_id,
            quaternion: [1.0, 0.0, 0.0, 0.0],
            translation: [-x, 0.0, 0.0],
            observations: Vec::new(),
        };
        Model { images: (0..).zip(images.iter().map(image)).collect(), ..Model::default() }
    }

    #[test]
    fn cameras_without_names_follow_from_poses_or_intrinsics() {
        let grid = vec![(0, 0), (1, 0), (0, 1), (1, 1)];
        let forms = [
            ["t9/a.png", "t9/b.png", "t10/a.png", "t10/b.png"],
            ["9/1.png", "9/2.png", "10/1.png", "10/2.png"],
            ["9/images/1.png", "9/images/2.png", "10/images/1.png", "10/images/2.png"],
            ["a_9.png", "b_9.png", "a_10.png", "b_10.png"],
            ["9-a.png", "9-b.png", "10-a.png", "10-b.png"],
        ];
        for [a, b, c, d] in forms {
            let names = [a, b, c, d];
            let fixed = model(&[(a, 1, 0.0), (b, 1, 1.0), (c, 1, 0.02), (d, 1, 0.97)]);
            assert_eq!(of_model(&names, &fixed), (grid.clone(), true), "{names:?}");
            let moving = model(&[(a, 1, 0.0), (b, 2, 1.0), (c, 1, 5.0), (d, 2, 6.0)]);
            assert_eq!(of_model(&names, &moving), (grid.clone(), true), "{names:?}");
            let unknown = model(&[(a, 1, 0.0), (b, 1, 1.0), (c, 1, 0.4), (d, 1, 1.4)]);
            let places = places(names.into_iter(), &unknown);
            let expected = match names[0] {
                "a_9.png" => Some(REPEATED),
                name => name.contains('/').then_some(SAME_NAMES),
            };
            assert_eq!(places.note, expected, "{names:?}");
        }
    }

    /// Names like those of DyCheck: camera 0 moves, and camera 1 films at every fourth of its instants.
    fn moving_and(fixed_x: impl Fn(f64) -> f64) -> (Vec<String>, Model) {
        let names = |camera: u32, step| (0..16).step_by(step).map(move |at| format!("{camera}_{at:05}.png"));
        let names: Vec<String> = names(0, 1).chain(names(1, 4)).collect();
        let x = |at: usize| if at < 16 { at as f64 } else { fixed_x(at as f64) };
        let images: Vec<_> = names.iter().enumerate().map(|(at, name)| (name.as_str(), 1, x(at))).collect();
        let model = model(&images);
        (names, model)
    }

    #[test]
    fn fixed_cameras_next_to_a_moving_one_follow_from_poses() {
        let (names, model) = moving_and(|at| 7.0 + 0.01 * at);
        let found = places(names.iter().map(String::as_str), &model);
        assert_eq!((found.moving, found.note), (Some(0), Some(CAMERAS_BEGIN)));
        assert_eq!(
            ["0_00012.png", "1_00012.png", "1_00004.png"].map(|name| found.of[name]),
            [(0, 12), (1, 12), (1, 4)]
        );
        let (names, model) = moving_and(|at| at - 8.0);
        let found = places(names.iter().map(String::as_str), &model);
        assert_eq!((found.moving, found.note), (None, Some(REPEATED)));
        assert_eq!(["0_00012.png", "1_00012.png"].map(|name| found.of[name]), [(0, 12), (0, 19)]);
    }

    /// Ten frames of each camera, in folders, at these places plus an offset by camera and frame.
    fn rig(places_x: &[f64], offset: impl Fn(usize, usize) -> f64) -> Option<u32> {
        let names: Vec<String> =
            (0..places_x.len()).flat_map(|camera| (0..10).map(move |at| format!("cam{camera:02}/{at}.png"))).collect();
        let x = |index: usize| places_x[index / 10] + offset(index / 10, index % 10);
        let images: Vec<_> = names.iter().enumerate().map(|(index, name)| (name.as_str(), 1, x(index))).collect();
        places(names.iter().map(String::as_str), &model(&images)).moving
    }

    #[test]
    fn fixed_rigs_have_no_moving_camera() {
        // Ten times 0.1 is not 1 in floating point.
        assert_eq!(rig(&[0.0, 0.1, 1.0], |_, _| 0.0), None, "equal poses");
        assert_eq!(rig(&[0.1, 0.1, 0.1], |_, _| 0.0), None, "one place");
        let metres: Vec<f64> = (0..10).map(|camera| 0.4 * f64::from(camera)).collect();
        let noise = |camera: usize, at: usize| 0.0005 * ((3 * camera + 7 * at) % 5) as f64;
        let bump = |camera: usize, at: usize| if camera == 4 && at >= 5 { 0.02 } else { 0.0 };
        assert_eq!(rig(&metres, |camera, at| noise(camera, at) + bump(camera, at)), None, "a bumped camera");
        let walk = |camera: usize, at: usize| if camera == 4 { 0.05 * at as f64 } else { 0.0 };
        assert_eq!(rig(&metres, |camera, at| noise(camera, at) + walk(camera, at)), Some(4), "a walk");
    }

    #[test]
    fn seconds_in_names_are_no_cameras() {
        let names = ["9.5.png", "9.75.png", "10.0.png", "10.25.png", "10.5.png", "10.75.png"];
        let video: Vec<(u32, u32)> = (0..6).map(|frame| (0, frame)).collect();
        assert_eq!(of(&names), (video, false));
    }

    #[test]
    fn folders_of_cameras_stay_cameras() {
        let names = ["1/8.png", "2/8.png", "1/9.png", "2/9.png"];
        let grid = vec![(0, 0), (1, 0), (0, 1), (1, 1)];
        let of = |images: [(u32, f64); 4]| {
            let images: Vec<_> = names.into_iter().zip(images).map(|(name, (id, x))| (name, id, x)).collect();
            of_model(&names, &model(&images))
        };
        assert_eq!(of([(1, 0.0), (1, 1.0), (1, 0.0), (1, 1.0)]), (grid.clone(), false), "fixed");
        assert_eq!(of([(1, 0.0), (2, 1.0), (1, 50.0), (2, 51.0)]), (grid.clone(), false), "with own intrinsics");
        assert_eq!(of([(1, 0.0), (1, 0.5), (1, 1.0), (1, 1.5)]), (grid.clone(), true), "a pair that moves, or clips");
        let names = ["cam1/8.png", "cam2/8.png", "cam1/9.png", "cam2/9.png"];
        let far = model(&[(names[0], 1, 0.0), (names[1], 1, 0.01), (names[2], 1, 5.0), (names[3], 1, 5.01)]);
        assert_eq!(of_model(&names, &far), (grid, false), "a pair that jumps");
    }

    #[test]
    fn folders_with_other_names_are_matched_by_rank() {
        let names = ["a/1.png", "a/2.png", "b/11.png", "b/12.png"];
        assert_eq!(of(&names), (vec![(0, 0), (0, 1), (1, 0), (1, 1)], true));
    }

    #[test]
    fn folders_of_one_camera_with_different_numbers_are_one_video() {
        let names = ["test/4.png", "test/9.png", "train/3.png", "train/5.png", "train/10.png"];
        let of = |ids: [u32; 5]| {
            let images: Vec<_> = names.into_iter().zip(ids).map(|(name, id)| (name, id, 0.0)).collect();
            places(names.into_iter(), &model(&images)).note
        };
        assert_eq!((of([1; 5]), of([1, 1, 2, 2, 2])), (Some(ONE_VIDEO), Some(RANKED)));
        let images: Vec<_> = names.iter().enumerate().map(|(at, name)| (*name, 1, at as f64)).collect();
        let fixed: Vec<_> =
            names.iter().map(|name| (*name, 1, f64::from(u8::from(name.starts_with("train"))))).collect();
        assert_eq!(places(names.into_iter(), &model(&fixed)).note, Some(RANKED));
        let places = of_model(&names, &model(&images)).0;
        assert_eq!(places, [(0, 1), (0, 3), (0, 0), (0, 2), (0, 4)]);
    }

    #[test]
    fn names_with_dates_are_not_a_rig() {
        let names = ["20240101_120001.jpg", "20240102_120009.jpg", "20240103_120020.jpg"];
        let model = model(&[(names[0], 1, 0.0), (names[1], 2, 1.0), (names[2], 3, 2.0)]);
        assert_eq!(of_model(&names, &model), (vec![(0, 0), (0, 1), (0, 2)], false));
    }

    #[test]
    fn an_image_that_a_camera_lacks_leaves_a_gap() {
        let places = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)];
        assert_eq!(of(&["cam0_1.png", "cam0_2.png", "cam0_3.png", "cam1_1.png", "cam1_3.png"]).0, places);
        assert_eq!(of(&["a/1.png", "a/2.png", "a/3.png", "b/1.png", "b/3.png"]), (places.into(), true));
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
