engine::artifact! {
    /// The capture that this stage makes; importers of real data make the same type.
    pub struct CaptureArtifact(scene::Capture) = "capture" @ scene::capture::SCHEMA;
}
