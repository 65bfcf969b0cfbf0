//! Colours that change with time: a Fourier series of spherical harmonics (Yang et al. 2024, "Real-time photorealistic
//! dynamic scene representation and rendering with 4D Gaussian splatting", equation 10).

mod gpu;
#[cfg(test)]
mod tests;

use std::f64::consts::TAU;

use crate::arrays::rows::{RowMap, map_rows, reshape};
use crate::gpu::Gpu;
use crate::tape::{Real, Tape, Tensor, Var};

/// Σₙ cos(2πn(t − μₜ))·wₙ, n = 1, 2, …: the time-dependent part of the harmonics at the time t in [0, 1].
///
/// `waves` [M, W·K, 3] holds K = `stored` coefficients for each of W waves, `times` [M, 1] the μₜ. The first `count`
/// coefficients of each wave are used; the result is [M, count, 3].
pub fn temporal_harmonics<T: Real>(
    tape: &mut Tape<T>,
    waves: Var,
    times: Var,
    time: f64,
    stored: usize,
    count: usize,
) -> Var {
    assert!(count <= stored, "temporal_harmonics: {count} of {stored} coefficients");
    let rows = tape.value(waves).rows();
    let sum = map_rows(tape, Waves { time, stored: 3 * stored, used: 3 * count }, [waves, times]);
    reshape(tape, sum, [rows, count, 3])
}

/// The sum of one row's waves; lengths in values.
struct Waves {
    time: f64,
    stored: usize,
    used: usize,
}

impl Waves {
    /// The frequency 2πn of each wave with its coefficients in use.
    fn each<'a, T: Real>(&self, waves: &'a [T]) -> impl Iterator<Item = (T, &'a [T])> {
        let used = self.used;
        let wave = move |(n, wave): (usize, &'a [T])| (T::from_f64(TAU * (n + 1) as f64), &wave[..used]);
        waves.chunks_exact(self.stored).enumerate().map(wave)
    }
}

impl RowMap<2> for Waves {
    const NAME: &'static str = "temporal_harmonics";

    fn output_columns(&self, [waves, times]: [usize; 2]) -> usize {
        assert!(times == 1 && waves.is_multiple_of(self.stored), "temporal_harmonics: {waves} values, {times} times");
        self.used
    }

    fn value<T: Real>(&self, [waves, time]: [&[T]; 2], y: &mut [T]) {
        let offset = T::from_f64(self.time) - time[0];
        y.fill(T::ZERO);
        for (frequency, wave) in self.each(waves) {
            let weight = (frequency * offset).cos();
            y.iter_mut().zip(wave).for_each(|(y, &value)| *y += weight * value);
        }
    }

    fn gradient<T: Real>(&self, [waves, time]: [&[T]; 2], _y: &[T], dy: &[T], [d_waves, d_time]: [&mut [T]; 2]) {
        let offset = T::from_f64(self.time) - time[0];
        for ((frequency, wave), d_wave) in self.each(waves).zip(d_waves.chunks_exact_mut(self.stored)) {
            let phase = frequency * offset;
            let weight = phase.cos();
            d_wave.iter_mut().zip(dy).for_each(|(d, &dy)| *d = weight * dy);
            let product: T = wave.iter().zip(dy).map(|(&value, &dy)| value * dy).sum();
            d_time[0] += frequency * phase.sin() * product;
        }
    }

    fn value_gpu<T: Real>(&self, gpu: Gpu, inputs: [&Tensor<T>; 2]) -> Option<Tensor<T>> {
        Some(self.value_on_gpu(gpu, inputs))
    }

    fn gradient_gpu<T: Real>(
        &self,
        gpu: Gpu,
        inputs: [&Tensor<T>; 2],
        _y: &Tensor<T>,
        dy: &Tensor<T>,
    ) -> [Tensor<T>; 2] {
        self.gradient_on_gpu(gpu, inputs, dy)
    }
}
