//! 3D Gaussians to images: sources of splats ([`slicing4d`], [`neural_gaussians`]), their [`projection`], [`binning`] to
//! tiles and [`blending`], composed by [`render`], and statistics of renders ([`screen`]).

pub mod binning;
pub mod blending;
mod isa;
pub mod neural_gaussians;
pub mod projection;
mod render;
pub mod screen;
mod settings;
pub mod slicing4d;
mod splats;

pub use binning::{MAX_INTERSECTIONS, TooManyIntersections};
pub use isa::Isa;
pub use projection::{NOT_FINITE, ProjectedVars};
pub use render::{RenderStats, Rendered, RenderedImage, render, render_image};
pub use settings::RasterSettings;
pub use splats::{HIDDEN_LOGIT, ShapeVars, SplatTensors, SplatVars};
