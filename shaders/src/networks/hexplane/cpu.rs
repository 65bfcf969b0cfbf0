//! The fast f32 body: channels in blocks of `L` lanes, time planes blended once per call.
//!
//! The backward pass runs one task per scale and channel block. Tasks own disjoint channels of the plane gradients and go
//! through the points in one order (see [`points_by_cell`]), so that nothing is shared and nothing depends on scheduling.

use rayon::prelude::*;

use super::lookup::Lookup;
use super::order::points_by_cell;
use super::{Field, PAIRS, TIME};
use crate::tape::Real;
use crate::tape::simd::multiversion;

/// The planes over two spatial axes, and those over a spatial axis and time, as indices into [`PAIRS`].
const SPATIAL: [usize; 3] = [0, 1, 3];
const TEMPORAL: [usize; 3] = [2, 4, 5];

/// Channels of a task of the backward pass, which then owns whole cache lines.
const CACHE_LINE: usize = 16;

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
pub(super) struct Forward<'a> {
    channels: usize,
    scales: Vec<Scale<'a>>,
}

impl<'a> Forward<'a> {
    /// `None` if the scalar type is not f32 or the channels do not fill whole lanes; the reference runs instead.
    pub(super) fn new<T: Real>(field: &Field<'a, T>) -> Option<Self> {
        let channels = field.channels();
        let time = field.time.to_f64() as f32;
        let scale_at = |scale| Scale::new(field, scale, time);
        channels
            .is_multiple_of(4)
            .then(|| (0..field.scales()).map(scale_at).collect::<Option<_>>())?
            .map(|scales| Self { channels, scales })
    }

    /// Features of `positions` [n, 3] into `out` [n, C·scales].
    pub(super) fn run(&self, positions: &[f32], out: &mut [f32]) {
        match self.channels {
            channels if channels.is_multiple_of(16) => sample::<16>(self, positions, out),
            channels if channels.is_multiple_of(8) => sample::<8>(self, positions, out),
            _ => sample::<4>(self, positions, out),
        }
    }
}

multiversion! {
    fn sample<const L: usize>(field: &Forward, positions: &[f32], out: &mut [f32]) = sample_body
}

#[inline(always)]
fn sample_body<const L: usize>(field: &Forward, positions: &[f32], out: &mut [f32]) {
    for (point, out) in positions.chunks_exact(3).zip(out.chunks_exact_mut(field.channels * field.scales.len())) {
        for (scale, out) in field.scales.iter().zip(out.chunks_exact_mut(field.channels)) {
            let taps = Taps::new(scale, point, field.channels);
            for (block, out) in out.as_chunks_mut::<L>().0.iter_mut().enumerate() {
                let values = values::<L>(scale, &taps, block * L);
                for lane in 0..L {
                    let spatial = values[0][lane] * values[1][lane] * values[2][lane];
                    out[lane] = spatial * (values[3][lane] * values[4][lane] * values[5][lane]);
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
    channels: usize,
    lookups: [Lookup<f32>; 3],
    /// Texels (low b, low a), (low b, high a), (high b, low a), (high b, high a) of each spatial plane, and their weights.
    texels: [[usize; 4]; 3],
    weights: [[f32; 4]; 3],
}

impl Taps {
    #[inline(always)]
    fn new(scale: &Scale, point: &[f32], channels: usize) -> Self {
        let lookup = |axis: usize| Lookup::new(point[axis], scale.resolution[axis]);
        let lookups = [lookup(0), lookup(1), lookup(2)];
        let mut taps = Self { channels, lookups, texels: [[0; 4]; 3], weights: [[0.0; 4]; 3] };
        for (plane, &index) in SPATIAL.iter().enumerate() {
            let (x, y) = (&lookups[PAIRS[index].0], &lookups[PAIRS[index].1]);
            let (low, high) = (y.low * scale.resolution[PAIRS[index].0], y.high * scale.resolution[PAIRS[index].0]);
            let (fx, fy) = (x.fraction, y.fraction);
            taps.texels[plane] = [low + x.low, low + x.high, high + x.low, high + x.high];
            taps.weights[plane] = [(1.0 - fy) * (1.0 - fx), (1.0 - fy) * fx, fy * (1.0 - fx), fy * fx];
        }
        taps
    }

    /// `L` channels of one texel.
    #[inline(always)]
    fn lanes<'a, const L: usize>(&self, data: &'a [f32], texel: usize, first_channel: usize) -> &'a [f32; L] {
        data[texel * self.channels + first_channel..][..L].try_into().expect("L lanes")
    }

    /// `L` channels of the four texels around the point on a spatial plane.
    #[inline(always)]
    fn corners<'a, const L: usize>(&self, scale: &'a Scale, plane: usize, first_channel: usize) -> [&'a [f32; L]; 4] {
        let [t00, t01, t10, t11] = self.texels[plane];
        let data = scale.planes[plane];
        let lanes = |texel| self.lanes(data, texel, first_channel);
        [lanes(t00), lanes(t01), lanes(t10), lanes(t11)]
    }

    /// `L` channels of the two texels around the point on a row.
    #[inline(always)]
    fn ends<'a, const L: usize>(&self, scale: &'a Scale, axis: usize, first_channel: usize) -> [&'a [f32; L]; 2] {
        let (row, lookup) = (&scale.rows[axis], &self.lookups[axis]);
        [self.lanes(row, lookup.low, first_channel), self.lanes(row, lookup.high, first_channel)]
    }
}

