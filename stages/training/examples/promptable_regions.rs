//! How well words select what they mean: trains l4dgs on a capture with instance labels, whose classes stand for words,
//! and compares the region of every prompt with the labels of the test views: `promptable_regions CAPTURE [key=value …]`,
//! keys as in a recipe's `params`. Prints PSNR, and intersection over union per prompt, also over time.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use scene::{Capture, LabelMap, Split};
use serde_json::{Map, Value, json};
use shaders::splat::PinholeCamera;
use shaders::tape::Tensor;
use training::TrainingParams;
use training::curve::{psnr, to_bytes};
use training::dataset::Dataset;
use training::player::Player;
use training::run::{Watch, train};
use training::supplements::{FeatureTokens, Supplements, ViewPriors};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// A pixel is what a prompt means above this relevancy: more than any other prompt.
const RELEVANT: f32 = 0.5;

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (capture, overrides) = args.split_first().context("usage: promptable_regions CAPTURE [key=value …]")?;
    let capture = Capture::open(Path::new(capture))?;
    let supplements = supplements(&capture)?;
    let mut table = json!({ "method": "l4dgs" }).as_object().cloned().unwrap_or_default();
    for item in overrides {
        let (key, value) = item.split_once('=').with_context(|| format!("{item} is not key=value"))?;
        let value = serde_json::from_str(value).unwrap_or_else(|_| Value::String(value.into()));
        insert(&mut table, &key.split('.').collect::<Vec<_>>(), value);
    }
    let params = TrainingParams::from_table(table).map_err(anyhow::Error::msg)?;
    let checkpoints = tempfile::tempdir()?;
    let watch = Watch { stop: &AtomicBool::new(false), on_progress: &|_| (), checkpoint_dir: checkpoints.path() };
    let (model, report) =
        train(capture.clone(), &supplements, &params, None, &watch)?.context("nobody asked to stop")?;
    println!("{:.1} ms per iteration, {:.1} s, {:?}", report.ms_per_iteration, report.training_secs, report.phases);
    println!("left out: {:?}", report.skipped);
    evaluate(&Player::new(&model)?, &capture)
}

/// The capture's own depth, and the classes of its labels as visual tokens.
fn supplements(capture: &Capture) -> anyhow::Result<Supplements> {
    let classes = 1 + capture.class_names.len();
    let mut found = Supplements::default();
    let mut visual = Vec::new();
    for view in &capture.views {
        let is_train = view.split == Split::Train;
        let depth = if is_train { capture.load_depth(view)? } else { None };
        found.priors.push(ViewPriors { depth, ..ViewPriors::default() });
        let labels = if is_train { capture.load_mask(view)? } else { None };
        visual.push(labels.map(|labels| one_hot(&labels, classes)));
    }
    let text = Tensor::from_vec(
        [classes, classes],
        (0..classes * classes).map(|at| is(at / classes == at % classes)).collect(),
    );
    found.features = Some(FeatureTokens { visual, text, prompts: names(capture) });
    Ok(found)
}

/// "background" for label 0, then the class names.
fn names(capture: &Capture) -> Vec<String> {
    std::iter::once("background".to_string()).chain(capture.class_names.iter().cloned()).collect()
}

/// [H, W, classes].
fn one_hot(labels: &LabelMap, classes: usize) -> Tensor<f32> {
    let values = labels.labels.iter().flat_map(|&label| (0..classes).map(move |class| is(class == usize::from(label))));
    Tensor::from_vec([labels.height as usize, labels.width as usize, classes], values.collect())
}

fn is(condition: bool) -> f32 {
    f32::from(u8::from(condition))
}

/// Per test view in order of time: PSNR, and intersection over union of every prompt in sight.
fn evaluate(player: &Player, capture: &Capture) -> anyhow::Result<()> {
    let mut as_train = capture.clone();
    as_train.views.retain(|view| view.split == Split::Test);
    as_train.views.iter_mut().for_each(|view| view.split = Split::Train);
    let truth = Dataset::load(as_train, 1)?;
    let prompts = player.prompts().context("the model has no prompts")?;
    let names = names(capture);
    let mut views: Vec<_> = capture.views_of(Split::Test).zip(&truth.train).collect();
    views.sort_by(|a, b| a.0.1.time_secs.total_cmp(&b.0.1.time_secs));
    let mut psnr_sum = 0.0;
    let mut overlaps: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
    for ((_, view), truth) in &views {
        let camera = PinholeCamera::from(&view.camera);
        let found = psnr(&to_bytes(&player.render(view.time_secs, &camera)?), truth);
        psnr_sum += found;
        let labels = capture.load_mask(view)?.context("a test view without labels")?;
        let relevancy = player.prompt_relevancy(view.time_secs, &camera, &prompts)?.context("no visual tokens")?;
        print!("{:6.2} s  {found:6.2} dB ", view.time_secs);
        for (class, name) in names.iter().enumerate() {
            if let Some(overlap) = overlap(&labels, &relevancy, class) {
                print!("  {name} {overlap:.2}");
                overlaps[class].push(overlap);
            }
        }
        println!();
    }
    println!("test PSNR {:.2} dB over {} views", psnr_sum / views.len() as f64, views.len());
    for (name, overlaps) in names.iter().zip(&overlaps) {
        let mean = overlaps.iter().sum::<f64>() / overlaps.len() as f64;
        let least = overlaps.iter().copied().fold(f64::INFINITY, f64::min);
        println!("{name}: mean IoU {mean:.3}, least {least:.3}, {} views", overlaps.len());
    }
    Ok(())
}

/// Intersection over union of the pixels of a class and those where its prompt is relevant; none if the class is not in
/// sight.
fn overlap(labels: &LabelMap, relevancy: &Tensor<f32>, class: usize) -> Option<f64> {
    let classes = relevancy.shape()[2];
    let (mut both, mut either, mut visible) = (0, 0, false);
    for (&label, relevancy) in labels.labels.iter().zip(relevancy.as_slice().chunks_exact(classes)) {
        let (is_class, is_prompt) = (usize::from(label) == class, relevancy[class] > RELEVANT);
        visible |= is_class;
        both += usize::from(is_class && is_prompt);
        either += usize::from(is_class || is_prompt);
    }
    visible.then(|| both as f64 / either as f64)
}

/// Puts a value into nested tables.
fn insert(table: &mut Map<String, Value>, key: &[&str], value: Value) {
    match key {
        [] => (),
        [last] => drop(table.insert((*last).into(), value)),
        [first, rest @ ..] => {
            let nested = table.entry(*first).or_insert_with(|| Map::new().into());
            if let Some(nested) = nested.as_object_mut() {
                insert(nested, rest, value);
            }
        }
    }
}
