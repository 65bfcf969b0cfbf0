//! The contents of the program: the list of stages (a new stage is one line here), recipes and data manifests.

use engine::{Builtins, CodeTable, Registry};

include!(concat!(env!("OUT_DIR"), "/code.rs"));
include!(concat!(env!("OUT_DIR"), "/texts.rs"));

/// The descriptions of data sets in `data-manifests/`, by name.
pub(crate) const fn manifests() -> Builtins {
    MANIFESTS
}

/// All stages that recipes can name, with the hashes of the sources that this program was built from.
pub fn stages() -> Registry {
    stages_of(CODE)
}

/// All stages that recipes can name, with the hashes in `code`: the registry of a program built from other sources.
pub fn stages_of(code: CodeTable) -> Registry {
    Registry::new(code)
        .compiled_by(COMPILER)
        .with_recipes(RECIPES)
        .with::<scene_synthesis::SceneSynthesis>()
        .with::<sfm_import::SfmImport>()
        .with::<feature_import::FeatureImport>()
        .with::<momentum_sampling::MomentumSampling>()
        .with::<depth_flow_import::DepthFlowImport>()
        .with::<layer_split::LayerSplit>()
        .with::<inpaint_import::InpaintImport>()
        .with::<training::Training>()
        .with::<rendering::Rendering>()
        .with::<metric_evaluation::MetricEvaluation>()
        .with::<table_generation::TableGeneration>()
}