/// The interpolated values of xy, xz, yz and of the rows along x, y, z.
#[inline(always)]
fn values<const L: usize>(scale: &Scale, taps: &Taps, first_channel: usize) -> [[f32; L]; 6] {
    let mut values = [[0.0; L]; 6];
    for index in 0..3 {
        let [p00, p01, p10, p11] = taps.corners::<L>(scale, index, first_channel);
        let [w00, w01, w10, w11] = taps.weights[index];
        let [low, high] = taps.ends::<L>(scale, index, first_channel);
        let fraction = taps.lookups[index].fraction;
        for lane in 0..L {
            values[index][lane] = (p00[lane] * w00 + p01[lane] * w01) + (p10[lane] * w10 + p11[lane] * w11);
            values[3 + index][lane] = low[lane] * (1.0 - fraction) + high[lane] * fraction;
        }
    }
    values
}

#[inline(always)]
fn multiply<const L: usize>(a: [f32; L], b: [f32; L]) -> [f32; L] {
    let mut product = [0.0; L];
    for lane in 0..L {
        product[lane] = a[lane] * b[lane];
    }
    product
}

/// Adds the gradients of `dy` to those of positions and planes; `false`, with nothing done, where the reference must run.
pub(super) fn backward<T: Real>(
    field: &Field<T>,
    positions: &[T],
    dy: &[T],
    position_gradients: &mut [T],
    plane_gradients: &mut [&mut [T]],
) -> bool {
    let planes: Option<Vec<&mut [f32]>> = plane_gradients.iter_mut().map(|plane| T::as_f32_mut(plane)).collect();
    match (Forward::new(field), T::as_f32(positions), T::as_f32(dy), T::as_f32_mut(position_gradients), planes) {
        (Some(forward), Some(positions), Some(dy), Some(position_gradients), Some(planes)) => {
            match field.channels().is_multiple_of(8) {
                true => forward.backward::<8>(positions, dy, position_gradients, planes),
                false => forward.backward::<4>(positions, dy, position_gradients, planes),
            }
            true
        }
        _ => false,
    }
}

/// Gradients of some channels of the six planes of a scale.
struct Task<'a> {
    scale: usize,
    first_channel: usize,
    channels: usize,
    /// Per plane in the order of [`PAIRS`], the channels of every texel.
    texels: [Vec<&'a mut [f32]>; 6],
}

