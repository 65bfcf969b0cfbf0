//! Gaussians of moving subjects, seeded from the subjects' pixels: every training view's masked pixels at their depth,
//! visible until the neighbouring training views, and with a velocity from optical flow or block matching.
//!
//! Structure from motion triangulates static points only, and a static warm-up learns the temporal mean where something
//! moves. A motion model can therefore not find a moving subject. Seeds represent the subject of every frame. Between
//! two frames, the seeds of both are shown, moved to the time and faded linearly, and the motion model of the method
//! corrects them. (Instant4D, arXiv 2510.01119, seeds frames in a similar way.)

mod depth;
mod insertion;
mod lifetimes;
mod matching;
mod points;
#[cfg(test)]
mod tests;
mod velocities;

pub(crate) use insertion::{extend_box, insert, insert_in_space_time};
pub(crate) use lifetimes::{born_at, carried, shown};
pub(crate) use points::{SPACING_SHARE, Seed, from_masks};
