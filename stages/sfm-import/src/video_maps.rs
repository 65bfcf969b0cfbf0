//! Images and maps of a whole video, decoded together when the first of them is needed.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use image::{DynamicImage, RgbImage};
use scene::FloatImage;
use scene::float_image::to_byte;
use scene::maps::formats::{self, Content};

use crate::error::{Result, bad};

/// One image per frame of a video, of equal size.
#[derive(Debug)]
pub(crate) struct VideoMaps {
    storage: Storage,
    decoded: OnceLock<Result<Vec<FloatImage>>>,
}

/// Where they are stored.
#[derive(Debug)]
enum Storage {
    /// An array in an npz archive, with this many values per pixel.
    Member { archive: PathBuf, name: &'static str, channels: usize },
    /// A file with one value per pixel for every frame.
    Files(Vec<PathBuf>),
}

impl VideoMaps {
    /// The array called `name` in an npz archive, with `channels` values per pixel.
    pub(crate) fn member(archive: PathBuf, name: &'static str, channels: usize) -> Arc<Self> {
        Arc::new(Self { storage: Storage::Member { archive, name, channels }, decoded: OnceLock::new() })
    }

    /// One file with one value per pixel for every frame.
    pub(crate) fn files(paths: Vec<PathBuf>) -> Arc<Self> {
        Arc::new(Self { storage: Storage::Files(paths), decoded: OnceLock::new() })
    }

    /// The file that holds the map of a frame.
    pub(crate) fn path(&self, index: usize) -> &Path {
        match &self.storage {
            Storage::Member { archive, .. } => archive,
            Storage::Files(paths) => &paths[index],
        }
    }

    /// The map of a frame.
    pub(crate) fn frame(&self, index: usize) -> Result<&FloatImage> {
        self.all()?.get(index).ok_or_else(|| bad(format!("there are fewer than {} maps", index + 1)))
    }

    /// The quantile of the values of all frames; values that are not finite are ignored.
    fn quantile(&self, share: f64) -> Result<f32> {
        let values = self.all()?.iter().flat_map(|map| &map.values).copied();
        let mut values: Vec<f32> = values.filter(|value| value.is_finite()).collect();
        let rank = (share * values.len() as f64) as usize;
        if rank >= values.len() {
            return Ok(f32::NEG_INFINITY);
        }
        Ok(*values.select_nth_unstable_by(rank, f32::total_cmp).1)
    }

    fn all(&self) -> Result<&Vec<FloatImage>> {
        self.decoded.get_or_init(|| self.decode()).as_ref().map_err(Clone::clone)
    }

    fn decode(&self) -> Result<Vec<FloatImage>> {
        let blame = |error: scene::Error| {
            let failure = bad(error.message);
            error.path.into_iter().fold(failure, |failure, path| failure.at(path))
        };
        match &self.storage {
            Storage::Member { archive, name, channels } => {
                formats::read_member_video(archive, name, *channels).map_err(blame)
            }
            Storage::Files(paths) => {
                paths.iter().map(|path| formats::read(path, Content::Depth).map_err(blame)).collect()
            }
        }
    }
}

/// A frame's image in an array of a whole video.
#[derive(Clone, Debug)]
pub(crate) struct ArrayImage {
    /// The images, with three values per pixel.
    pub(crate) images: Arc<VideoMaps>,
    /// The index of this one.
    pub(crate) index: usize,
    /// The value of white.
    pub(crate) white: f32,
    /// Width and height.
    pub(crate) size: (u32, u32),
}

impl ArrayImage {
    /// The image, rounded to 8 bits.
    pub(crate) fn decode(&self) -> Result<DynamicImage> {
        let image = self.images.frame(self.index)?;
        let bytes = image.values.iter().map(|value| to_byte(value / self.white)).collect();
        let image = RgbImage::from_raw(image.width, image.height, bytes);
        image.map(DynamicImage::from).ok_or_else(|| bad("the array has no three channels"))
    }
}

/// A frame's depth among the maps of a whole video.
#[derive(Clone, Debug)]
pub(crate) struct StoredDepth {
    /// View-space z in scene units.
    pub(crate) maps: Arc<VideoMaps>,
    /// The index of this map.
    pub(crate) index: usize,
    /// Which values are unsure.
    pub(crate) confidence: Option<Arc<Confidence>>,
    /// The part of the image that the map shows, if not the whole image.
    pub(crate) window: Option<Window>,
    /// Values from this one on mean that the estimator found no depth.
    pub(crate) no_depth_from: f32,
}

impl StoredDepth {
    /// The depth of the whole image; 0 where it is unknown, too large, or uncertain.
    pub(crate) fn read(&self) -> Result<FloatImage> {
        let mut depth = self.maps.frame(self.index)?.clone();
        for value in depth.values.iter_mut().filter(|value| **value >= self.no_depth_from) {
            *value = 0.0;
        }
        if let Some(confidence) = &self.confidence {
            let (sure, least) = (confidence.maps.frame(self.index)?, confidence.least()?);
            if (sure.width, sure.height) != (depth.width, depth.height) {
                return Err(bad("depth and confidence differ in size"));
            }
            for (value, _) in depth.values.iter_mut().zip(&sure.values).filter(|(_, sure)| **sure < least) {
                *value = 0.0;
            }
        }
        Ok(self.window.map_or(depth.clone(), |window| window.applied(&depth)))
    }
}

/// The confidence of depth values.
#[derive(Debug)]
pub(crate) struct Confidence {
    maps: Arc<VideoMaps>,
    unsure_share: f64,
    least: OnceLock<Result<f32>>,
}

impl Confidence {
    /// Confidence maps of a video; the lowest `unsure_share` of their values are uncertain.
    pub(crate) fn new(maps: Arc<VideoMaps>, unsure_share: f64) -> Arc<Self> {
        Arc::new(Self { maps, unsure_share, least: OnceLock::new() })
    }

    /// The least confidence of a certain value.
    fn least(&self) -> Result<f32> {
        self.least.get_or_init(|| self.maps.quantile(self.unsure_share)).clone()
    }
}

/// The placement of a map (cropped or padded) relative to its source image, in pixels of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    /// Width of the whole image.
    pub(crate) width: u32,
    /// Height of the whole image.
    pub(crate) height: u32,
    /// Columns of the image to the left of the map; negative where the map has a margin.
    pub(crate) left: i32,
    /// Rows of the image above the map; negative where the map has a margin.
    pub(crate) top: i32,
}

impl Window {
    /// The map of the whole image; 0 where the map shows none of it.
    fn applied(&self, map: &FloatImage) -> FloatImage {
        let value = |x: u32, y: u32| {
            let column = u32::try_from(x as i32 - self.left).ok().filter(|column| *column < map.width)?;
            let row = u32::try_from(y as i32 - self.top).ok().filter(|row| *row < map.height)?;
            map.values.get((row * map.width + column) as usize).copied()
        };
        let places = (0..self.height).flat_map(|y| (0..self.width).map(move |x| (x, y)));
        let values = places.map(|(x, y)| value(x, y).unwrap_or(0.0)).collect();
        FloatImage { width: self.width, height: self.height, channels: 1, values }
    }
}
