#![doc = include_str!("../README.md")]

mod params;
mod placement;
mod ray;
mod render;
mod run;
mod scenes;
mod shape;
mod shots;
mod texture;
mod wave;
mod world;

#[cfg(test)]
mod tests;

pub use params::{Background, Bounds, CameraPath, Params, SceneKind, Truth};
pub use run::{SceneSynthesis, synthesize};
