//! scene-synthesis
