//! The fast f32 body: channels in blocks of `L` lanes, time planes blended once per call.
//!
//! The backward pass runs one task per scale and channel block. Tasks own disjoint channels of the plane gradients and go
//! through the points in order, so that nothing is shared and nothing depends on scheduling.

use pulp::Arch;
use rayon::prelude::*;

use super::lookup::Lookup;
use super::{Field, PAIRS, TIME};
use crate::tape::Real;

/// The planes over two spatial axes, and those over a spatial axis and time, as indices into [`PAIRS`].
const SPATIAL: [usize; 3] = [0, 1, 3];
const TEMPORAL: [usize; 3] = [2, 4, 5];

/// One scale of a field at one time.
struct Scale<'a> {
    resolution: [usize; 4],
    /// Planes xy, xz, yz: [resolution b, resolution a, C].
    planes: [&'a [f32]; 3],
    /// Planes xt, yt, zt at the time: [resolution a, C].
    rows: [Vec<f32>; 3],
    time: Lookup<f32>,
}

/// The field as the fast body reads it.
pub struct Forward<'a> {
    channels: usize,
    scales: Vec<Scale<'a>>,
}

impl<'a> Forward<'a> {
    /// `None` if the scalar type is not f32 or the channels do not fill whole lanes: then the reference runs.
    pub fn new<T: Real>(field: &Field<'a, T>) -> Option<Self> {
        let channels = field.channels();
        let time = field.time.to_f64() as f32;
        let scale_at = |scale| Scale::new(field, scale, time);
        (channels % 4 == 0)
            .then(|| (0..field.scales()).map(scale_at).collect::<Option<_>>())?
            .map(|scales| Self { channels, scales })
    }

    /// Features of `positions` [n, 3] into `out` [n, C·scales].
    pub fn run(&self, positions: &[f32], out: &mut [f32]) {
        match self.channels {
            channels if channels % 16 == 0 => Arch::new().dispatch(|| self.run_lanes::<16>(positions, out)),
            channels if channels % 8 == 0 => Arch::new().dispatch(|| self.run_lanes::<8>(positions, out)),
            _ => Arch::new().dispatch(|| self.run_lanes::<4>(positions, out)),
        }
    }

    #[inline(always)]
    fn run_lanes<const L: usize>(&self, positions: &[f32], out: &mut [f32]) {
        for (point, out) in positions.chunks_exact(3).zip(out.chunks_exact_mut(self.channels * self.scales.len())) {
            for (scale, out) in self.scales.iter().zip(out.chunks_exact_mut(self.channels)) {
                let taps = Taps::new(scale, point, self.channels);
                for (block, out) in out.as_chunks_mut::<L>().0.iter_mut().enumerate() {
                    *out = Corners::<L>::read(scale, &taps, block * L)
                        .values(&taps)
                        .into_iter()
                        .reduce(multiply)
                        .expect("six planes");
                }
            }
        }
    }
}

impl<'a> Scale<'a> {
    fn new<T: Real>(field: &Field<'a, T>, scale: usize, time: f32) -> Option<Self> {
        let resolution = field.resolution(scale);
        let time = Lookup::new(time, resolution[TIME]);
        let plane = |index: usize| T::as_f32(field.planes[6 * scale + index].as_slice());
        let row = |index: usize| {
            let row_len = field.planes[6 * scale + index].row_len();
            let (low, high) = (&plane(index)?[time.low * row_len..][..row_len], &plane(index)?[time.high * row_len..]);
            Some(low.iter().zip(high).map(|(low, high)| (1.0 - time.fraction) * low + time.fraction * high).collect())
        };
        let planes = [plane(SPATIAL[0])?, plane(SPATIAL[1])?, plane(SPATIAL[2])?];
        Some(Self { resolution, planes, rows: [row(TEMPORAL[0])?, row(TEMPORAL[1])?, row(TEMPORAL[2])?], time })
    }
}

/// Where and with which weights one point reads one scale.
struct Taps {
    lookups: [Lookup<f32>; 3],
    /// Texels (low b, low a), (low b, high a), (high b, low a), (high b, high a) of each spatial plane.
    texels: [[usize; 4]; 3],
    channels: usize,
}

impl Taps {
    #[inline(always)]
    fn new(scale: &Scale, point: &[f32], channels: usize) -> Self {
        let lookups: [Lookup<f32>; 3] = std::array::from_fn(|axis| Lookup::new(point[axis], scale.resolution[axis]));
        let texels = SPATIAL.map(|plane| {
            let ((a, b), width) = (PAIRS[plane], scale.resolution[PAIRS[plane].0]);
            let (x, y) = (&lookups[a], &lookups[b]);
            [y.low * width + x.low, y.low * width + x.high, y.high * width + x.low, y.high * width + x.high]
        });
        Self { lookups, texels, channels }
    }

    /// The lookups along a and b of a spatial plane.
    #[inline(always)]
    fn axes(&self, plane: usize) -> (&Lookup<f32>, &Lookup<f32>) {
        let (a, b) = PAIRS[SPATIAL[plane]];
        (&self.lookups[a], &self.lookups[b])
    }
}

