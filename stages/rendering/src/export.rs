//! A model as files that common viewers open: one 3DGS-layout PLY per time, proved by reading it back.

use std::fmt::Write as _;
use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context as _, bail, ensure};
use engine::{Artifact as _, Failure, FailureKind};
use scene::{Capture, Gaussians, Split};
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{self, RasterSettings, SplatTensors};
use shaders::tape::Tensor;
use training::{Model, Player};

/// Times may lie outside of the capture by this share of its duration, and count as its ends then: the rounding of a range
/// typed by hand with four digits.
const TIME_SLACK: f64 = 1e-4;

/// Writes the Gaussians at every time (seconds of the capture) as `frame_0000.ply`, …, reads each file back, renders it
/// at the first test camera and compares the image with the model's own; the report has a line per file.
pub fn ply_sequence(model_dir: &Path, capture_dir: &Path, times: &[f64], out: &Path) -> anyhow::Result<String> {
    let model = Model::open(model_dir)?;
    model.check().with_context(|| format!("not a valid model: {}", model_dir.display()))?;
    let capture = Capture::open(capture_dir)?;
    check_times(times, &capture)?;
    ensure!(times.windows(2).all(|pair| pair[0] < pair[1]), "times must increase");
    let view = capture.views_of(Split::Test).next().or_else(|| capture.views_of(Split::Train).next());
    let (_, view) = view.with_context(|| format!("no view to compare at: {}", capture_dir.display()))?;
    let camera = PinholeCamera::from(&view.camera);
    let player = Player::new(&model)?;
    make_folder(out)?;

    let mut report = String::new();
    let times = times.iter().map(|time| time.clamp(capture.time_map.start_secs, capture.time_map.end_secs));
    for (index, time_secs) in times.enumerate() {
        let path = out.join(format!("frame_{index:04}.ply"));
        player.gaussians(time_secs, &camera)?.write_ply(&path)?;
        let from_file = render_file(&path, &camera, &player.raster_settings())?;
        let psnr = psnr(&from_file, &player.render(time_secs, &camera)?);
        let agreement = if psnr.is_infinite() { "equal".into() } else { format!("{psnr:.2} dB") };
        writeln!(report, "{time_secs:.4} s  file against the model's own render: {agreement}  {}", path.display())?;
    }
    Ok(report)
}

/// Makes a folder for frames; refuses one with files, among which those of another sequence could stay.
pub(crate) fn make_folder(out: &Path) -> anyhow::Result<()> {
    let cannot = || format!("cannot make the folder {}", out.display());
    match std::fs::create_dir_all(out) {
        Err(error) if matches!(error.kind(), ErrorKind::AlreadyExists | ErrorKind::NotADirectory) => {
            let failure = Failure::new(FailureKind::BadInput, "this is no folder");
            return Err(failure.hint("name another one").at(out).into());
        }
        made => made.with_context(cannot)?,
    }
    if std::fs::read_dir(out).with_context(cannot)?.next().is_some() {
        let failure = Failure::new(FailureKind::BadInput, "the folder is not empty");
        return Err(failure.hint("name another one, or remove what is there").at(out).into());
    }
    Ok(())
}

/// At least one time, finite, within the capture.
pub(crate) fn check_times(times: &[f64], capture: &Capture) -> anyhow::Result<()> {
    let map = &capture.time_map;
    let slack = TIME_SLACK * (map.end_secs - map.start_secs).max(1.0);
    ensure!(!times.is_empty(), "no times to export; give some, as 0:1:30");
    for &time in times {
        if !(time >= map.start_secs - slack && time <= map.end_secs + slack) {
            bail!("time {time} s is outside of the capture, which lasts from {} to {} s", map.start_secs, map.end_secs);
        }
    }
    Ok(())
}

/// Renders what a PLY file holds.
fn render_file(path: &Path, camera: &PinholeCamera, settings: &RasterSettings) -> anyhow::Result<Tensor<f32>> {
    let gaussians = Gaussians::read_ply(path)?;
    gaussians.check()?;
    let settings = RasterSettings { sh_degree: gaussians.sh_degree, ..*settings };
    let (count, sh_count) = (gaussians.len(), gaussians.sh_count());
    let splats = SplatTensors {
        positions: Tensor::from_vec([count, 3], gaussians.positions),
        log_scales: Tensor::from_vec([count, 3], gaussians.log_scales),
        rotations: Tensor::from_vec([count, 4], gaussians.rotations),
        opacity_logits: Tensor::from_vec([count, 1], gaussians.opacity_logits),
        sh: Tensor::from_vec([count, sh_count, 3], gaussians.sh),
    };
    Ok(rasteriser::render_image(&splats, camera, &settings)?.color)
}

/// In dB, on unquantised colours in [0, 1]; infinite where they are equal.
fn psnr(a: &Tensor<f32>, b: &Tensor<f32>) -> f64 {
    let squared = |(&a, &b): (&f32, &f32)| (f64::from(a.clamp(0.0, 1.0)) - f64::from(b.clamp(0.0, 1.0))).powi(2);
    let sum: f64 = a.as_slice().iter().zip(b.as_slice()).map(squared).sum();
    -10.0 * (sum / a.len() as f64).log10()
}
