//! Which views are shown, and their images: small enough to lie in the page.

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

pub use errors::{ERROR_SCALE, FULL_ERROR};

use crate::TableGenerationParams;
use crate::collect::{Inputs, Run};
use crate::report::{Group, Report};
use crate::statistics::mean;

/// The quality of the images in the page: at 85 of 100 no artefacts are seen at this size.
const JPEG_QUALITY: u8 = 85;

/// Renders of one view by every method, beside its true image.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    /// The group that the renders were measured in.
    pub group: String,
    /// The scene.
    pub scene: String,
    /// The view's name.
    pub view: String,
    /// Why it is shown, as `worst of 20 views, mean over methods 24.1 dB`.
    pub why: String,
    /// The image that the renders should be.
    pub truth: Picture,
    /// One per row of the group that has the view.
    pub comparisons: Vec<Comparison>,
}

/// A render and its error.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The row that it belongs to.
    pub row: String,
    /// PSNR of the render, dB.
    pub psnr: f64,
    /// The render.
    pub render: Picture,
    /// The error in the colours of [`ERROR_SCALE`].
    pub error: Picture,
}

/// A JPEG file.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
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

    /// The file as the address of an image.
    pub fn data_uri(&self) -> String {
        format!("data:image/jpeg;base64,{}", base64::engine::general_purpose::STANDARD.encode(&self.bytes))
    }
}

/// The sheets of a report: per scene the worst views and the median one, by the mean PSNR over methods. Empty where the
/// parameters ask for none, and without the scenes whose captures are not among the inputs.
pub fn sheets(report: &Report, inputs: &Inputs, params: &TableGenerationParams) -> anyhow::Result<Vec<Sheet>> {
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

/// The first run of every row on a scene whose images are there.
fn shown_runs<'a>(report: &'a Report, group: &Group, scene: &str, inputs: &Inputs) -> Vec<&'a Run> {
    let first = |row: &str| {
        let mut runs = report.runs.iter().filter(|run| run.row == row && run.scene == scene && group.holds(run));
        runs.find(|run| inputs.images_of(run).is_some())
    };
    group.rows.iter().filter_map(|row| first(&row.name)).collect()
}

/// The `n_worst` worst views and the median one among those that every run has, with the reason.
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
            at if at < n_worst => format!("number {} of the worst", at + 1),
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
            render: Picture::new(&small(render, width))?,
            error,
        });
        if truth.is_none() {
            truth = Some(Picture::new(&small(true_image, width))?);
        }
    }
    let truth = truth.with_context(|| format!("view {view_name} of {scene} has no true image"))?;
    Ok(Sheet { group: group.name.clone(), scene: scene.into(), view: view_name.into(), why, truth, comparisons })
}

/// The image, made smaller where it is wider than `width`.
fn small(image: RgbImage, width: u32) -> RgbImage {
    if image.width() <= width {
        return image;
    }
    let height = (f64::from(image.height()) * f64::from(width) / f64::from(image.width())).round().max(1.0);
    imageops::resize(&image, width, height as u32, FilterType::Triangle)
}
