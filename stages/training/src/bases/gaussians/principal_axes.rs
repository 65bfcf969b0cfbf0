//! Axes and standard deviations of a covariance given by a factor, for file formats that store only these.

use glam::{DMat3, DQuat, DVec3};

/// Maximum sweeps over all pairs of columns; three or four reach the precision of f64.
const MAX_SWEEPS: usize = 12;
/// Columns with a smaller cosine are orthogonal up to rounding.
const ORTHOGONAL: f64 = 1e-15;
/// Minimum standard deviation in scene units, so that flat Gaussians have a finite logarithm.
const MIN_SCALE: f64 = 1e-9;

/// Logarithms of the standard deviations and the quaternion (w, x, y, z) of the covariance FFᵀ, F in rows.
///
/// One-sided Jacobi rotations (Hestenes 1958) multiply F from the right until its columns are orthogonal. The columns
/// are then the axes, and their lengths the standard deviations. Small ones keep their precision, which FFᵀ would lose.
pub(crate) fn principal_axes(factor: &[f32]) -> ([f32; 3], [f32; 4]) {
    let rows: [f64; 9] = std::array::from_fn(|at| f64::from(factor[at]));
    let mut columns = DMat3::from_cols_array(&rows).transpose().to_cols_array_2d().map(DVec3::from);
    for _ in 0..MAX_SWEEPS {
        let turned = [(0, 1), (0, 2), (1, 2)].map(|(a, b)| orthogonalise(&mut columns, a, b));
        if turned == [false; 3] {
            break;
        }
    }
    columns.sort_by(|a, b| b.length_squared().total_cmp(&a.length_squared()));
    let log_scales = columns.map(|column| column.length().max(MIN_SCALE).ln() as f32);
    let rotation = DQuat::from_mat3(&right_handed(columns));
    (log_scales, [rotation.w, rotation.x, rotation.y, rotation.z].map(|value| value as f32))
}

/// Rotates two columns within their plane until they are orthogonal; `false` if they already are.
fn orthogonalise(columns: &mut [DVec3; 3], a: usize, b: usize) -> bool {
    let (first, second) = (columns[a], columns[b]);
    let (aa, bb, ab) = (first.length_squared(), second.length_squared(), first.dot(second));
    if ab.abs() <= ORTHOGONAL * (aa * bb).sqrt() {
        return false;
    }
    // The smaller root of t² + 2ζt − 1 = 0 is the tangent of the angle.
    let zeta = (bb - aa) / (2.0 * ab);
    let tangent = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
    let sine = cosine * tangent;
    (columns[a], columns[b]) = (cosine * first - sine * second, sine * first + cosine * second);
    true
}

/// The rotation whose first axes are the directions of the longest columns; missing directions are completed.
fn right_handed([first, second, _]: [DVec3; 3]) -> DMat3 {
    let x = first.try_normalize().unwrap_or(DVec3::X);
    let y = (second - second.dot(x) * x).try_normalize().unwrap_or_else(|| x.any_orthonormal_vector());
    DMat3::from_cols(x, y, x.cross(y))
}

#[cfg(test)]
mod tests {
    use shaders::check::noise;

    use super::*;

    /// R·diag(e²ˢ)·Rᵀ.
    fn covariance((log_scales, [w, x, y, z]): ([f32; 3], [f32; 4])) -> DMat3 {
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x.into(), y.into(), z.into(), w.into()).normalize());
        let variances = DVec3::from(log_scales.map(f64::from)).map(|value| (2.0 * value).exp());
        rotation * DMat3::from_diagonal(variances) * rotation.transpose()
    }

    #[test]
    fn axes_give_back_the_covariance() {
        for seed in 0..50 {
            let mut factor: Vec<f32> = noise(9, seed).iter().map(|&value| value as f32).collect();
            match seed % 5 {
                // A plane, a line, and equal axes.
                0 => factor[6..].fill(0.0),
                1 => factor[3..].fill(0.0),
                2 => factor = vec![0.3, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.3],
                _ => (),
            }
            let rows: [f64; 9] = std::array::from_fn(|at| f64::from(factor[at]));
            let matrix = DMat3::from_cols_array(&rows).transpose();
            let expected = matrix * matrix.transpose();
            let difference = covariance(principal_axes(&factor)) - expected;
            let largest = |m: DMat3| m.to_cols_array().into_iter().fold(0.0_f64, |max, value| max.max(value.abs()));
            assert!(largest(difference) <= 1e-5 * largest(expected), "{factor:?}");
        }
    }

    #[test]
    fn a_zero_covariance_is_a_tiny_ball() {
        let (log_scales, rotation) = principal_axes(&[0.0; 9]);
        assert!(log_scales.iter().all(|value| value.is_finite()));
        assert!((rotation.iter().map(|value| value * value).sum::<f32>() - 1.0).abs() <= 1e-6);
    }
}