/// The texels around one point, `L` channels each.
struct Corners<'a, const L: usize> {
    planes: [[&'a [f32; L]; 4]; 3],
    rows: [[&'a [f32; L]; 2]; 3],
}

impl<'a, const L: usize> Corners<'a, L> {
    #[inline(always)]
    fn read(scale: &'a Scale, taps: &Taps, first_channel: usize) -> Self {
        let lanes = |data: &'a [f32], texel: usize| -> &'a [f32; L] {
            data[texel * taps.channels + first_channel..][..L].try_into().expect("L lanes")
        };
        Self {
            planes: std::array::from_fn(|plane| taps.texels[plane].map(|texel| lanes(scale.planes[plane], texel))),
            rows: std::array::from_fn(|axis| {
                [taps.lookups[axis].low, taps.lookups[axis].high].map(|texel| lanes(&scale.rows[axis], texel))
            }),
        }
    }

    /// The interpolated values of xy, xz, yz and of the rows along x, y, z.
    #[inline(always)]
    fn values(&self, taps: &Taps) -> [[f32; L]; 6] {
        let plane = |plane: usize| {
            let (x, y) = taps.axes(plane);
            let [p00, p01, p10, p11] = self.planes[plane];
            let (low, high) = (mix(p00, p01, x.fraction), mix(p10, p11, x.fraction));
            mix(&low, &high, y.fraction)
        };
        let row = |axis: usize| mix(self.rows[axis][0], self.rows[axis][1], taps.lookups[axis].fraction);
        [plane(0), plane(1), plane(2), row(0), row(1), row(2)]
    }
}

#[inline(always)]
fn mix<const L: usize>(low: &[f32; L], high: &[f32; L], fraction: f32) -> [f32; L] {
    std::array::from_fn(|lane| low[lane] * (1.0 - fraction) + high[lane] * fraction)
}

#[inline(always)]
fn multiply<const L: usize>(a: [f32; L], b: [f32; L]) -> [f32; L] {
    std::array::from_fn(|lane| a[lane] * b[lane])
}

/// Adds the gradients of `dy` to those of positions and planes; `false`, with nothing done, where the reference must run.
pub fn backward<T: Real>(
    field: &Field<T>,
    positions: &[T],
    dy: &[T],
    position_gradients: &mut [T],
    plane_gradients: &mut [Vec<T>],
) -> bool {
    let planes: Option<Vec<&mut [f32]>> = plane_gradients.iter_mut().map(|plane| T::as_f32_mut(plane)).collect();
    match (Forward::new(field), T::as_f32(positions), T::as_f32(dy), T::as_f32_mut(position_gradients), planes) {
        (Some(forward), Some(positions), Some(dy), Some(position_gradients), Some(planes)) => {
            match field.channels() {
                channels if channels % 16 == 0 => forward.backward::<16>(positions, dy, position_gradients, planes),
                channels if channels % 8 == 0 => forward.backward::<8>(positions, dy, position_gradients, planes),
                _ => forward.backward::<4>(positions, dy, position_gradients, planes),
            }
            true
        }
        _ => false,
    }
}

/// Gradients of `L` channels of the six planes of a scale.
struct Task<'a, const L: usize> {
    scale: usize,
    first_channel: usize,
    /// Per plane in the order of [`PAIRS`], the lanes of every texel.
    texels: [Vec<&'a mut [f32; L]>; 6],
}

impl Forward<'_> {
    fn backward<const L: usize>(
        &self,
        positions: &[f32],
        dy: &[f32],
        position_gradients: &mut [f32],
        planes: Vec<&mut [f32]>,
    ) {
        let run = |mut task: Task<L>| Arch::new().dispatch(|| self.run_task(&mut task, positions, dy));
        let parts: Vec<Vec<f32>> = self.tasks(planes).into_par_iter().map(run).collect();
        for part in parts {
            position_gradients.iter_mut().zip(part).for_each(|(total, term)| *total += term);
        }
    }

    fn tasks<'a, const L: usize>(&self, planes: Vec<&'a mut [f32]>) -> Vec<Task<'a, L>> {
        let blocks = self.channels / L;
        let new_task = |index: usize| Task {
            scale: index / blocks,
            first_channel: index % blocks * L,
            texels: std::array::from_fn(|_| Vec::new()),
        };
        let mut tasks: Vec<Task<L>> = (0..self.scales.len() * blocks).map(new_task).collect();
        for (index, plane) in planes.into_iter().enumerate() {
            for (chunk, lanes) in plane.as_chunks_mut::<L>().0.iter_mut().enumerate() {
                tasks[index / 6 * blocks + chunk % blocks].texels[index % 6].push(lanes);
            }
        }
        tasks
    }

    /// Fills the plane gradients of one task; returns its part of the position gradients.
    #[inline(always)]
    fn run_task<const L: usize>(&self, task: &mut Task<L>, positions: &[f32], dy: &[f32]) -> Vec<f32> {
        let scale = &self.scales[task.scale];
        let mut row_gradients: [Vec<[f32; L]>; 3] = std::array::from_fn(|axis| vec![[0.0; L]; scale.resolution[axis]]);
        let mut position_gradients = vec![0.0; positions.len()];
        let first = task.scale * self.channels + task.first_channel;
        for (n, dy) in dy.chunks_exact(self.channels * self.scales.len()).enumerate() {
            let dy: &[f32; L] = dy[first..first + L].try_into().expect("L lanes");
            // Points that no pixel sees have no gradient: nothing to add.
            if dy.iter().all(|&dy| dy == 0.0) {
                continue;
            }
            let taps = Taps::new(scale, &positions[3 * n..3 * n + 3], self.channels);
            let corners = Corners::<L>::read(scale, &taps, task.first_channel);
            let dvalues = value_gradients(&corners.values(&taps), dy);
            scatter(&taps, &dvalues, task, &mut row_gradients);
            position_gradients[3 * n..3 * n + 3].copy_from_slice(&coordinate_gradients(&corners, &taps, &dvalues));
        }
        for (axis, plane) in TEMPORAL.into_iter().enumerate() {
            spread_row(&row_gradients[axis], &scale.time, &mut task.texels[plane]);
        }
        position_gradients
    }
}

