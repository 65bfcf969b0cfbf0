//! The rotation between two lists of vectors.

use super::Quaternion;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};
use crate::tape::{Device, Real, Tape, Tensor, Var};

const FIT: Kernel = Kernel { name: "best rotations", text: include_str!("fit.wgsl") };

/// Sweeps of Jacobi's method: it converges quadratically, four or five reach the precision of f64.
const SWEEPS: usize = 8;
/// Off-diagonal elements below this share of the diagonal count as 0: they are below the rounding of f64.
const NEGLIGIBLE: f64 = 1e-18;

uniforms! {
    struct FitBlock as "Fit" {
        owners: u32,
        per_owner: u32,
    }
}

/// For vectors e and e' [M·K, 3], K consecutive ones per owner, the rotation R of every vector [M·K, 4]: the rotation of its
/// owner that minimises Σ ‖e' − Re‖² over the owner's vectors (Horn 1987). Unlike the result of a singular value decomposition,
/// it is never a reflection; without motion or constraints it is the identity.
///
/// The result is detached: at the minimum, the derivative of the sum with respect to R vanishes.
pub fn best_rotations<T: Real>(tape: &mut Tape<T>, before: Var, after: Var, per_owner: usize) -> Var {
    let [of_before, of_after] = [before, after].map(|vectors| tape.value(vectors));
    assert_eq!(of_before.shape(), of_after.shape(), "best_rotations: numbers of vectors differ");
    assert!(of_before.rows().is_multiple_of(per_owner), "best_rotations: vectors without an owner");
    let rotations = match tape.device() {
        Device::Cpu => on_cpu(of_before, of_after, per_owner),
        Device::Gpu(gpu) => on_gpu(gpu, of_before, of_after, per_owner),
    };
    tape.detach_value(rotations)
}

fn on_cpu<T: Real>(before: &Tensor<T>, after: &Tensor<T>, per_owner: usize) -> Tensor<T> {
    let mut rotations = Vec::with_capacity(4 * before.rows());
    for first in (0..before.rows()).step_by(per_owner) {
        let mut correlation = [[0.0; 3]; 3];
        for vector in first..first + per_owner {
            let [from, to] = [before, after].map(|vectors| [0, 1, 2].map(|axis| vectors.row(vector)[axis].to_f64()));
            for (row, column) in (0..9).map(|at| (at / 3, at % 3)) {
                correlation[row][column] += from[row] * to[column];
            }
        }
        rotations.extend(best_rotation(&correlation).map(T::from_f64).repeat(per_owner));
    }
    Tensor::from_vec([before.rows(), 4], rotations)
}

fn on_gpu<T: Real>(gpu: Gpu, before: &Tensor<T>, after: &Tensor<T>, per_owner: usize) -> Tensor<T> {
    let (vectors, owners) = (before.rows(), before.rows() / per_owner);
    let rotations = GpuArray::new(gpu, 4 * vectors);
    let block = FitBlock { owners: owners as u32, per_owner: per_owner as u32 };
    let read = [before, after].map(|vectors| Binding::Read(vectors.on_gpu(gpu)));
    FIT.launch(gpu, &[], &block, &[&read[..], &[Binding::Write(&rotations)]].concat(), Groups::Over(owners));
    Tensor::from_gpu([vectors, 4], rotations)
}

/// The unit quaternion that maximises Σ e'·Re for the correlation Σ e·e'ᵀ: the leading eigenvector of a symmetric matrix.
fn best_rotation(s: &[[f64; 3]; 3]) -> Quaternion<f64> {
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *s;
    leading_eigenvector([
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ])
}

