//! Solid textures: one colour per material point, so that patterns move with the body.

use glam::{DVec3, IVec3};

/// Keeps cell borders away from the faces of blocks, where rounding would decide the colour.
const CELL_OFFSET: f64 = 0.137;

/// The arrangement of two colours.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Pattern {
    /// Cubes of alternating colour.
    Checker,
    /// Layers perpendicular to the direction (1, 1, 1), with smooth borders.
    Stripes,
    /// Smooth random blends of the colours (value noise).
    Noise,
}

/// A texture of two colours.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Texture {
    /// The arrangement of the colours.
    pub(crate) pattern: Pattern,
    /// Number of cells per scene unit.
    pub(crate) frequency: f64,
    /// The two sRGB-encoded colours.
    pub(crate) colors: [DVec3; 2],
}

impl Texture {
    /// A texture of two colours in the form 0xRRGGBB.
    pub(crate) fn new(pattern: Pattern, frequency: f64, colors: [u32; 2]) -> Self {
        let channel = |color: u32, shift: u32| f64::from(color >> shift & 0xff) / 255.0;
        let color = |color| DVec3::new(channel(color, 16), channel(color, 8), channel(color, 0));
        Self { pattern, frequency, colors: colors.map(color) }
    }

    /// The colour of a material point in object coordinates.
    pub(crate) fn color(&self, material: DVec3) -> DVec3 {
        let cell = material * self.frequency + CELL_OFFSET;
        let share = match self.pattern {
            Pattern::Checker => f64::from((cell.floor().as_ivec3().element_sum() & 1) as u8),
            Pattern::Stripes => 0.5 + 0.5 * (3.0 * (std::f64::consts::PI * cell.element_sum()).sin()).clamp(-1.0, 1.0),
            Pattern::Noise => smooth_noise(cell),
        };
        self.colors[0].lerp(self.colors[1], share)
    }
}

/// Value noise in [0, 1]: random values at integer points, smoothly interpolated.
fn smooth_noise(point: DVec3) -> f64 {
    let base = point.floor();
    let fraction = point - base;
    let blend = fraction * fraction * (3.0 - 2.0 * fraction);
    let corner = |x: i32, y: i32, z: i32| lattice_value(base.as_ivec3() + IVec3::new(x, y, z));
    let mix = |a: f64, b: f64, share: f64| a + (b - a) * share;
    let edge = |y: i32, z: i32| mix(corner(0, y, z), corner(1, y, z), blend.x);
    let face = |z: i32| mix(edge(0, z), edge(1, z), blend.y);
    mix(face(0), face(1), blend.z)
}

/// Hash of a lattice point to [0, 1], by the finaliser of splitmix64 (Steele et al. 2014).
fn lattice_value(point: IVec3) -> f64 {
    let [x, y, z] = point.to_array().map(|value| u64::from(value as u32));
    let mut bits = x ^ y << 21 ^ z << 42;
    bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    (bits >> 32 ^ bits >> 1 & 0xffff_ffff) as f64 / f64::from(u32::MAX)
}
