//! The stage on captures of a static scene with a moving square painted over it. The original images are the truth.

mod chain;
mod imported;
mod propagated;

use std::path::Path;

use engine::{Artifact as _, Coordinates, Facts, InputRecord, JobContext, PlanContext, Stage as _};
use layer_split::Layers;
use scene::image_file::{self, Rgb};
use scene::{Capture, CaptureInfo, CaptureWriter, Frame, Mask, Split, View, facts};
use scene_synthesis::{Background as Behind, CameraPath, Params as Scene, SceneKind, Truth};
use tempfile::TempDir;

use crate::params::FillSource;
use crate::{Background, FilledView, InpaintImport, Params};

const SIZE: u32 = 96;
/// Side length of the square in pixels.
const SIDE: usize = 18;
const SQUARE_COLOR: [u8; 3] = [255, 0, 255];

/// A static capture, a copy with a square painted over it, and the layers with the masks of the square.
struct Painted {
    _dir: TempDir,
    original: Capture,
    capture: Capture,
    layers: std::path::PathBuf,
}

impl Painted {
    /// `corner` maps a frame number to the column and row of the upper left corner of the square.
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

    /// Runs the stage with two threads on optional priors and the source folders of frames and depth.
    fn run(
        &self,
        priors: Option<&Path>,
        folders: [&Path; 2],
        params: &Params,
    ) -> anyhow::Result<(TempDir, Background)> {
        self.run_with(2, priors, folders, params)
    }

    fn run_with(
        &self,
        threads: usize,
        priors: Option<&Path>,
        folders: [&Path; 2],
        params: &Params,
    ) -> anyhow::Result<(TempDir, Background)> {
        let root = tempfile::tempdir()?;
        let mut context = JobContext::detached(root.path())?;
        context.threads = threads;
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

    /// Every training view with its filled version and the mask of the square.
    fn filled<'a>(&'a self, background: &'a Background) -> impl Iterator<Item = (&'a View, FilledView, Mask)> {
        let layers = Layers::open(&self.layers).unwrap();
        self.original.views_of(Split::Train).map(move |(index, view)| {
            let mask = Mask::from(&layers.load_moving(index).unwrap().unwrap());
            (view, background.load_view(index).unwrap().unwrap(), mask)
        })
    }

    /// Root mean square error of the filled pixels in grey levels, the 95th percentile of their relative depth errors,
    /// and the unfilled share of the pixels of the square.
    fn errors(&self, background: &Background) -> (f64, f64, f64) {
        let (mut squares, mut count, mut unfilled, mut depth_errors) = (0.0, 0.0, 0.0, Vec::new());
        for (view, filled, mask) in self.filled(background) {
            let truth = self.original.load_image(view).unwrap();
            let truth_depth = self.original.load_depth(view).unwrap();
            for (at, (found, truth)) in filled.image.pixels().zip(truth.pixels()).enumerate() {
                if filled.unfilled.labels[at] != 0 {
                    assert!(mask.dilated(9).inside[at], "only moving pixels can be unfilled");
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
        let percentile_95 = depth_errors.get(depth_errors.len() * 95 / 100).copied().unwrap_or(0.0);
        ((squares / count).sqrt(), percentile_95, unfilled / (unfilled + count))
    }
}

/// The description of a capture without its views.
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

/// A view with its pixels, without flow, mask and velocity.
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

/// The mask of a square with this upper left corner (column, row).
fn square((left, top): (usize, usize)) -> Mask {
    let mut mask = Mask::empty(SIZE, SIZE);
    for (y, x) in (top..top + SIDE).flat_map(|y| (left..left + SIDE).map(move |x| (y, x))) {
        mask.inside[y * SIZE as usize + x] = true;
    }
    mask
}

/// One producer whose artifact is in `dir`.
fn input(dir: &Path) -> Vec<InputRecord> {
    vec![InputRecord {
        producer: "test".into(),
        coordinates: Coordinates::new(),
        artifact: Ok(dir.into()),
        measurements: serde_json::Value::Null,
        action_key: String::new(),
    }]
}

fn no_folders() -> [&'static Path; 2] {
    ["", ""].map(Path::new)
}

/// A square that crosses the image.
fn crossing(frame: usize) -> (usize, usize) {
    (6 + 8 * frame, 40)
}

fn files() -> Params {
    Params { source: FillSource::Files, folder: "frames".into(), ..Params::default() }
}

#[test]
fn filled_images_have_depth_if_their_views_have_it() {
    let planned = |params: &Params, wired: bool| {
        let depth = |has: bool| vec![Facts::default().with(facts::DEPTH, has)];
        let mut inputs: std::collections::BTreeMap<_, _> = [("capture".to_owned(), depth(false))].into();
        if wired {
            inputs.insert("priors".into(), depth(true));
        }
        let context = PlanContext { data_root: Path::new(""), inputs };
        let resolution = InpaintImport::resolve(params.clone(), &context).unwrap();
        assert!(resolution.unread.is_empty(), "the depth of the priors is read");
        InpaintImport::facts(params, &context).flag(facts::DEPTH)
    };
    let with_depth = Params { depth_folder: Some("depth".into()), ..files() };
    for params in [Params::default(), files(), with_depth] {
        assert_eq!([true, false].map(|wired| planned(&params, wired)), [Some(true), Some(false)]);
    }
}
