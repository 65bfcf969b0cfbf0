//! Views at a reduced size: exact intrinsics, and images averaged over areas.

use rayon::prelude::*;
use shaders::geometry::camera::PinholeCamera;
use shaders::tape::Tensor;

use super::LoadedView;

/// Smallest side of a reduced image, unless the full image is smaller.
const MIN_SIDE_PX: usize = 8;

/// The reduced length of a side.
fn reduced_side(side: usize, reduction: usize) -> usize {
    side.div_ceil(reduction).max(MIN_SIDE_PX.min(side))
}

/// The camera of an image that shows the same field of view in fewer pixels: continuous pixel coordinates scale with
/// the size, and so do focal lengths and principal point.
pub(crate) fn reduced_camera(camera: &PinholeCamera, reduction: usize) -> PinholeCamera {
    let (width, height) = (reduced_side(camera.width, reduction), reduced_side(camera.height, reduction));
    let scales = [width as f64 / camera.width as f64, height as f64 / camera.height as f64];
    let scaled = |values: [f64; 2]| [values[0] * scales[0], values[1] * scales[1]];
    PinholeCamera { width, height, focal: scaled(camera.focal), center: scaled(camera.center), ..*camera }
}

impl LoadedView {
    /// The image with 1/`reduction` of its width and height, [H, W, 3] in [0, 1]: each pixel is the mean over its area.
    pub(crate) fn image_reduced_by(&self, reduction: usize) -> Tensor<f32> {
        if reduction == 1 {
            return self.image();
        }
        let camera = reduced_camera(&self.camera, reduction);
        let size = [self.camera.width, self.camera.height];
        let values = area_means(&self.pixels, 3, size, [camera.width, camera.height]);
        Tensor::from_vec([camera.height, camera.width, 3], values)
    }
}

/// 8-bit values [H, W, channels] in [0, 1], averaged over the areas of fewer pixels; sizes are width and height.
pub(crate) fn area_means(values: &[u8], channels: usize, from: [usize; 2], to: [usize; 2]) -> Vec<f32> {
    let [columns, rows] = [0, 1].map(|axis| areas(from[axis], to[axis]));
    let mean = |row: &Vec<(usize, f32)>| {
        let mut sums = vec![0.0_f32; from[0] * channels];
        for &(y, weight) in row {
            let line = &values[y * from[0] * channels..][..from[0] * channels];
            sums.iter_mut().zip(line).for_each(|(sum, &value)| *sum += weight / 255.0 * f32::from(value));
        }
        let of_column = |column: &Vec<(usize, f32)>, channel: usize| -> f32 {
            column.iter().map(|&(x, weight)| weight * sums[x * channels + channel]).sum()
        };
        columns
            .iter()
            .flat_map(|column| (0..channels).map(|channel| of_column(column, channel)).collect::<Vec<_>>())
            .collect::<Vec<f32>>()
    };
    rows.par_iter().map(mean).collect::<Vec<_>>().concat()
}

/// Per new pixel along a side, the old pixels that it covers and the shares of its area; the shares sum to 1.
fn areas(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let step = from as f64 / to as f64;
    let area = |at: usize| {
        let (start, end) = (at as f64 * step, (at + 1) as f64 * step);
        let covered = start.floor() as usize..(end.ceil() as usize).min(from);
        let share = |old: usize| (end.min((old + 1) as f64) - start.max(old as f64)) / step;
        covered.map(|old| (old, share(old) as f32)).filter(|(_, share)| *share > 1e-6).collect()
    };
    (0..to).map(area).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_the_mean_over_its_area() {
        let values: Vec<u8> = (0..4 * 6 * 3).map(|at| (at * 37 % 251) as u8).collect();
        let small = area_means(&values, 3, [4, 6], [2, 3]);
        for (y, x, channel) in [(0, 0, 0), (2, 1, 1), (1, 1, 2)] {
            let old = |dy: usize, dx: usize| f64::from(values[((2 * y + dy) * 4 + 2 * x + dx) * 3 + channel]);
            let expected = (old(0, 0) + old(0, 1) + old(1, 0) + old(1, 1)) / 4.0 / 255.0;
            let found = f64::from(small[(y * 2 + x) * 3 + channel]);
            assert!((found - expected).abs() <= 1e-6, "{found} instead of {expected}");
        }
        // A size that does not divide evenly keeps the mean of the image.
        let [all, few] = [[4, 6], [3, 4]].map(|to| area_means(&values, 3, [4, 6], to));
        let mean = |values: &[f32]| values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64;
        assert!((mean(&all) - mean(&few)).abs() <= 1e-6);
        assert_eq!(all, values.iter().map(|&value| f32::from(value) * (1.0 / 255.0)).collect::<Vec<_>>());
    }

    #[test]
    fn a_reduced_camera_has_the_same_rays() {
        let camera = PinholeCamera {
            width: 50,
            height: 31,
            focal: [60.0, 61.0],
            center: [24.0, 16.5],
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        };
        let small = reduced_camera(&camera, 3);
        assert_eq!([small.width, small.height], [17, 11]);
        for corner in [[0.0, 0.0], [1.0, 0.3], [1.0, 1.0]] {
            let ray = |camera: &PinholeCamera| {
                let sizes = [camera.width as f64, camera.height as f64];
                [0, 1].map(|axis| (corner[axis] * sizes[axis] - camera.center[axis]) / camera.focal[axis])
            };
            assert!(ray(&camera).iter().zip(ray(&small)).all(|(a, b)| (a - b).abs() <= 1e-12));
        }
        assert_eq!(reduced_camera(&camera, 8).height, MIN_SIDE_PX);
    }
}
