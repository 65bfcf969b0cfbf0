//! OpenEXR files: float images with named f32 channels.

use std::io::Cursor;
use std::path::Path;

use exr::meta::MetaData;
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder,
    ReadChannels, ReadLayers, SmallVec, WritableImage,
};

use crate::image_file::{read_file, write_file};
use crate::{Error, Result};

/// Upper limit of pixels per file: a damaged header must not cause a huge allocation.
const MAX_PIXELS: usize = 1 << 28;

/// The header of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ExrHeader {
    /// Number of columns.
    pub(crate) width: u32,
    /// Number of rows.
    pub(crate) height: u32,
    /// Channel names in the order of the file, which is alphabetic.
    pub(crate) channels: Vec<String>,
}

/// A decoded file.
#[derive(Clone, Debug)]
pub struct ExrImage {
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Channel names and [H, W] values, in the order of the file; half and integer samples are converted to f32.
    pub channels: Vec<(String, Vec<f32>)>,
}

impl ExrImage {
    /// The values of the channel with the first of these names that exists.
    pub fn channel(&self, names: &[&str]) -> Option<&[f32]> {
        let find = |name: &&str| self.channels.iter().find(|(channel, _)| channel.as_str() == *name);
        names.iter().find_map(find).map(|(_, values)| values.as_slice())
    }
}

/// Reads size and channel names without decoding pixels.
pub(crate) fn read_header(path: &Path) -> Result<ExrHeader> {
    let file = std::fs::File::open(path);
    let file = file.map_err(|error| Error::new(format!("cannot read the file ({error})")).at(path))?;
    guarded(path, || parse_header(std::io::BufReader::new(file)))
}

/// Decodes the first layer of a file.
pub fn read(path: &Path) -> Result<ExrImage> {
    let bytes = read_file(path)?;
    guarded(path, || {
        let header = parse_header(Cursor::new(&bytes))?;
        let image = exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(Cursor::new(&bytes))
            .map_err(|error| error.to_string())?;
        let channels = image.layer_data.channel_data.list;
        let values = |channel: AnyChannel<FlatSamples>| {
            let name = channel.name.to_string();
            let values = match channel.sample_data {
                FlatSamples::F32(values) => values,
                other => other.values_as_f32().collect(),
            };
            (name, values)
        };
        let channels: Vec<_> = channels.into_iter().map(values).collect();
        let pixels = header.width as usize * header.height as usize;
        match channels.iter().find(|(_, values)| values.len() != pixels) {
            Some((name, values)) => Err(format!("channel {name} has {} of {pixels} pixels", values.len())),
            None => Ok(ExrImage { width: header.width, height: header.height, channels }),
        }
    })
}

/// Writes channels of [H, W] values. ZIP compression on one thread makes equal values give equal bytes.
pub fn write(path: &Path, width: u32, height: u32, channels: &[(&str, Vec<f32>)]) -> Result<()> {
    let (width, height) = (width as usize, height as usize);
    if let Some((name, values)) = channels.iter().find(|(_, values)| values.len() != width * height) {
        let message = format!("channel {name} has {} values for {width}×{height} pixels", values.len());
        return Err(Error::new(message).at(path));
    }
    let list = channels.iter().map(|(name, values)| AnyChannel::new(*name, FlatSamples::F32(values.clone())));
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let channels = AnyChannels::sort(list.collect::<SmallVec<_>>());
    let layer = Layer::new((width, height), LayerAttributes::default(), encoding, channels);
    let mut bytes = Vec::new();
    let result = Image::from_layer(layer).write().non_parallel().to_buffered(Cursor::new(&mut bytes));
    result.map_err(|error| Error::new(format!("cannot encode the EXR image ({error})")).at(path))?;
    write_file(path, &bytes)
}

/// Parses the header of the first layer.
fn parse_header(bytes: impl std::io::Read) -> std::result::Result<ExrHeader, String> {
    let meta = MetaData::read_from_buffered(bytes, false).map_err(|error| error.to_string())?;
    let header = meta.headers.first().ok_or("no layer")?;
    let (width, height) = (header.layer_size.width(), header.layer_size.height());
    if width.saturating_mul(height) > MAX_PIXELS {
        return Err(format!("{width}×{height} pixels exceed the limit of {MAX_PIXELS}"));
    }
    let channels = header.channels.list.iter().map(|channel| channel.name.to_string()).collect();
    Ok(ExrHeader { width: width as u32, height: height as u32, channels })
}

/// Runs the external decoder and converts a panic on damaged bytes to an error.
fn guarded<T>(path: &Path, decode: impl FnOnce() -> std::result::Result<T, String>) -> Result<T> {
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode));
    let outcome = outcome.unwrap_or_else(|_| Err("the decoder panicked".into()));
    outcome.map_err(|reason| {
        Error::new(format!("not a readable EXR image ({reason})")).hint("the file may be damaged").at(path)
    })
}
