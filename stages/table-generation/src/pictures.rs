//! Chooses the views that the page shows, and encodes their images small enough to be embedded.

mod errors;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use anyhow::Context as _;
use base64::Engine as _;
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use scene::image_file;

pub(crate) use errors::{ERROR_SCALE, FULL_ERROR};

use crate::collect::{Inputs, Run};
use crate::params::TableGenerationParams;
use crate::report::{Group, Report};
use crate::statistics::mean;

/// JPEG quality of the images in the page, of 100; at 85 no artefacts are visible at this size.
const JPEG_QUALITY: u8 = 85;

/// Renders of one view by all methods, next to the ground truth.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sheet {
    /// Name of the group in which the renders were measured.
    pub group: String,
    /// The scene.
    pub scene: String,
    /// The view's name.
    pub view: String,
    /// Why the view was chosen, e.g. `worst of 20 views, 24.1 dB on average`.
    pub why: String,
    /// The ground truth.
    pub truth: Picture,
    /// One render per row of the group that has the view.
    pub comparisons: Vec<Comparison>,
}

/// A render and its error.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Comparison {
    /// The row of the render.
    pub row: String,
    /// PSNR of the render in dB.
    pub psnr: f64,
    /// Whether the run is degenerate.
    pub is_degenerate: bool,
    /// The render.
    pub render: Picture,
    /// The error in colours of [`ERROR_SCALE`].
    pub error: Picture,
}

/// A JPEG image.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Picture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    bytes: Vec<u8>,
}

impl Picture {
    fn new(image: &RgbImage) -> anyhow::Result<Self> {
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
            .encode_image(image)
            .context("cannot encode an image")?;
        Ok(Self { width: image.width(), height: image.height(), bytes })
    }

    /// The image as a data URI.
    pub(crate) fn data_uri(&self) -> String {
        format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(&self.bytes))
    }
}

/// The sheets of a report: the worst views and the median view of every scene, by mean PSNR over methods. Scenes
/// without a capture among the inputs are left out; there are no sheets if `shown_views` is 0.
pub(crate) fn sheets(report: &Report, inputs: &Inputs, params: &TableGenerationParams) -> anyhow::Result<Vec<Sheet>> {
    let mut sheets = Vec::new();
    for group in &report.groups {
        for scene in &group.scenes {
            let shown = shown_runs(report, group, scene, inputs);
            for (view, why) in chosen_views(&shown, params.shown_views) {
                sheets.push(sheet(group, scene, (&view, why), &shown, inputs, params.image_width)?);
            }
        }
    }
    Ok(sheets)
}

/// The first run of every row on the scene that has images.
fn shown_runs<'a>(report: &'a Report, group: &Group, scene: &str, inputs: &Inputs) -> Vec<&'a Run> {
    let first = |row: &str| {
        let mut runs = report.runs.iter().filter(|run| run.row == row && run.scene == scene && group.holds(run));
        runs.find(|run| inputs.images_of(run).is_some())
    };
    group.rows.iter().filter_map(|row| first(&row.name)).collect()
}

/// The `n_worst` worst views and the median view among the views that all runs have, each with the reason.
fn chosen_views(runs: &[&Run], n_worst: usize) -> Vec<(String, String)> {
    let mut by_view: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for frame in runs.iter().flat_map(|run| &run.frames) {
        by_view.entry(&frame.name).or_default().push(frame.psnr);
    }
    let common = by_view.into_iter().filter(|(_, values)| values.len() == runs.len());
    let mut views: Vec<(f64, &str)> = common.filter_map(|(name, values)| Some((mean(&values)?, name))).collect();
    views.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)));
    let n_views = views.len();
    let reason = |rank: usize, psnr: f64| {
        let which = match rank {
            0 => "worst".into(),
            at if at < n_worst => format!("worst no. {}", at + 1),
            _ => "median".into(),
        };
        format!("{which} of {n_views} views, {psnr:.1} dB on average")
    };
    let mut ranks: Vec<usize> = (0..n_worst.min(n_views)).collect();
    if n_worst > 0 && n_views / 2 >= n_worst {
        ranks.push(n_views / 2);
    }
    ranks.into_iter().map(|rank| (views[rank].1.to_owned(), reason(rank, views[rank].0))).collect()
}

fn sheet(
    group: &Group,
    scene: &str,
    (view_name, why): (&str, String),
    runs: &[&Run],
    inputs: &Inputs,
    width: u32,
) -> anyhow::Result<Sheet> {
    let mut truth = None;
    let mut comparisons = Vec::new();
    for run in runs {
        let Some((renders, capture)) = inputs.images_of(run) else { continue };
        let wanted = capture.views.iter().find(|view| view.name == view_name);
        let rendered = renders.views.iter().find(|view| view.name == view_name);
        let psnr = run.frames.iter().find(|frame| frame.name == view_name).map(|frame| frame.psnr);
        let (Some(wanted), Some(rendered), Some(psnr)) = (wanted, rendered, psnr) else { continue };
        let true_image = capture.load_image(wanted)?;
        let render = image_file::read_rgb(&renders.image_path(rendered))?;
        let error = Picture::new(&errors::colours(&render, &true_image, width)?)?;
        comparisons.push(Comparison {
            row: run.row.clone(),
            psnr,
            is_degenerate: run.degenerate.is_some(),
            render: Picture::new(&small(render, width))?,
            error,
        });
        if truth.is_none() {
            truth = Some(Picture::new(&small(true_image, width))?);
        }
    }
    let truth = truth.with_context(|| format!("view {view_name} of {scene} has no ground truth"))?;
    Ok(Sheet { group: group.name.clone(), scene: scene.into(), view: view_name.into(), why, truth, comparisons })
}

/// Scales the image down to `width` if it is wider.
fn small(image: RgbImage, width: u32) -> RgbImage {
    if image.width() <= width {
        return image;
    }
    let height = (f64::from(image.height()) * f64::from(width) / f64::from(image.width())).round().max(1.0);
    imageops::resize(&image, width, height as u32, FilterType::Triangle)
}
