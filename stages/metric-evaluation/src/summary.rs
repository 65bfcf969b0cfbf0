//! The metrics as text for the terminal.

use std::collections::BTreeMap;
use std::fmt::Write;

use engine::count;

use crate::artifact::{ImageMetrics, Metrics, Remark};
use crate::masks::MaskName;
use crate::metrics::metric::Metric;
use crate::metrics::prompt_prior::TrivialOverlap;
use crate::metrics::psnr::PSNR_CAP_DB;
use crate::metrics::score::Score;
use crate::metrics::trivial::{MeanImage, Trivial};

impl Metrics {
    /// An aligned table with the mean, the worst value and the worst image of every metric, followed by the PSNR of trivial
    /// images and by caveats.
    pub fn summary(&self) -> String {
        let mut rows = vec![["metric", "mean", "worst", "worst image"].map(String::from)];
        let defined = self.means.iter().filter(|(_, mean)| mean.value().is_some());
        rows.extend(defined.map(|(metric, mean)| self.summary_row(*metric, mean)));
        rows.extend(self.masked.iter().flat_map(|(mask, means)| self.masked_rows(*mask, means)));
        let widths: [usize; 4] =
            std::array::from_fn(|column| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0));
        let images = count(self.n_images, "image");
        let mut text = format!("{images} · {}×{} px\n", self.protocol.width, self.protocol.height);
        for [metric, mean, worst, name] in &rows {
            let line = format!("{metric:<0$}  {mean:>1$}  {worst:>2$}  {name}", widths[0], widths[1], widths[2]);
            writeln!(text, "{}", line.trim_end()).expect("writing to a string succeeds");
        }
        text + &self.trivial_lines() + &self.prompt_lines() + &self.undefined_lines() + &self.remark_lines()
    }

    /// The PSNR of images that need no model, and a warning if the renders are not better.
    fn trivial_lines(&self) -> String {
        let Trivial { constant_psnr, mean_image, masked_mean_image, .. } = &self.trivial;
        if self.trivial.truth_is_constant() {
            return "the whole ground truth has one colour: no image can be better than a constant one\n".into();
        }
        let above = self.full_psnr() - constant_psnr;
        let direction = if above < 0.0 { "below" } else { "above" };
        let mut text = format!(
            "best constant image: {constant_psnr:.2} dB; the renders are {:.2} dB {direction} it\n",
            above.abs()
        );
        if let Some(MeanImage { psnr, .. }) = mean_image {
            writeln!(text, "mean of the other images: {psnr:.2} dB").expect("writing to a string succeeds");
        }
        for (mask, (metric, score)) in
            masked_mean_image.iter().flat_map(|(mask, means)| means.iter().map(move |m| (mask, m)))
        {
            let (name, decimals, unit) = (metric.heading(), metric.decimals(), metric.unit());
            let line = format!("mean of the other images, {name} ({}): {score:.decimals$} {unit}", mask.heading());
            writeln!(text, "{}", line.trim_end()).expect("writing to a string succeeds");
        }
        for (metric, score) in &self.trivial.moving_mean_image {
            let (name, decimals, unit) = (metric.heading(), metric.decimals(), metric.unit());
            writeln!(text, "mean of the other images, {name}: {score:.decimals$} {unit}")
                .expect("writing to a string succeeds");
        }
        for (metric, score) in &self.trivial.without_motion {
            let (name, decimals, unit) = (metric.heading(), metric.decimals(), metric.unit());
            writeln!(text, "without motion, the {name} is {score:.decimals$} {unit}")
                .expect("writing to a string succeeds");
        }
        if let Some(degenerate) = self.degenerate(true) {
            writeln!(text, "DEGENERATE: {}", degenerate.about()).expect("writing to a string succeeds");
        }
        text
    }

    /// One line per prompt, with the scores of answers that need no model.
    fn prompt_lines(&self) -> String {
        let line = |(prompt, trivial): (&String, &TrivialOverlap)| {
            let overlap = self.prompts.get(prompt)?.value()?;
            let TrivialOverlap { constant, spatial_prior } = trivial;
            Some(format!(
                "prompt {prompt:?}: IoU {overlap:.3} (best constant answer {constant:.3}, spatial prior {spatial_prior:.3})\n"
            ))
        };
        self.trivial_prompts.iter().filter_map(line).collect()
    }

    /// One line per reason why metrics are undefined.
    fn undefined_lines(&self) -> String {
        let mut by_reason = BTreeMap::<&str, Vec<&str>>::new();
        for (metric, mean) in self.masked.values().flatten().chain(&self.means) {
            if let Score::Undefined { undefined } = mean {
                by_reason.entry(undefined).or_default().push(metric.heading());
            }
        }
        let line = |(reason, metrics): (&str, Vec<&str>)| {
            format!("{} {} undefined: {reason}\n", metrics.join(", "), if metrics.len() == 1 { "is" } else { "are" })
        };
        by_reason.into_iter().map(line).collect()
    }

    fn summary_row(&self, metric: Metric, mean: &Score) -> [String; 4] {
        let values = self.images.iter().filter_map(|image| Some((image.values.get(&metric)?.value()?, &image.name)));
        Self::row(metric.heading().into(), metric, mean, values)
    }

    /// The rows of the metrics of one mask.
    fn masked_rows(&self, mask: MaskName, means: &BTreeMap<Metric, Score>) -> Vec<[String; 4]> {
        let value = |image: &ImageMetrics, metric: Metric| image.masked.get(&mask)?.get(&metric)?.value();
        let row = |(&metric, mean): (&Metric, &Score)| {
            let values = self.images.iter().filter_map(|image| Some((value(image, metric)?, &image.name)));
            Self::row(format!("{} ({})", metric.heading(), mask.heading()), metric, mean, values)
        };
        means.iter().filter(|(_, mean)| mean.value().is_some()).map(row).collect()
    }

    fn row<'a>(
        name: String,
        metric: Metric,
        mean: &Score,
        values: impl Iterator<Item = (f64, &'a String)>,
    ) -> [String; 4] {
        let number = |value: f64| format!("{value:.*} {}", metric.decimals(), metric.unit()).trim_end().to_owned();
        let by_value = |a: &(f64, &String), b: &(f64, &String)| a.0.total_cmp(&b.0);
        let worst = if metric.higher_is_better() { values.min_by(by_value) } else { values.max_by(by_value) };
        [
            name,
            mean.value().map_or_else(String::new, number),
            worst.map_or(String::new(), |(value, _)| number(value)),
            worst.map_or(String::new(), |(_, name)| name.clone()),
        ]
    }

    fn remark_lines(&self) -> String {
        let explained = [
            (Remark::Identical, format!("equal to the ground truth (PSNR capped at {PSNR_CAP_DB} dB)")),
            (Remark::ConstantRender, "rendered in a single colour".into()),
            (Remark::ConstantTruth, "compared with a ground truth of a single colour".into()),
        ];
        let line = |(remark, what): (Remark, String)| {
            let names: Vec<_> = self.images.iter().filter(|image| image.remarks.contains(&remark)).collect();
            let first = names.first()?;
            Some(format!("note: {} of {} images {what}, e.g. {}\n", names.len(), self.n_images, first.name))
        };
        explained.into_iter().filter_map(line).collect()
    }
}
