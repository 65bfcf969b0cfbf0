//! Trains on a capture folder without the engine: `train_folder CAPTURE OUT [key=value …]`, keys as in a recipe's
//! `params` (`method=static3dgs schedule_scale=0.1 density.until=500`). Prints the curve and the milliseconds of each
//! activity.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, bail};
use engine::ParamProblem;
use scene::{Capture, Split, image_file};
use serde_json::{Map, Value};
use shaders::arrays::bytes::to_bytes;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Device;
use training::{Dataset, NOTHING, Player, Trained, TrainingParams, Watch, psnr, resolve_for, train};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [capture, out, overrides @ ..] = &args[..] else { bail!("usage: train_folder CAPTURE OUT [key=value …]") };
    let capture = Capture::open(Path::new(capture))?;
    let problem = |problems: Vec<ParamProblem>| anyhow::anyhow!("{}: {}", problems[0].key, problems[0].message);
    let params = resolve_for(parse(overrides)?, &capture).map_err(problem)?;
    std::fs::create_dir_all(out)?;
    let checkpoints = Path::new(out).join("checkpoint");
    std::fs::create_dir_all(&checkpoints)?;
    let (stop, on_progress) = (&AtomicBool::new(false), &|_| ());
    let watch = Watch { stop, pause_at: None, on_progress, checkpoint_dir: &checkpoints, device: Device::Cpu };
    let trained = train(capture.clone(), &NOTHING, &params, None, &watch)?;
    let Trained { model, report, .. } = trained.context("the stop flag is never set")?;
    model.save(Path::new(out))?;

    for point in &report.curve {
        let (seconds, iteration, n) = (point.seconds, point.iteration, point.n_gaussians);
        println!("{seconds:8.2} s  {iteration:6}  {n:7} Gaussians  {:6.2} dB  loss {:.5}", point.psnr_val, point.loss);
    }
    println!("{:.1} ms per iteration, {:.1} s", report.ms_per_iteration, report.training_secs);
    for (name, secs) in &report.phases {
        println!("  {name:12} {:7.2} ms per iteration", 1e3 * secs / model_steps(&model));
    }
    for (name, [forward, backward]) in &report.kernels_ms {
        println!("  {name:24} {forward:7.3} ms forward {backward:7.3} ms backward");
    }
    test_views(&model, capture, Path::new(out))
}

fn model_steps(model: &training::Model) -> f64 {
    model.header.iterations.iter().map(|(_, steps)| *steps as f64).sum()
}

/// Renders the test views into `out/images` and prints their mean PSNR.
fn test_views(model: &training::Model, mut capture: Capture, out: &Path) -> anyhow::Result<()> {
    let player = Player::new(model)?;
    capture.views.retain(|view| view.split == Split::Test);
    capture.views.iter_mut().for_each(|view| view.split = Split::Train);
    let truth = Dataset::load(capture.clone(), 1)?;
    std::fs::create_dir_all(out.join("images"))?;
    let mut sum = 0.0;
    for (view, truth) in capture.views.iter().zip(&truth.train) {
        let color = player.render(view.time_secs, &PinholeCamera::from(&view.camera))?;
        let bytes = to_bytes(&color).values;
        sum += psnr(&bytes, &truth.pixels);
        let (width, height) = (view.camera.intrinsics.width, view.camera.intrinsics.height);
        let image = image::RgbImage::from_raw(width, height, bytes).context("image size")?;
        image_file::write_rgb(&out.join("images").join(format!("{}.png", view.name)), &image)?;
    }
    println!("test PSNR {:.2} dB over {} views", sum / capture.views.len() as f64, capture.views.len());
    Ok(())
}

/// `a.b=value` pairs as nested tables. A value that is not JSON is a string.
fn parse(overrides: &[String]) -> anyhow::Result<TrainingParams> {
    let mut table = Map::new();
    for item in overrides {
        let (key, value) = item.split_once('=').with_context(|| format!("{item} is not key=value"))?;
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.into()));
        let mut at = &mut table;
        let mut parts: Vec<&str> = key.split('.').collect();
        let last = parts.pop().unwrap_or_default();
        for part in parts {
            at = at.entry(part).or_insert_with(|| Map::new().into()).as_object_mut().context("not a table")?;
        }
        at.insert(last.into(), value);
    }
    Ok(serde_json::from_value(Value::Object(table))?)
}
