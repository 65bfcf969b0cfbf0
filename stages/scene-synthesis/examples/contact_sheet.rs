//! Renders all scenes into one PNG: `cargo run --release -p scene-synthesis --example contact_sheet -- sheet.png`.
//!
//! One row per scene: five test views in order of time, then depth, flow and labels of a training view.

use anyhow::Context as _;
use scene::image_file::{RgbImage, write_rgb};
use scene::{Capture, Split, View};
use scene_synthesis::{Params, SceneKind, Truth, synthesize};

const SIZE: u32 = 200;
const SCENES: [SceneKind; 5] = [
    SceneKind::BouncingSpheres,
    SceneKind::SwingingArm,
    SceneKind::WavingCloth,
    SceneKind::Occluder,
    SceneKind::StaticBlocks,
];

fn main() -> anyhow::Result<()> {
    let path = std::env::args().nth(1).context("usage: contact_sheet FILE.png")?;
    let mut sheet = RgbImage::new(8 * SIZE, SCENES.len() as u32 * SIZE);
    for (row, scene) in (0..).zip(SCENES) {
        let truths = [Truth::Depth, Truth::Flow, Truth::Masks].into();
        let params =
            Params { scene, width: SIZE, height: SIZE, test_views: 5, val_views: 0, truths, ..Params::default() };
        let dir = tempfile::tempdir()?;
        let capture = synthesize(&params, dir.path(), 0, |_, _| Ok(()))?;
        let mut tiles = Vec::new();
        for (_, view) in capture.views_of(Split::Test) {
            tiles.push(capture.load_image(view)?);
        }
        let (_, train) = capture.views_of(Split::Train).nth(20).context("too few frames")?;
        tiles.extend(maps(&capture, train)?);
        for (column, tile) in (0..).zip(&tiles) {
            for (x, y, pixel) in tile.enumerate_pixels() {
                sheet.put_pixel(column * SIZE + x, row * SIZE + y, *pixel);
            }
        }
    }
    Ok(write_rgb(path.as_ref(), &sheet)?)
}

/// Depth from 2 (white) to 6 units (black), flow as red and green around grey, labels as grey levels.
fn maps(capture: &Capture, view: &View) -> anyhow::Result<[RgbImage; 3]> {
    let depth = capture.load_depth(view)?.context("no depth")?;
    let flow = capture.load_flow(view)?.context("no flow")?;
    let mask = capture.load_mask(view)?.context("no mask")?;
    let at = |x: u32, y: u32| (y * SIZE + x) as usize;
    let grey = |value: f32| [(value * 255.0) as u8; 3];
    let depth_color = |value: f32| if value > 0.0 { grey(1.0 - (value - 2.0) / 4.0) } else { [0; 3] };
    let signed = |value: f32| (128.0 + 20.0 * value) as u8;
    let flow_color = |[x, y]: [f32; 2]| if x.is_nan() { [0; 3] } else { [signed(x), signed(y), 128] };
    let tile = |color: &dyn Fn(usize) -> [u8; 3]| {
        let mut tile = RgbImage::new(SIZE, SIZE);
        tile.enumerate_pixels_mut().for_each(|(x, y, pixel)| pixel.0 = color(at(x, y)));
        tile
    };
    Ok([
        tile(&|index| depth_color(depth.depth_view[index])),
        tile(&|index| flow_color(flow.flow_px[index])),
        tile(&|index| grey(f32::from(mask.labels[index]) / 4.0)),
    ])
}