impl Forward<'_> {
    fn backward<const L: usize>(
        &self,
        positions: &[f32],
        dy: &[f32],
        position_gradients: &mut [f32],
        planes: Vec<&mut [f32]>,
    ) {
        let order = points_by_cell(positions, dy, self.channels * self.scales.len());
        let run = |mut task: Task| run_task::<L>(self, &mut task, &order, positions, dy);
        let parts: Vec<Vec<f32>> = self.tasks(planes).into_par_iter().map(run).collect();
        for part in parts {
            position_gradients.iter_mut().zip(part).for_each(|(total, term)| *total += term);
        }
    }

    fn tasks<'a>(&self, planes: Vec<&'a mut [f32]>) -> Vec<Task<'a>> {
        let channels = if self.channels.is_multiple_of(CACHE_LINE) { CACHE_LINE } else { self.channels };
        let parts = self.channels / channels;
        let new_task = |index: usize| Task {
            scale: index / parts,
            first_channel: index % parts * channels,
            channels,
            texels: std::array::from_fn(|_| Vec::new()),
        };
        let mut tasks: Vec<Task> = (0..self.scales.len() * parts).map(new_task).collect();
        for (index, plane) in planes.into_iter().enumerate() {
            for (chunk, lanes) in plane.chunks_exact_mut(channels).enumerate() {
                tasks[index / 6 * parts + chunk % parts].texels[index % 6].push(lanes);
            }
        }
        tasks
    }
}

multiversion! {
    /// Adds the gradients of the planes of one task; returns its part of the position gradients.
    fn run_task<const L: usize>(field: &Forward, task: &mut Task, order: &[u32], positions: &[f32], dy: &[f32]) -> Vec<f32> = run_task_body
}

#[inline(always)]
fn run_task_body<const L: usize>(
    field: &Forward,
    task: &mut Task,
    order: &[u32],
    positions: &[f32],
    dy: &[f32],
) -> Vec<f32> {
    let scale = &field.scales[task.scale];
    let mut rows = [0, 1, 2].map(|axis| vec![0.0; scale.resolution[axis] * task.channels]);
    let mut position_gradients = vec![0.0; positions.len()];
    let features = field.channels * field.scales.len();
    for n in order.iter().map(|&n| n as usize) {
        let taps = Taps::new(scale, &positions[3 * n..3 * n + 3], field.channels);
        let dy = &dy[n * features + task.scale * field.channels + task.first_channel..][..task.channels];
        let mut along = [[0.0; L]; 3];
        // One register per plane and block: nothing of the chain rule goes through memory.
        for (block, dy) in dy.as_chunks::<L>().0.iter().enumerate() {
            let readings = read::<L>(scale, &taps, task.first_channel + block * L);
            let dvalues = value_gradients(&readings, dy);
            scatter(&taps, &dvalues, task, &mut rows, block * L);
            add_slopes(&readings, &dvalues, &mut along);
        }
        for axis in 0..3 {
            position_gradients[3 * n + axis] = sum_lanes(along[axis]) * taps.lookups[axis].slope;
        }
    }
    for (axis, plane) in TEMPORAL.into_iter().enumerate() {
        spread_row::<L>(&rows[axis], &scale.time, task.channels, &mut task.texels[plane]);
    }
    position_gradients
}

/// A point's reading of a plane: the value and its derivatives along the plane's two axes, in texels. A row has only the
/// first axis.
#[derive(Copy, Clone)]
struct Reading<const L: usize> {
    value: [f32; L],
    along_a: [f32; L],
    along_b: [f32; L],
}

/// Readings of xy, xz, yz and of the rows along x, y, z.
#[inline(always)]
fn read<const L: usize>(scale: &Scale, taps: &Taps, first_channel: usize) -> [Reading<L>; 6] {
    let zero = [0.0; L];
    let mut readings = [Reading { value: zero, along_a: zero, along_b: zero }; 6];
    for index in 0..3 {
        let (a, b) = PAIRS[SPATIAL[index]];
        let (fx, fy) = (taps.lookups[a].fraction, taps.lookups[b].fraction);
        let [p00, p01, p10, p11] = taps.corners::<L>(scale, index, first_channel);
        let [low, high] = taps.ends::<L>(scale, index, first_channel);
        let [on_plane, on_row] = [index, 3 + index];
        for lane in 0..L {
            let (step_low, step_high) = (p01[lane] - p00[lane], p11[lane] - p10[lane]);
            let (at_low, at_high) = (p00[lane] + step_low * fx, p10[lane] + step_high * fx);
            readings[on_plane].along_a[lane] = step_low + (step_high - step_low) * fy;
            readings[on_plane].along_b[lane] = at_high - at_low;
            readings[on_plane].value[lane] = at_low + (at_high - at_low) * fy;
            readings[on_row].along_a[lane] = high[lane] - low[lane];
            readings[on_row].value[lane] = low[lane] + (high[lane] - low[lane]) * taps.lookups[index].fraction;
        }
    }
    readings
}

