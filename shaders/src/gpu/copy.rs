//! Copies of arrays.

use super::launch::{Kernel, uniforms};
use super::{Binding, GpuArray, Groups};

const COPY: Kernel = Kernel { name: "copy", text: include_str!("copy.wgsl") };

uniforms! {
    struct SizeBlock as "Size" {
        len: u32,
    }
}

impl GpuArray {
    /// A new array with the same elements.
    pub(crate) fn copied(&self) -> Self {
        let copy = Self::new(self.gpu(), self.len());
        let arrays = [Binding::Read(self), Binding::Write(&copy)];
        COPY.launch(self.gpu(), &[], &SizeBlock { len: self.len() as u32 }, &arrays, Groups::Over(self.len()));
        copy
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::conformance::Disagreement;
    use crate::check::{agree, noise};
    use crate::gpu::fault_tests::assert_noticed;
    use crate::gpu::layout_tests::assert_valid;
    use crate::gpu::tests::test_gpu;
    use crate::tape::Tensor;

    #[test]
    fn a_copy_has_the_same_elements() {
        assert_valid::<SizeBlock>(&COPY, &[]);
        let Some(gpu) = test_gpu() else { return };
        let x: Tensor<f32> = Tensor::<f64>::from_vec([1000], noise(1000, 1)).cast();
        let compare = || {
            let copy: Tensor<f32> = Tensor::from_gpu([1000], x.on_gpu(gpu).copied());
            let disagreement = |mismatch| Disagreement { what: "a copy".to_owned(), mismatch };
            agree(&copy, &x, 0.0).map(|()| 1).map_err(disagreement)
        };
        assert_noticed(&[(COPY.name, "= x[index]", "= x[index / 2u]")], compare);
    }
}