/// The unit eigenvector of the largest eigenvalue of a symmetric matrix: cyclic Jacobi rotations (Golub and Van Loan,
/// section 8.5).
fn leading_eigenvector(mut a: [[f64; 4]; 4]) -> [f64; 4] {
    let mut vectors = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            if a[p][q].abs() <= NEGLIGIBLE * (a[p][p].abs() + a[q][q].abs()) {
                continue;
            }
            let ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let tangent = ratio.signum() / (ratio.abs() + ratio.hypot(1.0));
            let cosine = 1.0 / tangent.hypot(1.0);
            let turn = |x: f64, y: f64| (cosine * (x - tangent * y), cosine * (tangent * x + y));
            for row in a.iter_mut().chain(&mut vectors) {
                (row[p], row[q]) = turn(row[p], row[q]);
            }
            for (column, (x, y)) in a[p].into_iter().zip(a[q]).enumerate() {
                (a[p][column], a[q][column]) = turn(x, y);
            }
        }
    }
    let largest = (1..4).fold(0, |best, at| if a[at][at] > a[best][best] { at } else { best });
    vectors.map(|row| row[largest])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::conformance::{Tolerance, compare};
    use crate::check::noise;
    use crate::geometry::quaternion::rotate;
    use crate::gpu::fault_tests::assert_noticed;
    use crate::gpu::layout_tests::assert_valid;
    use crate::gpu::tests::test_gpu;

    #[test]
    fn the_kernel_is_valid() {
        assert_valid::<FitBlock>(&FIT, &[]);
    }

    /// Vectors, and the vectors rotated by a different angle per owner plus noise; those of the first owner do not move, those
    /// of the second are zero.
    fn vectors(owners: usize, per_owner: usize) -> [Tensor<f32>; 2] {
        let count = owners * per_owner;
        let (mut before, noise) = (noise(3 * count, 1), noise(3 * count, 2));
        before.iter_mut().skip(3 * per_owner).take(3 * per_owner).for_each(|value| *value = 0.0);
        let turned = |at: usize| {
            let [x, y, z] = [0, 1, 2].map(|axis| before[3 * at + axis]);
            let owner = at / per_owner;
            let (sin, cos) = (0.37 * owner as f64).sin_cos();
            let shift = |axis: usize| if owner < 2 { 0.0 } else { 0.05 * noise[3 * at + axis] };
            [cos * x - sin * y + shift(0), sin * x + cos * y + shift(1), z + shift(2)]
        };
        let after: Vec<f64> = (0..count).flat_map(turned).collect();
        [before, after].map(|values| Tensor::from_vec([count, 3], values).cast())
    }

    fn compare_fits(
        gpu: Gpu,
        owners: usize,
        per_owner: usize,
    ) -> Result<usize, crate::check::conformance::Disagreement> {
        let tolerance = Tolerance { value: 2e-5, gradient: 1e-4 };
        compare(gpu, &format!("{owners} owners"), &vectors(owners, per_owner), tolerance, |tape, vars| {
            let rotations = best_rotations(tape, vars[0], vars[1], per_owner);
            // Rotating removes the ambiguity of the quaternion's sign.
            vec![rotate(tape, rotations, vars[0])]
        })
    }

    #[test]
    fn a_gpu_finds_the_rotations_that_the_cpu_finds() {
        let Some(gpu) = test_gpu() else { return };
        for (owners, per_owner) in [(0, 1), (1, 3), (3, 4), (63, 8), (65, 4), (300, 20)] {
            compare_fits(gpu, owners, per_owner).unwrap();
        }
        let faults = [
            ("best rotations", "edge.x * later.y", "edge.y * later.x"),
            ("best rotations", "cosine * (x - tangent * y)", "cosine * (x + tangent * y)"),
            ("best rotations", "a[at][at] > a[largest][largest]", "a[at][at] < a[largest][largest]"),
        ];
        assert_noticed(&faults, || compare_fits(gpu, 40, 5));
    }

    #[test]
    fn vectors_that_turn_have_that_rotation() {
        let [before, after] = vectors(9, 6);
        let found = on_cpu(&before, &after, 6);
        for owner in 2..9 {
            let half = 0.5 * 0.37 * owner as f64;
            let along: f64 = found
                .row(6 * owner)
                .iter()
                .zip([half.cos(), 0.0, 0.0, half.sin()])
                .map(|(a, b)| f64::from(*a) * b)
                .sum();
            assert!(along.abs() >= 0.995, "owner {owner}: {along}");
        }
        assert_eq!(found.row(0), [1.0, 0.0, 0.0, 0.0], "without motion");
        assert_eq!(found.row(6), [1.0, 0.0, 0.0, 0.0], "nothing says otherwise");
    }
}
