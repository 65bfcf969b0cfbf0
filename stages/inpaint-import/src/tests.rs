//! A square flies in front of a scene at rest; behind it lies what the capture showed before the square was painted in.

use std::path::Path;

use depth_flow_import::Priors;
use depth_flow_import::params::DepthKind;
use engine::{Artifact as _, Coordinates, Facts, InputRecord, JobContext, PlanContext, Stage as _};
use layer_split::{Layers, Mask};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use scene::image_file::{self, Rgb};
use scene::{Capture, CaptureInfo, CaptureWriter, FloatImage, Frame, ResizeFilter, Split, View, facts};
use scene_synthesis::{Background as Behind, CameraPath, Params as Scene, SceneKind, Truth};
use tempfile::TempDir;

use crate::params::FillSource;
use crate::{Background, FilledView, InpaintImport, Params};

const SIZE: u32 = 96;
/// Side of the square.
const SIDE: usize = 18;
const SQUARE_COLOR: [u8; 3] = [255, 0, 255];

/// A capture at rest, the same with a square in front, and the square's masks.
struct Painted {
    _dir: TempDir,
    original: Capture,
    capture: Capture,
    layers: std::path::PathBuf,
}

impl Painted {
    /// `corner` gives the column and row of the square in each frame.
    fn new(camera: CameraPath, behind: Behind, depth: bool, corner: impl Fn(usize) -> (usize, usize)) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut truths = vec![Truth::Alpha];
        truths.extend(depth.then_some(Truth::Depth));
        let params = Scene {
            scene: SceneKind::StaticBlocks,
            camera,
            width: SIZE,
            height: SIZE,
            frames: 9,
            rig_cameras: 1,
            val_views: 0,
            test_views: 1,
            samples_per_pixel: 4,
            background: behind,
            truths: truths.into_iter().collect(),
            ..Scene::default()
        };
        let original = scene_synthesis::synthesize(&params, &dir.path().join("original"), 2, |_, _| Ok(())).unwrap();
        let writer = CaptureWriter::create(&dir.path().join("capture"), info(&original)).unwrap();
        let layers = dir.path().join("layers");
        let mut masks = Vec::new();
        for view in &original.views {
            let mask = square(corner(view.frame_index as usize));
            let mut frame = frame(&original, view);
            for at in (0..mask.inside.len()).filter(|at| mask.inside[*at]) {
                let (x, y) = (at as u32 % SIZE, at as u32 / SIZE);
                frame.image.put_pixel(x, y, Rgb(SQUARE_COLOR));
                frame.alpha.as_mut().unwrap().get_pixel_mut(x, y).0 = [255];
                frame.depth.iter_mut().for_each(|depth| depth.depth_view[at] = 1.0);
            }
            writer.write_view(&frame).unwrap();
            masks.push(Layers::write_view(&layers, &view.name, (SIZE, SIZE), Some(&mask.to_labels())).unwrap());
        }
        Layers::save(&layers, "files", masks).unwrap();
        Self { capture: writer.finish().unwrap(), original, layers, _dir: dir }
    }

    fn run(
        &self,
        priors: Option<&Path>,
        folders: [&Path; 2],
        params: &Params,
    ) -> anyhow::Result<(TempDir, Background)> {
        let root = tempfile::tempdir()?;
        let mut context = JobContext::detached(root.path())?;
        context.inputs.insert("capture".into(), input(&self.capture.dir));
        context.inputs.insert("layers".into(), input(&self.layers));
        context.inputs.insert("priors".into(), priors.map(input).unwrap_or_default());
        context.sources.insert("folder".into(), folders[0].into());
        context.sources.insert("depth_folder".into(), folders[1].into());
        InpaintImport::run(&context, params)?.check()?;
        let background = Background::open(&root.path().join("output"))?;
        background.check()?;
        background.check_against(&self.capture)?;
        let measured = context.measurements.borrow()["unfilled_share"].as_f64();
        assert_eq!(measured, Some(background.unfilled_share()));
        Ok((root, background))
    }

    /// Every training view with its filled version and the mask of its square.
    fn filled<'a>(&'a self, background: &'a Background) -> impl Iterator<Item = (&'a View, FilledView, Mask)> {
        let layers = Layers::open(&self.layers).unwrap();
        self.original.views_of(Split::Train).map(move |(index, view)| {
            let mask = Mask::from(&layers.load_moving(index).unwrap().unwrap());
            (view, background.load_view(index).unwrap().unwrap(), mask)
        })
    }

    /// Root mean square error of the filled pixels in grey levels, their largest relative depth error, and the share of
    /// the square's pixels that are not filled.
    fn errors(&self, background: &Background) -> (f64, f64, f64) {
        let (mut squares, mut count, mut unfilled, mut depth_errors) = (0.0, 0.0, 0.0, Vec::new());
        for (view, filled, mask) in self.filled(background) {
            let truth = self.original.load_image(view).unwrap();
            let truth_depth = self.original.load_depth(view).unwrap();
            for (at, (found, truth)) in filled.image.pixels().zip(truth.pixels()).enumerate() {
                if filled.unfilled.labels[at] != 0 {
                    assert!(mask.dilated(9).inside[at], "only what moves can be unfilled");
                    unfilled += f64::from(u8::from(mask.inside[at]));
                    continue;
                }
                if !mask.inside[at] {
                    continue;
                }
                let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
                squares += found.0.iter().zip(&truth.0).map(square).sum::<f64>() / 3.0;
                count += 1.0;
                if let (Some(found), Some(truth)) = (&filled.depth, &truth_depth) {
                    let (found, truth) = (found.depth_view[at], truth.depth_view[at]);
                    let error = if truth == found { 0.0 } else { f64::from((found / truth - 1.0).abs()) };
                    depth_errors.push(error);
                }
            }
        }
        depth_errors.sort_by(f64::total_cmp);
        let worst_but_few = depth_errors.get(depth_errors.len() * 95 / 100).copied().unwrap_or(0.0);
        ((squares / count).sqrt(), worst_but_few, unfilled / (unfilled + count))
    }
}

