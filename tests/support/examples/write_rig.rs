//! Writes a generated rig in the layout of Neural 3D Video, as JPEG frames: `write_rig DIR CAMERAS FRAMES WIDTH HEIGHT`. Every
//! camera has one textured image, of which its other frames are links.

use std::path::Path;

use support::fakes::Fake;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [dir, numbers @ ..] = &arguments[..] else { panic!("usage: write_rig DIR CAMERAS FRAMES WIDTH HEIGHT") };
    let numbers: Vec<u32> = numbers.iter().map(|number| number.parse().expect("a number")).collect();
    let [cameras, frames, width, height] = numbers[..] else { panic!("four numbers are needed") };
    let fake = Fake { size: (width, height), is_still: true, ..Fake::small(cameras as usize, frames as usize) };
    fake.neural_3d_video(Path::new(dir));
}
