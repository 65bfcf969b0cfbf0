//! Films of trained models: PNG frames of one model, or an animated GIF with models and the ground truth side by side.

mod folder;
mod gif;
mod path;
mod shots;
mod subject;

pub use self::folder::film_to_folder;
pub use self::gif::{Gif, film_to_gif};
pub use self::shots::Film;
