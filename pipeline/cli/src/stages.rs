//! The list of stages. A new stage is one line here.

use engine::{CodeTable, Registry};

include!(concat!(env!("OUT_DIR"), "/code.rs"));

/// All stages that recipes can name, with the hashes of the sources that this program was built from.
pub fn stages() -> Registry {
    stages_of(CODE)
}

/// All stages that recipes can name, with the hashes in `code`: the registry of a program built from other sources.
pub fn stages_of(code: CodeTable) -> Registry {
    Registry::new(code)
        .compiled_by(COMPILER)
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
