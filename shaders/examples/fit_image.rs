//! Fits Gaussians to a photograph with a tape, the splat renderer and Adam.
//!
//!     cargo run --release -p shaders --example fit_image -- PHOTO OUT.png
//!
//! The camera looks along +z at the plane z = 1, where one scene unit is the width of the image. Each step renders the
//! splats, compares the render with the photograph, differentiates, and lets Adam update every parameter.

use std::error::Error;

use image::imageops::FilterType;
use shaders::adam::{Adam, Group, Update};
use shaders::check::noise;
use shaders::geometry::camera::PinholeCamera;
use shaders::losses::l1::l1_dssim;
use shaders::rasteriser::{RasterSettings, ShapeVars, SplatVars, render};
use shaders::tape::{Device, Tape, Tensor};

const SPLATS: usize = 4000;
const STEPS: usize = 300;
/// Step sizes of positions, log scales, rotations (quaternions), opacity logits and colours (spherical harmonics).
const LEARNING_RATES: [f64; 5] = [1e-3, 1e-2, 1e-2, 2e-2, 1e-2];

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let (photo, out) = args.next().zip(args.next()).ok_or("usage: fit_image PHOTO OUT.png")?;
    let photo = image::open(&photo)?.resize(256, 256, FilterType::Triangle).to_rgb32f();
    let (width, height) = (photo.width() as usize, photo.height() as usize);
    let target = Tensor::from_vec([height, width, 3], photo.into_raw());
    let camera = PinholeCamera {
        width,
        height,
        focal: [width as f64; 2],
        center: [0.5 * width as f64, 0.5 * height as f64],
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };
    let settings = RasterSettings { sh_degree: 0, ..RasterSettings::default() };

    let mut parameters = grey_splats(height as f64 / width as f64);
    for step in 1..=STEPS {
        let mut tape = Tape::new(Device::Cpu);
        let leaves = parameters.each_ref().map(|group| tape.leaf(group.tensor().clone()));
        let [positions, log_scales, rotations, opacity_logits, sh] = leaves;
        let shape = ShapeVars::ScaleRotation { log_scales, rotations };
        let splats = SplatVars { positions, shape, opacity_logits, sh };
        let color = render(&mut tape, &splats, None, &camera, &settings)?.color;
        let truth = tape.constant(target.clone());
        let loss = l1_dssim(&mut tape, color, truth, 0.2);

        let gradients = tape.backward(&[(loss, Tensor::scalar(1.0))]);
        let gradients = leaves.map(|leaf| gradients.get(leaf).cloned());
        let updates = parameters.iter_mut().zip(&gradients).zip(LEARNING_RATES);
        let update =
            |((group, gradient), learning_rate)| Update { group, gradient: Option::as_ref(gradient), learning_rate };
        Adam::default().step(&mut updates.map(update).collect::<Vec<_>>());

        if step % 50 == 0 {
            println!("step {step}: loss {:.4}", tape.value(loss).as_slice()[0]);
            let bytes = tape.value(color).as_slice().iter().map(|value| (255.0 * value.clamp(0.0, 1.0)).round() as u8);
            image::save_buffer(&out, &bytes.collect::<Vec<_>>(), width as u32, height as u32, image::ColorType::Rgb8)?;
        }
    }
    Ok(())
}

/// Grey, round, half transparent splats, scattered over the image and sized so that neighbours overlap.
fn grey_splats(aspect: f64) -> [Group; 5] {
    let places = noise(2 * SPLATS, 0);
    let positions =
        places.chunks(2).flat_map(|at| [0.5 * at[0], 0.5 * aspect * at[1], 1.0]).map(|x| x as f32).collect();
    let log_scale = (aspect / SPLATS as f64).sqrt().ln() as f32;
    let rotations = [1.0, 0.0, 0.0, 0.0].repeat(SPLATS);
    [
        Group::new("positions", Tensor::from_vec([SPLATS, 3], positions)),
        Group::new("log_scales", Tensor::full([SPLATS, 3], log_scale)),
        Group::new("rotations", Tensor::from_vec([SPLATS, 4], rotations)),
        Group::new("opacity_logits", Tensor::zeros([SPLATS, 1])),
        Group::new("sh", Tensor::zeros([SPLATS, 1, 3])),
    ]
}
