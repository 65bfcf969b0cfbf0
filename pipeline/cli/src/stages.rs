//! The one list of stages. A new stage is one line here.

use engine::Registry;

include!(concat!(env!("OUT_DIR"), "/code.rs"));

/// Every stage that recipes can name.
pub fn stages() -> Registry {
    Registry::new(CODE)
        .with::<scene_synthesis::SceneSynthesis>()
        .with::<sfm_import::SfmImport>()
        .with::<training::Training>()
        .with::<rendering::Rendering>()
        .with::<metric_evaluation::MetricEvaluation>()
        .with::<table_generation::TableGeneration>()
}