fn info(capture: &Capture) -> CaptureInfo {
    CaptureInfo {
        name: capture.name.clone(),
        pose_source: capture.pose_source.clone(),
        protocol: capture.protocol.clone(),
        background: capture.background,
        time_map: capture.time_map,
        class_names: capture.class_names.clone(),
        bounds_world: capture.bounds_world,
    }
}

fn frame(capture: &Capture, view: &View) -> Frame {
    Frame {
        name: view.name.clone(),
        split: view.split,
        camera: view.camera,
        camera_index: view.camera_index,
        frame_index: view.frame_index,
        time_secs: view.time_secs,
        image: capture.load_image(view).unwrap(),
        alpha: capture.load_alpha(view).unwrap(),
        depth: capture.load_depth(view).unwrap(),
        flow: None,
        mask: None,
        velocity: None,
    }
}

fn square((left, top): (usize, usize)) -> Mask {
    let mut mask = Mask::empty(SIZE, SIZE);
    for (y, x) in (top..top + SIDE).flat_map(|y| (left..left + SIDE).map(move |x| (y, x))) {
        mask.inside[y * SIZE as usize + x] = true;
    }
    mask
}

fn input(dir: &Path) -> Vec<InputRecord> {
    vec![InputRecord {
        producer: "test".into(),
        coordinates: Coordinates::new(),
        artifact: Ok(dir.into()),
        measurements: serde_json::Value::Null,
        action_key: String::new(),
    }]
}

const NO_FOLDERS: [&str; 2] = ["", ""];

fn no_folders() -> [&'static Path; 2] {
    NO_FOLDERS.map(Path::new)
}

/// The square crosses the image.
fn crossing(frame: usize) -> (usize, usize) {
    (6 + 8 * frame, 40)
}

