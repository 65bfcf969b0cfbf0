//! Measured peak rates of an adapter: the floor of every kernel's time.

use std::time::Instant;

use super::{Binding, Gpu, GpuArray, Groups, Kernel, uniforms};

/// Vectors that are copied: 64 MiB, more than caches hold.
const COPIED: usize = 1 << 22;
/// Vectors that are computed with.
const COMPUTED: usize = 1 << 18;
/// Rounds of the four multiply-adds of a vector.
const STEPS: usize = 64;
/// Operations of a round: four vectors of four lanes, a multiplication and an addition each.
const FLOPS_PER_STEP: usize = 4 * 4 * 2;
/// Number of runs. The fastest one is used, because no disturbance makes a run faster.
const RUNS: usize = 5;

/// With zero steps, the kernel only copies its input to its output.
const ARITHMETIC: Kernel = Kernel { name: "arithmetic", text: include_str!("arithmetic.wgsl") };

uniforms! {
    struct Constants as "Constants" { count: u32 }
}

/// Measured rates of an adapter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Bytes read and bytes written, together.
    pub copied_bytes_per_sec: f64,
    /// f32 additions and multiplications.
    pub flops_per_sec: f64,
}

impl Rates {
    /// The minimum seconds for this amount of data and arithmetic.
    pub fn floor_secs(&self, bytes: f64, flops: f64) -> f64 {
        (bytes / self.copied_bytes_per_sec).max(flops / self.flops_per_sec)
    }
}

impl Gpu {
    /// Measures copying and arithmetic.
    pub fn measure_rates(self) -> Rates {
        let copy_secs = self.fastest_secs(0, COPIED);
        let arithmetic_secs = self.fastest_secs(STEPS, COMPUTED);
        Rates {
            copied_bytes_per_sec: (2 * 16 * COPIED) as f64 / copy_secs,
            flops_per_sec: (COMPUTED * STEPS * FLOPS_PER_STEP) as f64 / arithmetic_secs,
        }
    }

    /// The time of the fastest run, on the GPU's clock if available, otherwise on the host's.
    fn fastest_secs(self, steps: usize, vectors: usize) -> f64 {
        let source = GpuArray::upload(self, &vec![0.25_f32; 4 * vectors]);
        let result = GpuArray::new(self, 4 * vectors);
        let arrays = [Binding::Read(&source), Binding::Write(&result)];
        let run = || {
            let before = self.usage();
            let start = Instant::now();
            let constants = Constants { count: vectors as u32 };
            ARITHMETIC.launch(self, &[("STEPS", steps as u32)], &constants, &arrays, Groups::Over(vectors));
            self.wait();
            let elapsed = start.elapsed().as_secs_f64();
            let stamped = self.usage().since(&before).kernels.get(ARITHMETIC.name).map_or(0.0, |cost| cost.secs);
            if stamped > 0.0 { stamped } else { elapsed }
        };
        // The first run compiles.
        run();
        (0..RUNS).map(|_| run()).fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::layout_tests::{check_layout, validate};
    use crate::gpu::tests::test_gpu;

    #[test]
    fn kernels_are_valid() {
        for source in [0, 3].map(|steps| ARITHMETIC.source(&[("STEPS", steps)])) {
            validate(&source).unwrap_or_else(|error| panic!("{error}"));
            check_layout::<Constants>(&source).unwrap_or_else(|error| panic!("{error}"));
        }
    }

    #[test]
    fn rates_are_those_of_a_machine() {
        let Some(gpu) = test_gpu() else { return };
        let rates = gpu.measure_rates();
        // From a tenth of a slow processor to a hundred times the fastest GPU.
        assert!((1e8..1e15).contains(&rates.copied_bytes_per_sec), "{rates:?}");
        assert!((1e7..1e17).contains(&rates.flops_per_sec), "{rates:?}");
        let bytes = Rates { copied_bytes_per_sec: 100.0, flops_per_sec: 1000.0 };
        assert_eq!([bytes.floor_secs(200.0, 1000.0), bytes.floor_secs(0.0, 5000.0)], [2.0, 5.0]);
    }
}