/// dy times the product of the other five values, for each of the six.
#[inline(always)]
fn value_gradients<const L: usize>(values: &[[f32; L]; 6], dy: &[f32; L]) -> [[f32; L]; 6] {
    let mut gradients = [*dy; 6];
    for plane in 1..6 {
        gradients[plane] = multiply(gradients[plane - 1], values[plane - 1]);
    }
    let mut after = values[5];
    for plane in (0..5).rev() {
        gradients[plane] = multiply(gradients[plane], after);
        after = multiply(after, values[plane]);
    }
    gradients
}

/// Adds the gradients of the six values to the texels they were read from.
#[inline(always)]
fn scatter<const L: usize>(taps: &Taps, dvalues: &[[f32; L]; 6], task: &mut Task<L>, rows: &mut [Vec<[f32; L]>; 3]) {
    for plane in 0..3 {
        let (x, y) = taps.axes(plane);
        let weights = [
            (1.0 - y.fraction) * (1.0 - x.fraction),
            (1.0 - y.fraction) * x.fraction,
            y.fraction * (1.0 - x.fraction),
            y.fraction * x.fraction,
        ];
        for (texel, weight) in taps.texels[plane].into_iter().zip(weights) {
            add_scaled(task.texels[SPATIAL[plane]][texel], &dvalues[plane], weight);
        }
    }
    for (axis, row) in rows.iter_mut().enumerate() {
        let lookup = &taps.lookups[axis];
        add_scaled(&mut row[lookup.low], &dvalues[3 + axis], 1.0 - lookup.fraction);
        add_scaled(&mut row[lookup.high], &dvalues[3 + axis], lookup.fraction);
    }
}

/// Gradient of the point's x, y, z.
#[inline(always)]
fn coordinate_gradients<const L: usize>(corners: &Corners<L>, taps: &Taps, dvalues: &[[f32; L]; 6]) -> [f32; 3] {
    let mut lanes = [[0.0; L]; 3];
    for plane in 0..3 {
        let ((a, b), (x, y)) = (PAIRS[SPATIAL[plane]], taps.axes(plane));
        let [p00, p01, p10, p11] = corners.planes[plane];
        let (low_b, high_b) = (mix(p00, p01, x.fraction), mix(p10, p11, x.fraction));
        let (low_a, high_a) = (mix(p00, p10, y.fraction), mix(p01, p11, y.fraction));
        for lane in 0..L {
            lanes[a][lane] += dvalues[plane][lane] * (high_a[lane] - low_a[lane]);
            lanes[b][lane] += dvalues[plane][lane] * (high_b[lane] - low_b[lane]);
        }
    }
    for axis in 0..3 {
        let [low, high] = corners.rows[axis];
        for lane in 0..L {
            lanes[axis][lane] += dvalues[3 + axis][lane] * (high[lane] - low[lane]);
        }
    }
    std::array::from_fn(|axis| lanes[axis].iter().sum::<f32>() * taps.lookups[axis].slope)
}

/// Adds the gradient of a row blended at a time to the two rows of its time plane.
#[inline(always)]
fn spread_row<const L: usize>(row: &[[f32; L]], time: &Lookup<f32>, texels: &mut [&mut [f32; L]]) {
    for (texel, gradient) in row.iter().enumerate() {
        add_scaled(texels[time.low * row.len() + texel], gradient, 1.0 - time.fraction);
        add_scaled(texels[time.high * row.len() + texel], gradient, time.fraction);
    }
}

#[inline(always)]
fn add_scaled<const L: usize>(total: &mut [f32; L], term: &[f32; L], factor: f32) {
    for lane in 0..L {
        total[lane] += term[lane] * factor;
    }
}
