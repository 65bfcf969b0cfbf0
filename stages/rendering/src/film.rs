//! Films of trained models: PNG frames of one model, or models and the ground truth side by side, as an animated GIF or a contact
//! sheet.

mod board;
mod folder;
mod gif;
mod path;
mod sheet;
mod shots;
mod subject;

pub use self::board::Panels;
pub use self::folder::film_to_folder;
pub use self::gif::{Gif, film_to_gif};
pub use self::sheet::film_to_sheet;
pub use self::shots::Film;
