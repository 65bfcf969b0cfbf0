//! Parameters of the stage.

use std::collections::BTreeMap;

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

use crate::base::Base;
use crate::library::paper_names;

/// Content and layout of the report, and the criterion for reproduction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TableGenerationParams {
    /// Title of the report.
    pub title: String,
    /// Path of the recipe, e.g. `recipes/dnerf.toml`; the report prints it in its commands.
    pub recipe: String,
    /// Arguments of `pipeline run` that change the recipe; the report prints them in its commands. Set by the command
    /// line, not by recipes.
    pub arguments: Vec<String>,
    /// Papers whose tables the report compares with its own numbers: file stems of `claims/papers`, e.g. `mcgs`.
    pub papers: Vec<String>,
    /// Whether the time axis of the curves is logarithmic.
    pub log_time: bool,
    /// Largest difference in dB at which a published PSNR counts as reproduced. The default is the agreement of
    /// independent groups: those that re-ran the 4DGaussians code on D-NeRF came within 0.3 dB of its paper on every
    /// scene.
    pub reproduced_within_db: f64,
    /// Method with which every other method is compared, scene by scene.
    pub baseline: String,
    /// The method that each method builds on, e.g. `mcgs = "scgs"`: they are compared seed by seed. Values of further axes
    /// after the method select its rows with these values, e.g. `phys4dgs = "deformable4dgs steps=of-phys4dgs"`.
    pub bases: BTreeMap<String, String>,
    /// Whether the report lists the outcome of every run; it does so in any case if a run diverged.
    pub hard_cases: bool,
    /// Number of worst views per scene that the page shows next to the median view; 0 shows no images.
    pub shown_views: usize,
    /// Largest width of the images in the page, px.
    pub image_width: u32,
}

impl Default for TableGenerationParams {
    fn default() -> Self {
        Self {
            title: "Results".into(),
            recipe: "RECIPE".into(),
            arguments: Vec::new(),
            papers: Vec::new(),
            log_time: false,
            reproduced_within_db: 0.3,
            baseline: "static3dgs".into(),
            bases: BTreeMap::new(),
            hard_cases: false,
            shown_views: 2,
            image_width: 400, // wider than a phone, large on a desktop; about 30 kB per pair
        }
    }
}

impl TableGenerationParams {
    /// Checks the values that the types do not restrict.
    pub(crate) fn problems(&self) -> Vec<ParamProblem> {
        let tolerance_db = self.reproduced_within_db;
        let no_tolerance = !(tolerance_db.is_finite() && tolerance_db > 0.0);
        let tolerance = no_tolerance.then(|| ParamProblem {
            key: "reproduced_within_db".into(),
            message: format!("{tolerance_db} dB is not a tolerance"),
            hint: Some("use a positive number, e.g. 0.3".into()),
        });
        let no_width = (self.image_width == 0).then(|| ParamProblem {
            key: "image_width".into(),
            message: "images need a width of at least one pixel".into(),
            hint: Some("set shown_views = 0 to show no images".into()),
        });
        let is_unknown = |name: &&String| !paper_names().any(|known| known == name.as_str());
        let unknown = self.papers.iter().filter(is_unknown).map(|name| ParamProblem {
            key: "papers".into(),
            message: format!("no paper called `{name}`"),
            hint: Some(format!("known papers: {}", paper_names().collect::<Vec<_>>().join(", "))),
        });
        let malformed = self.bases.iter().filter_map(|(method, base)| {
            let message = base.parse::<Base>().err()?;
            let hint = "use a method, and values of further axes after it, e.g. \"deformable4dgs steps=of-phys4dgs\"";
            Some(ParamProblem { key: format!("bases.{method}"), message, hint: Some(hint.into()) })
        });
        tolerance.into_iter().chain(no_width).chain(unknown).chain(malformed).collect()
    }
}