/// dy times the product of the other five values, for each of the six.
#[inline(always)]
fn value_gradients<const L: usize>(readings: &[Reading<L>; 6], dy: &[f32; L]) -> [[f32; L]; 6] {
    let mut gradients = [*dy; 6];
    for plane in 1..6 {
        gradients[plane] = multiply(gradients[plane - 1], readings[plane - 1].value);
    }
    let mut after = readings[5].value;
    for plane in (0..5).rev() {
        gradients[plane] = multiply(gradients[plane], after);
        after = multiply(after, readings[plane].value);
    }
    gradients
}

/// Adds the gradients of the six values to the texels they were read from.
#[inline(always)]
fn scatter<const L: usize>(
    taps: &Taps,
    dvalues: &[[f32; L]; 6],
    task: &mut Task,
    rows: &mut [Vec<f32>; 3],
    first: usize,
) {
    for plane in 0..3 {
        let texels = &mut task.texels[SPATIAL[plane]];
        for corner in 0..4 {
            let texel = &mut texels[taps.texels[plane][corner]][first..];
            add_scaled(texel, &dvalues[plane], taps.weights[plane][corner]);
        }
    }
    for (axis, row) in rows.iter_mut().enumerate() {
        let Lookup { low, high, fraction, .. } = taps.lookups[axis];
        for (texel, weight) in [(low, 1.0 - fraction), (high, fraction)] {
            add_scaled(&mut row[texel * task.channels + first..], &dvalues[3 + axis], weight);
        }
    }
}

/// Adds, lane by lane, the derivatives along x, y and z in texels.
#[inline(always)]
fn add_slopes<const L: usize>(readings: &[Reading<L>; 6], dvalues: &[[f32; L]; 6], along: &mut [[f32; L]; 3]) {
    let [xy, xz, yz, x, y, z] = readings;
    let [dxy, dxz, dyz, dx, dy, dz] = dvalues;
    for lane in 0..L {
        let (dxy, dxz, dyz, dx, dy, dz) = (dxy[lane], dxz[lane], dyz[lane], dx[lane], dy[lane], dz[lane]);
        along[0][lane] += (dxy * xy.along_a[lane] + dxz * xz.along_a[lane]) + dx * x.along_a[lane];
        along[1][lane] += (dxy * xy.along_b[lane] + dyz * yz.along_a[lane]) + dy * y.along_a[lane];
        along[2][lane] += (dxz * xz.along_b[lane] + dyz * yz.along_b[lane]) + dz * z.along_a[lane];
    }
}

/// The sum by halving, which the compiler can do within vector registers.
#[inline(always)]
fn sum_lanes<const L: usize>(mut lanes: [f32; L]) -> f32 {
    let mut half = L / 2;
    while half > 0 {
        for lane in 0..half {
            lanes[lane] += lanes[lane + half];
        }
        half /= 2;
    }
    lanes[0]
}

/// Adds the gradient of a row blended at a time to the two rows of its time plane.
#[inline(always)]
fn spread_row<const L: usize>(row: &[f32], time: &Lookup<f32>, channels: usize, texels: &mut [&mut [f32]]) {
    let width = row.len() / channels;
    for (texel, gradient) in row.chunks_exact(channels).enumerate() {
        for (block, gradient) in gradient.as_chunks::<L>().0.iter().enumerate() {
            add_scaled(&mut texels[time.low * width + texel][block * L..], gradient, 1.0 - time.fraction);
            add_scaled(&mut texels[time.high * width + texel][block * L..], gradient, time.fraction);
        }
    }
}

/// Adds to the first `L` elements.
#[inline(always)]
fn add_scaled<const L: usize>(total: &mut [f32], term: &[f32; L], factor: f32) {
    let total: &mut [f32; L] = (&mut total[..L]).try_into().expect("L lanes");
    for lane in 0..L {
        total[lane] += term[lane] * factor;
    }
}
