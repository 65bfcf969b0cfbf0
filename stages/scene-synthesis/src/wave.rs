//! A sheet that waves: z = h(x, y, time) over a rectangle, still along the edge x = -half.x.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use crate::shape::{MIN_DISTANCE, Ray, slab};

/// Height below which the search for the surface changes from safe steps to Newton's, in scene units: small against
/// the wavelengths, so that Newton's steps stay in the basin of the nearest root.
const NEWTON_HEIGHT: f64 = 5e-3;
/// Residual height of a found point, scene units.
const TOLERANCE: f64 = 1e-13;
/// Safe steps before a grazing ray counts as missing the sheet.
const MAX_STEPS: usize = 400;

/// One travelling sine wave.
#[derive(Clone, Copy, Debug)]
struct Component {
    amplitude: f64,
    wave_vector: DVec2,
    pulsation: f64,
    phase: f64,
}

/// The sum of travelling waves, growing linearly from the fixed edge.
#[derive(Clone, Debug)]
pub struct Wave {
    half: DVec2,
    components: Vec<Component>,
}

/// Height of the sheet with its derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub struct Height {
    /// z.
    pub value: f64,
    /// By x and y.
    pub slope: DVec2,
    /// By time.
    pub rate: f64,
}

impl Wave {
    /// A sheet over [-half, half] with two waves; `phase` shifts both.
    pub fn new(half: DVec2, amplitude: f64, phase: f64) -> Self {
        let component = |amplitude: f64, wavelengths: DVec2, period_secs: f64, phase: f64| Component {
            amplitude,
            wave_vector: TAU / wavelengths,
            pulsation: TAU / period_secs,
            phase,
        };
        let components = vec![
            component(0.7 * amplitude, DVec2::new(1.5, 6.0), 1.1, phase),
            component(0.3 * amplitude, DVec2::new(1.1, -1.3), 0.8, 2.0 * phase + 1.0),
        ];
        Self { half, components }
    }

    /// Half the edges of a box that holds the sheet at all times.
    pub fn half_box(&self) -> DVec3 {
        let highest: f64 = self.components.iter().map(|component| component.amplitude).sum();
        self.half.extend(highest)
    }

    /// Height at (x, y).
    pub fn height(&self, x: f64, y: f64, time_secs: f64) -> Height {
        let mut waves = Height::default();
        for Component { amplitude, wave_vector, pulsation, phase } in &self.components {
            let (sin, cos) = (wave_vector.x * x + wave_vector.y * y - pulsation * time_secs + phase).sin_cos();
            waves.value += amplitude * sin;
            waves.slope += *wave_vector * (amplitude * cos);
            waves.rate -= pulsation * amplitude * cos;
        }
        // The envelope is 0 at the fixed edge and 1 at the free one.
        let envelope = 0.5 * (x / self.half.x + 1.0);
        let slope = waves.slope * envelope + DVec2::X * (waves.value * 0.5 / self.half.x);
        Height { value: waves.value * envelope, slope, rate: waves.rate * envelope }
    }

    /// First point of the sheet on the ray, and the normal there.
    pub fn hit(&self, ray: &Ray, time_secs: f64) -> Option<(f64, DVec3)> {
        let (enter, leave) = slab(ray, self.half_box())?;
        let above = |s: f64| {
            let point = ray.at(s);
            let height = self.height(point.x, point.y, time_secs);
            let along = ray.direction.z - height.slope.dot(ray.direction.truncate());
            (point.z - height.value, along, height.slope)
        };
        // Steps of height / (greatest rate of change of the height) never pass the surface.
        let greatest_rate = ray.direction.z.abs() + self.steepest_along(ray.direction.truncate());
        let mut s = enter.max(MIN_DISTANCE);
        for _ in 0..MAX_STEPS {
            let height = above(s).0.abs();
            if height < NEWTON_HEIGHT
                && let Some(found) = newton(&above, s)
            {
                let (_, _, slope) = above(found);
                return (found <= leave).then(|| (found, (-slope).extend(1.0).normalize()));
            }
            s += height.max(1e-6) / greatest_rate;
            if s > leave {
                return None;
            }
        }
        None
    }

    /// A bound on the change of height per step of a direction in the plane.
    fn steepest_along(&self, direction: DVec2) -> f64 {
        let envelope = 0.5 / self.half.x * direction.x.abs();
        let slope = |wave: &Component| wave.amplitude * (wave.wave_vector.dot(direction).abs() + envelope);
        self.components.iter().map(slope).sum()
    }
}

/// Newton's iteration from `start`; a root behind it, or much farther than the first step reaches, is none.
fn newton(above: &impl Fn(f64) -> (f64, f64, DVec2), start: f64) -> Option<f64> {
    let (mut s, mut reach) = (start, None);
    for _ in 0..8 {
        let (height, along, _) = above(s);
        let step = -height / along;
        let reach = *reach.get_or_insert(2.0 * step.abs());
        if height.abs() <= TOLERANCE {
            return (s >= start - 1e-12 && s - start <= reach).then_some(s);
        }
        s += step;
    }
    None
}