#[test]
fn a_camera_at_rest_sees_everything_sooner_or_later() {
    let painted = Painted::new(CameraPath::Rig, Behind::White, false, crossing);
    let (_root, background) = painted.run(None, no_folders(), &Params::default()).unwrap();
    assert_eq!(painted.errors(&background), (0.0, 0.0, 0.0), "no resampling, no guess");
    assert_eq!(background.source, "propagate");
    let held_out: Vec<_> = painted.capture.views_of(Split::Test).map(|(index, _)| index).collect();
    assert!(held_out.iter().all(|index| background.load_view(*index).unwrap().is_none()));
}

#[test]
fn what_is_never_seen_stays_unfilled_and_is_counted() {
    let painted = Painted::new(CameraPath::Rig, Behind::White, false, |_| (30, 40));
    let params = Params { margin_px: 0, ..Params::default() };
    let (_root, background) = painted.run(None, no_folders(), &params).unwrap();
    let expected = (SIDE * SIDE) as f64 / f64::from(SIZE * SIZE);
    assert!((background.unfilled_share() - expected).abs() <= 1e-12, "{}", background.unfilled_share());
    for (_, filled, mask) in painted.filled(&background) {
        assert_eq!(Mask::from(&filled.unfilled), mask);
        let inside = filled.image.pixels().zip(&mask.inside).filter(|(_, inside)| **inside);
        assert!(inside.into_iter().all(|(pixel, _)| pixel.0 == [255; 3]), "nothing of what moves is left");
    }
}

#[test]
fn a_moving_camera_sees_behind_what_moves() {
    for behind in [Behind::White, Behind::None] {
        let painted = Painted::new(CameraPath::Arc, behind, true, crossing);
        let (_root, background) = painted.run(None, no_folders(), &Params::default()).unwrap();
        let (error, depth_error, unfilled) = painted.errors(&background);
        eprintln!("{behind:?}: {error:.2} grey levels, depth {depth_error:.4}, unfilled {unfilled:.4}");
        // Errors lie at the edges of textures and bodies, which no two views sample alike.
        assert!(error <= 15.0, "{behind:?}: {error}");
        assert!(depth_error <= 0.02, "{behind:?}: {depth_error}");
        // What the square hides in every frame that could show it.
        assert!(unfilled <= 0.25, "{behind:?}: {unfilled}");
    }
}

#[test]
fn wrong_depth_does_not_pass() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, true, crossing);
    let dir = tempfile::tempdir().unwrap();
    let wrong = |(at, view): (usize, &View)| {
        let mut depth = painted.capture.load_depth(view).unwrap();
        // Each view in another scale.
        let factor = if at.is_multiple_of(2) { 0.8 } else { 1.2 };
        depth.iter_mut().flat_map(|map| &mut map.depth_view).for_each(|z| *z *= factor);
        let maps = depth_flow_import::ViewMaps { depth, ..Default::default() };
        Priors::write_view(dir.path(), &view.name, view.camera, &maps).unwrap()
    };
    let views = painted.capture.views.iter().enumerate().map(wrong).collect();
    Priors::save(dir.path(), "files", views).unwrap();
    let (_root, background) = painted.run(Some(dir.path()), no_folders(), &Params::default()).unwrap();
    let (error, depth_error, unfilled) = painted.errors(&background);
    eprintln!("inconsistent depth: {error:.2} grey levels, depth {depth_error:.4}, unfilled {unfilled:.4}");
    assert!(depth_error > 0.1 || unfilled > 0.5, "the oracle would accept {depth_error} {unfilled}");
}

fn files() -> Params {
    Params { source: FillSource::Files, folder: "frames".into(), ..Params::default() }
}

/// Writes the original images as an inpainter would: at another size, and nowhere exact.
fn write_frames(painted: &Painted, dir: &Path) {
    for (_, view) in painted.original.views_of(Split::Train) {
        let image = FloatImage::from_rgb(&painted.original.load_image(view).unwrap());
        let image = image.resized(104, 104, ResizeFilter::Lanczos3).to_rgb8().unwrap();
        image_file::write_rgb(&dir.join(format!("{}.png", view.name)), &image).unwrap();
    }
}

