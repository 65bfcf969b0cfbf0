//! The kernels around the WGSL text of expressions.

use super::expression::{Expression, Pointwise};
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Launch, wgsl};
use crate::tape::{Real, Tensor};

/// Constants per vector of the kernel's block of constants.
const LANES: usize = 4;

impl Expression {
    /// A kernel that writes the value.
    pub(super) fn value_kernel(&self) -> String {
        let declarations = self.declarations(&["y"]);
        let call = format!("y[i] = {}({});", self.name, self.arguments());
        self.kernel(&declarations, "y", &[call])
    }

    /// A kernel that writes the gradient of every input that needs one.
    pub(super) fn gradient_kernel(&self, needs: &[bool]) -> String {
        let needed: Vec<usize> = (0..self.inputs).filter(|&input| needs[input]).collect();
        let outputs: Vec<String> = needed.iter().map(|input| format!("gradient_{input}")).collect();
        let outputs: Vec<&str> = outputs.iter().map(String::as_str).collect();
        let names = self.gradient_names();
        let calls: Vec<String> = needed
            .iter()
            .map(|&input| format!("gradient_{input}[i] = {}({}y[i], dy[i]);", names[input], self.arguments()))
            .collect();
        let declarations = self.declarations(&[&["y", "dy"][..], &outputs].concat());
        self.kernel(&declarations, "dy", &calls)
    }

    /// The functions of the gradients, in the order of the inputs.
    fn gradient_names(&self) -> Vec<&'static str> {
        let names = self.wgsl.lines().filter_map(|line| line.strip_prefix("fn ")?.split('(').next());
        names.skip(1).collect()
    }

    /// Bindings of the inputs, then of the named arrays; all but `dy` and the `y` of a gradient kernel are outputs.
    fn declarations(&self, others: &[&str]) -> String {
        let is_gradient = others.contains(&"dy");
        let inputs = (0..self.inputs).map(|input| (format!("input_{input}"), "read"));
        let access = |name: &str| if is_gradient && ["y", "dy"].contains(&name) { "read" } else { "read_write" };
        let others = others.iter().map(|name| (name.to_string(), access(name)));
        let line = |(at, (name, access)): (usize, (String, &str))| {
            format!("@group(0) @binding({}) var<storage, {access}> {name}: array<f32>;\n", at + 1)
        };
        inputs.chain(others).enumerate().map(line).collect()
    }

    /// Inputs and constants of a call, with a comma after each.
    fn arguments(&self) -> String {
        let inputs = (0..self.inputs).map(|input| format!("input_{input}[i], "));
        let constant = |index: usize| format!("constants.values[{}][{}], ", index / LANES, index % LANES);
        inputs.chain((0..self.constants).map(constant)).collect()
    }

    fn kernel(&self, declarations: &str, indexed_by: &str, calls: &[String]) -> String {
        let text = format!(
            "#import gpu::elements\n{}\nstruct Constants {{ values: array<vec4<f32>, {}> }}\n\
             @group(0) @binding(0) var<uniform> constants: Constants;\n{declarations}\n\
             fn run(i: u32) {{\n    \
             if (i < arrayLength(&{indexed_by})) {{\n        {}\n    }}\n}}\n",
            self.wgsl,
            self.constant_vectors(),
            calls.join("\n        "),
        );
        wgsl::assemble(&text, &[])
    }

    /// At least one, because a block of constants is never empty.
    fn constant_vectors(&self) -> usize {
        self.constants.div_ceil(LANES).max(1)
    }
}

impl<T: Real> Pointwise<T> {
    /// The kernel's block of constants.
    fn block(&self) -> Vec<f32> {
        let mut block: Vec<f32> = self.constants.iter().map(|constant| constant.to_f64() as f32).collect();
        block.resize(self.expression.constant_vectors() * LANES, 0.0);
        block
    }

    /// Launches a kernel over `len` elements.
    fn launch(&self, gpu: Gpu, name: String, source: &dyn Fn() -> String, len: usize, arrays: &[Binding]) {
        let block = self.block();
        let (constants, groups) = (bytemuck::cast_slice(&block), Groups::Over(len));
        gpu.launch(&Launch { name, source, constants, arrays, groups });
    }

    pub(super) fn value_on_gpu(&self, gpu: Gpu, inputs: &[&Tensor<T>]) -> Tensor<T> {
        let shape = self.shape(inputs);
        let y = GpuArray::new(gpu, inputs[0].len());
        let mut arrays: Vec<Binding> = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu))).collect();
        arrays.push(Binding::Write(&y));
        self.launch(gpu, self.expression.name.to_owned(), &|| self.expression.value_kernel(), y.len(), &arrays);
        Tensor::from_gpu(shape, y)
    }

    pub(super) fn gradients_on_gpu(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        y: &Tensor<T>,
        dy: &Tensor<T>,
        needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        let is_made = |(input, &needed): (usize, &bool)| needed && !self.expression.passes_on(input);
        let made: Vec<bool> = needs.iter().enumerate().map(is_made).collect();
        let mut gradients = self.made_on_gpu(gpu, inputs, y, dy, &made);
        for input in (0..inputs.len()).filter(|&input| needs[input] && !made[input]) {
            gradients[input] = Some(dy.clone());
        }
        gradients
    }

    /// The gradients that are computed.
    fn made_on_gpu(
        &self,
        gpu: Gpu,
        inputs: &[&Tensor<T>],
        y: &Tensor<T>,
        dy: &Tensor<T>,
        needs: &[bool],
    ) -> Vec<Option<Tensor<T>>> {
        if !needs.contains(&true) {
            return vec![None; needs.len()];
        }
        let gradients: Vec<Option<GpuArray>> =
            needs.iter().map(|needed| needed.then(|| GpuArray::new(gpu, dy.len()))).collect();
        let read = inputs.iter().copied().chain([y, dy]).map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays: Vec<Binding> = read.chain(gradients.iter().flatten().map(Binding::Write)).collect();
        let mask: String = needs.iter().map(|&needed| if needed { '1' } else { '0' }).collect();
        let name = format!("{} gradient {mask}", self.expression.name);
        self.launch(gpu, name, &|| self.expression.gradient_kernel(needs), dy.len(), &arrays);
        gradients.into_iter().map(|array| Some(Tensor::from_gpu(dy.shape(), array?))).collect()
    }
}
