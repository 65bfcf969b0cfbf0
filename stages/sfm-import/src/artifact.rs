//! The one artifact type of this stage.

engine::artifact! {
    /// A capture as every training, rendering and metric stage reads it; the same type as that of synthetic scenes.
    pub struct CaptureArtifact(scene::Capture) = "capture" @ scene::capture::SCHEMA;
}
