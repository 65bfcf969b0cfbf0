//! A waving sheet: z = h(x, y, time) over a rectangle, fixed along the edge x = -half.x.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use crate::ray::{MIN_DISTANCE, Ray, slab};

/// Height above the sheet, in scene units, below which the search changes from safe steps to Newton's method. It is
/// small relative to the wavelengths, so that Newton's method converges to the nearest root.
const NEWTON_HEIGHT: f64 = 5e-3;
/// Largest residual height of a hit, in scene units.
const TOLERANCE: f64 = 1e-13;
/// Maximum number of safe steps, after which a grazing ray counts as a miss.
const MAX_STEPS: usize = 400;

/// One travelling sine wave.
#[derive(Clone, Copy, Debug)]
struct Component {
    amplitude: f64,
    wave_vector: DVec2,
    pulsation: f64,
    phase: f64,
}

/// A sum of travelling waves whose amplitude grows linearly from the fixed edge.
#[derive(Clone, Debug)]
pub(crate) struct Wave {
    half: DVec2,
    components: Vec<Component>,
}

/// Height of the sheet at a point, with its derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Height {
    /// Height z.
    pub(crate) value: f64,
    /// Derivatives with respect to x and y.
    pub(crate) slope: DVec2,
    /// Derivative with respect to time, per second.
    pub(crate) rate: f64,
}

impl Wave {
    /// A sheet over [-half, half] with two waves, both shifted by `phase`.
    pub(crate) fn new(half: DVec2, amplitude: f64, phase: f64) -> Self {
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

    /// Half the edge lengths of a box that contains the sheet at all times.
    pub(crate) fn half_box(&self) -> DVec3 {
        let highest: f64 = self.components.iter().map(|component| component.amplitude).sum();
        self.half.extend(highest)
    }

    /// Height and derivatives at (x, y).
    pub(crate) fn height(&self, x: f64, y: f64, time_secs: f64) -> Height {
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

    /// The first hit of a ray: its distance and the unit normal.
    pub(crate) fn hit(&self, ray: &Ray, time_secs: f64) -> Option<(f64, DVec3)> {
        let (enter, leave) = slab(ray, self.half_box())?;
        let above = |s: f64| {
            let point = ray.at(s);
            let height = self.height(point.x, point.y, time_secs);
            let along = ray.direction.z - height.slope.dot(ray.direction.truncate());
            (point.z - height.value, along, height.slope)
        };
        // A step of height / (upper bound of the rate of change of the height) never passes the surface.
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

    /// Upper bound on the change of height per step along a direction in the plane.
    fn steepest_along(&self, direction: DVec2) -> f64 {
        let envelope = 0.5 / self.half.x * direction.x.abs();
        let slope = |wave: &Component| wave.amplitude * (wave.wave_vector.dot(direction).abs() + envelope);
        self.components.iter().map(slope).sum()
    }
}

/// Newton's method from `start`; rejects a root that lies before it or much farther than the first step.
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