#[test]
fn inpainted_frames_are_pasted_only_where_something_moves() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, false, crossing);
    let frames = tempfile::tempdir().unwrap();
    let refused = painted.run(None, [frames.path(), Path::new("")], &files()).err().unwrap();
    assert!(format!("{refused:#}").contains("9 views have no file here"), "{refused:#}");
    write_frames(&painted, frames.path());
    let (_root, background) = painted.run(None, [frames.path(), Path::new("")], &files()).unwrap();
    let (error, _, unfilled) = painted.errors(&background);
    assert!(error <= 8.0 && unfilled == 0.0, "{error} {unfilled}");
    for (view, filled, mask) in painted.filled(&background) {
        let truth = painted.original.load_image(view).unwrap();
        let margin = mask.dilated(files().margin_px);
        let outside = filled.image.pixels().zip(truth.pixels()).zip(&margin.inside).filter(|(_, inside)| !**inside);
        assert!(outside.into_iter().all(|((found, truth), _)| found == truth), "{}", view.name);
    }
}

#[test]
fn inpainted_depth_continues_that_of_the_view() {
    let painted = Painted::new(CameraPath::Arc, Behind::None, true, crossing);
    let (frames, depths) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    write_frames(&painted, frames.path());
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let mut write = |value: &dyn Fn(f32) -> f32, wrong_share: f32| {
        for (_, view) in painted.original.views_of(Split::Train) {
            let depth = painted.original.load_depth(view).unwrap().unwrap();
            let layers = Layers::open(&painted.layers).unwrap();
            let index = painted.capture.views.iter().position(|other| other.name == view.name).unwrap();
            let mask = Mask::from(&layers.load_moving(index).unwrap().unwrap()).dilated(2);
            // Wrong values on the ring only: inside nothing could tell.
            let mut pixel = |(at, z): (usize, &f32)| {
                let is_wrong = !mask.inside[at] && random.random::<f32>() < wrong_share;
                if is_wrong { 5.0 * random.random::<f32>() } else { value(*z) }
            };
            let values = depth.depth_view.iter().enumerate().map(&mut pixel).collect();
            let path = depths.path().join(format!("{}.exr", view.name));
            scene::exr_file::write(&path, SIZE, SIZE, &[("Z", values)]).unwrap();
        }
    };
    write(&|z| 3.0 / z + 0.2, 0.3);
    let params = Params { depth_folder: Some("depth".into()), depth_kind: DepthKind::InverseDepth, ..files() };
    let (_root, background) = painted.run(None, [frames.path(), depths.path()], &params).unwrap();
    let (_, depth_error, _) = painted.errors(&background);
    assert!(depth_error <= 0.01, "{depth_error}");
    // Planted fault: depth that was declared inverse depth.
    write(&|z| z, 0.0);
    let refused = painted.run(None, [frames.path(), depths.path()], &params).err().unwrap();
    assert!(format!("{refused:#}").contains("does not continue that of the view"), "{refused:#}");
}

#[test]
fn depth_is_told_and_priors_are_read_where_depth_is_used() {
    let told = |params: &Params, wired: bool| {
        let depth = |has: bool| vec![Facts::default().with(facts::DEPTH, has)];
        let mut inputs: std::collections::BTreeMap<_, _> = [("capture".to_owned(), depth(false))].into();
        if wired {
            inputs.insert("priors".into(), depth(true));
        }
        let context = PlanContext { data_root: Path::new(""), inputs };
        let resolution = InpaintImport::resolve(params.clone(), &context).unwrap();
        (InpaintImport::facts(params, &context).flag(facts::DEPTH), resolution.unread.contains("priors"))
    };
    assert_eq!(told(&Params::default(), true), (Some(true), false));
    assert_eq!(told(&Params::default(), false), (Some(false), false));
    assert_eq!(told(&files(), true), (Some(false), true));
    let with_depth = Params { depth_folder: Some("depth".into()), ..files() };
    assert_eq!(told(&with_depth, true), (Some(true), false));
}
