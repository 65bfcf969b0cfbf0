//! Parameters of the stage.

use engine::ParamProblem;
use serde::{Deserialize, Serialize};

use crate::papers;

/// How the report looks and when a published value counts as reproduced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TableGenerationParams {
    /// The report's title.
    pub title: String,
    /// The recipe's file, as `recipes/dnerf.toml`, for the commands that the report names.
    pub recipe: String,
    /// What the command line changes in the recipe, as the arguments of `pipeline run`, for the same commands; the command
    /// line sets it itself.
    pub arguments: Vec<String>,
    /// Papers whose tables are set beside our figures: `l4dgs`, `phys4dgs`, `kineticgs`, `mcgs`, `vcgs`.
    pub papers: Vec<String>,
    /// Whether the seconds of the curves are on a logarithmic axis.
    pub log_time: bool,
    /// Largest difference in dB at which a published PSNR counts as reproduced; independent groups that re-ran the
    /// 4DGaussians code on D-NeRF came within 0.3 dB of its paper on every scene.
    pub reproduced_within_db: f64,
    /// The method that every other one is compared with, scene by scene.
    pub baseline: String,
    /// Whether there is a table of what became of every run; it is there in any case where one diverged.
    pub hard_cases: bool,
    /// Per scene, how many of the worst views are shown beside the median one; 0 shows none.
    pub shown_views: usize,
    /// Pixels per row of the images in the page, at most.
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
            hard_cases: false,
            shown_views: 2,
            image_width: 200, // a render and its error side by side on a phone; some 10 kB a pair
        }
    }
}

impl TableGenerationParams {
    /// Every problem that the types cannot see.
    pub fn problems(&self) -> Vec<ParamProblem> {
        let tolerance_db = self.reproduced_within_db;
        let no_tolerance = !(tolerance_db.is_finite() && tolerance_db > 0.0);
        let tolerance = no_tolerance.then(|| ParamProblem {
            key: "reproduced_within_db".into(),
            message: format!("a tolerance of {tolerance_db} dB"),
            hint: Some("use a positive number, as 0.3".into()),
        });
        let no_width = (self.image_width == 0).then(|| ParamProblem {
            key: "image_width".into(),
            message: "an image needs at least one pixel per row".into(),
            hint: Some("set shown_views = 0 to show no images".into()),
        });
        let is_unknown = |name: &&String| !papers::names().any(|known| known == name.as_str());
        let unknown = self.papers.iter().filter(is_unknown).map(|name| ParamProblem {
            key: "papers".into(),
            message: format!("no paper called `{name}`"),
            hint: Some(format!("papers: {}", papers::names().collect::<Vec<_>>().join(", "))),
        });
        tolerance.into_iter().chain(no_width).chain(unknown).collect()
    }
}
