use crate::gpu::Gpu;
use crate::tape::{Backward, GpuOp, Op, Real, Tape, Tensor, Var};

/// The weights [O, kernel height, kernel width, C] of an ordinary convolution that equals the central-difference convolution
/// Σₙ w(n)·(x(p + n) − θ·x(p)) (Yu et al. 2020): the central weight less θ·Σₙ w(n). The kernel must have a centre.
pub fn central_difference<T: Real>(tape: &mut Tape<T>, weight: Var, theta: f64) -> Var {
    let &[_, height, width, channels] = tape.value(weight).shape() else {
        panic!("central_difference: the weight must be [O, kernel height, kernel width, C]")
    };
    assert!(height % 2 == 1 && width % 2 == 1, "central_difference: a kernel of even size has no centre");
    tape.apply_one(CentralDifference { taps: height * width, channels, theta }, &[weight])
}

pub(crate) struct CentralDifference {
    pub taps: usize,
    pub channels: usize,
    pub theta: f64,
}

impl CentralDifference {
    /// Index of the central tap's first channel among the taps of one output.
    fn center(&self) -> usize {
        self.taps / 2 * self.channels
    }
}

impl<T: Real> Op<T> for CentralDifference {
    fn name(&self) -> &'static str {
        "central_difference"
    }

    fn forward(&mut self, inputs: &[&Tensor<T>]) -> Vec<Tensor<T>> {
        let mut reduced = inputs[0].clone();
        let theta = T::from_f64(self.theta);
        for taps in reduced.make_mut().chunks_exact_mut(self.taps * self.channels) {
            for channel in 0..self.channels {
                let sum: T = taps[channel..].iter().step_by(self.channels).copied().sum();
                taps[self.center() + channel] += -(theta * sum);
            }
        }
        vec![reduced]
    }

    fn backward(&mut self, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        let dy = pass.dy();
        let mut dweight = dy.clone();
        let theta = T::from_f64(self.theta);
        for taps in dweight.make_mut().chunks_exact_mut(self.taps * self.channels) {
            let center = taps[self.center()..][..self.channels].to_vec();
            for tap in taps.chunks_exact_mut(self.channels) {
                tap.iter_mut().zip(&center).for_each(|(tap, &center)| *tap += -(theta * center));
            }
        }
        vec![Some(dweight)]
    }

    fn gpu(&mut self) -> Option<&mut dyn GpuOp<T>> {
        Some(self)
    }
}

impl<T: Real> GpuOp<T> for CentralDifference {
    fn forward_gpu(&mut self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Option<Vec<Tensor<T>>> {
        Some(vec![self.reduce_on_gpu(gpu, inputs[0], false)])
    }

    fn backward_gpu(&mut self, gpu: Gpu, pass: Backward<T>) -> Vec<Option<Tensor<T>>> {
        vec![Some(self.reduce_on_gpu(gpu, pass.dy(), true))]
    }
}
