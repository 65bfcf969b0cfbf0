//! Export of a model to files that common viewers open: one PLY file in the layout of 3DGS per time, verified by reading
//! it back.

use std::fmt::Write as _;
use std::path::Path;

use engine::{Failure, FailureKind};
use scene::{Capture, Gaussians};
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{self, RasterSettings, SplatTensors};
use shaders::tape::Tensor;
use training::Player;

use crate::inputs::{create_folder, first_view, open_model, times_within};
use crate::prompts::{Prompt, Selection, Show};

/// Writes the Gaussians at each time (seconds of the capture, increasing) as `frame_0000.ply`, `frame_0001.ply`, …
///
/// Each file is read back and rendered at the first test camera, and the image is compared with the model's own. The
/// report has one line per file. A selection must edit the model; files and report then describe the edited model.
pub fn ply_sequence(
    model_dir: &Path,
    capture_dir: &Path,
    times: &[f64],
    selection: Option<&Selection<'_>>,
    out: &Path,
) -> anyhow::Result<String> {
    let model = open_model(model_dir)?;
    let capture = Capture::open(capture_dir)?;
    if let Some([time, next]) = times.array_windows().find(|[time, next]| time >= next) {
        let message = format!("times must increase, but {next} s follows {time} s");
        let hint = "give them as FIRST:LAST:COUNT with FIRST below LAST, e.g. 0:1:30";
        return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
    }
    let times = times_within(times, &capture)?;
    let camera = PinholeCamera::from(&first_view(&capture)?.camera);
    let mut player = Player::new(&model)?;
    let mut report = String::new();
    if let Some(selection) = selection {
        let Show::Edit(edit) = selection.show else {
            let failure = Failure::new(FailureKind::BadInput, "only edits can be exported, not highlights or masks");
            return Err(failure.hint("use --edit remove, keep or recolour=#rrggbb").into());
        };
        let prompt = Prompt::of(selection, &player, &model)?;
        report += &prompt.line(selection.prompt);
        player = prompt.edit(player, edit)?;
    }
    create_folder(out)?;

    for (index, time_secs) in times.into_iter().enumerate() {
        let path = out.join(format!("frame_{index:04}.ply"));
        player.gaussians(time_secs, &camera)?.write_ply(&path)?;
        let from_file = render_file(&path, &camera, &player.raster_settings())?;
        let psnr = psnr(&from_file, &player.render(time_secs, &camera)?);
        let agreement = if psnr.is_infinite() { "equal".into() } else { format!("{psnr:.2} dB") };
        writeln!(report, "{time_secs:.4} s  file against the model's own render: {agreement}  {}", path.display())?;
    }
    Ok(report)
}

/// Renders the Gaussians of a PLY file.
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

/// PSNR in dB of two images of equal shape, on unquantised colours clamped to [0, 1]; infinite for equal images.
fn psnr(a: &Tensor<f32>, b: &Tensor<f32>) -> f64 {
    let squared = |(&a, &b): (&f32, &f32)| (f64::from(a.clamp(0.0, 1.0)) - f64::from(b.clamp(0.0, 1.0))).powi(2);
    let sum: f64 = a.as_slice().iter().zip(b.as_slice()).map(squared).sum();
    -10.0 * (sum / a.len() as f64).log10()
}
