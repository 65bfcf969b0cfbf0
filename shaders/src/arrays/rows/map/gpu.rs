//! Row maps on a GPU: one invocation per output element, so that neighbouring invocations write neighbouring
//! elements.

use std::array::from_fn;
use std::fmt::Write;

use super::RowMap;
use crate::gpu::{Binding, Gpu, GpuArray, Groups, Launch, uniforms, wgsl};
use crate::tape::{Real, Tensor};

/// The WGSL of a [`RowMap`]: functions of a row and a column of the output, e.g. `value(row, column)`.
///
/// They read the inputs as `x0`, `x1`, … (arrays of rows with `COLUMNS_0`, `COLUMNS_1`, … columns), the numbers below as
/// `map.values[0].x`, … and, in gradients, the output and its gradient as `y` and `dy` (`COLUMNS_Y` columns).
pub(crate) struct RowWgsl {
    /// Defines `fn value(row: u32, column: u32) -> f32`.
    pub value: &'static str,
    /// Defines `fn gradient_0(row: u32, column: u32) -> f32`, …, one function per input.
    pub gradients: &'static str,
    /// Constants of both texts.
    pub(crate) specialisation: Vec<(&'static str, u32)>,
    /// At most eight.
    pub numbers: Vec<f32>,
}

uniforms! {
    struct MapBlock as "Map" {
        values: [[f32; 4]; 2],
        rows: u32,
        padding_0: u32,
        padding_1: u32,
        padding_2: u32,
    }
}

/// The files that every map imports.
const IMPORTS: &str = "#import gpu::elements\n#import arrays::rows::map::map_block\n";

/// The kernels of a map for certain numbers of columns.
pub(crate) struct RowKernel<const I: usize> {
    name: &'static str,
    wgsl: RowWgsl,
    columns: [usize; I],
    y_columns: usize,
}

impl<const I: usize> RowKernel<I> {
    /// `None` if the map has no WGSL for these numbers of columns, or if the output is empty.
    pub(super) fn new<M: RowMap<I>>(map: &M, columns: [usize; I]) -> Option<Self> {
        let y_columns = map.output_columns(columns);
        let wgsl = map.wgsl(columns).filter(|_| y_columns > 0 && !columns.contains(&0))?;
        Some(Self { name: M::NAME, wgsl, columns, y_columns })
    }

    /// The output of all rows.
    pub(super) fn value<T: Real>(&self, gpu: Gpu, inputs: [&Tensor<T>; I]) -> Tensor<T> {
        let rows = inputs[0].rows();
        let y = GpuArray::new(gpu, rows * self.y_columns);
        let read = inputs.iter().map(|input| Binding::Read(input.on_gpu(gpu)));
        let arrays: Vec<Binding> = read.chain([Binding::Write(&y)]).collect();
        let name = format!("{} {:?}", self.name, self.specialisation());
        self.launch(gpu, name, &|| self.value_text(), [rows, self.y_columns], &arrays);
        Tensor::from_gpu([rows, self.y_columns], y)
    }

    /// The gradients of all rows of all inputs.
    pub(super) fn gradients<T: Real>(
        &self,
        gpu: Gpu,
        inputs: [&Tensor<T>; I],
        y: &Tensor<T>,
        dy: &Tensor<T>,
    ) -> [Tensor<T>; I] {
        let gradients = inputs.map(|input| GpuArray::new(gpu, input.len()));
        let read = inputs.iter().copied().chain([y, dy]).map(|tensor| Binding::Read(tensor.on_gpu(gpu)));
        let arrays: Vec<Binding> = read.chain(gradients.iter().map(Binding::Write)).collect();
        let name = format!("{} gradient {:?}", self.name, self.specialisation());
        self.launch(gpu, name, &|| self.gradient_text(), [dy.rows(), self.columns.iter().sum()], &arrays);
        let mut inputs = inputs.into_iter();
        gradients.map(|array| Tensor::from_gpu(inputs.next().expect("as many").shape(), array))
    }

    /// Runs a kernel with an invocation for each of `columns` elements of every row.
    fn launch(
        &self,
        gpu: Gpu,
        name: String,
        source: &dyn Fn() -> String,
        [rows, columns]: [usize; 2],
        arrays: &[Binding],
    ) {
        let (block, groups) = (self.block(rows), Groups::Over(rows * columns));
        gpu.launch(&Launch { name, source, constants: bytemuck::bytes_of(&block), arrays, groups });
    }

    /// The constants that distinguish these kernels from other specialisations of the same map.
    fn specialisation(&self) -> Vec<(String, u32)> {
        let given = self.wgsl.specialisation.iter().map(|&(name, value)| (name.to_owned(), value));
        let columns = self.columns.iter().enumerate().map(|(at, &count)| (format!("COLUMNS_{at}"), count as u32));
        given.chain(columns).chain([("COLUMNS_Y".to_owned(), self.y_columns as u32)]).collect()
    }

    fn block(&self, rows: usize) -> MapBlock {
        let mut values = [[0.0; 4]; 2];
        values.as_flattened_mut()[..self.wgsl.numbers.len()].copy_from_slice(&self.wgsl.numbers);
        MapBlock { values, rows: rows as u32, padding_0: 0, padding_1: 0, padding_2: 0 }
    }

    fn value_text(&self) -> String {
        let mut arrays: Vec<(String, &str)> = self.inputs().into();
        arrays.push(("y".to_owned(), "read_write"));
        self.text(&arrays, self.wgsl.value, self.y_columns, "        y[index] = value(row, column);\n")
    }

    fn gradient_text(&self) -> String {
        let mut arrays: Vec<(String, &str)> = self.inputs().into();
        arrays.extend(["y", "dy"].map(|name| (name.to_owned(), "read")));
        arrays.extend(from_fn::<_, I, _>(|input| (format!("dx{input}"), "read_write")));
        let mut calls = String::new();
        for input in 0..I {
            writeln!(
                calls,
                "        if (column < COLUMNS_{input}) {{\n            \
                 dx{input}[row * COLUMNS_{input} + column] = gradient_{input}(row, column);\n            return;\n        \
                 }}\n        column -= COLUMNS_{input};"
            )
            .expect("text grows");
        }
        self.text(&arrays, self.wgsl.gradients, self.columns.iter().sum(), &calls)
    }

    fn inputs(&self) -> [(String, &'static str); I] {
        from_fn(|input| (format!("x{input}"), "read"))
    }

    /// The text of a kernel with one invocation per row and column.
    fn text(&self, arrays: &[(String, &str)], functions: &str, columns: usize, body: &str) -> String {
        let line = |(at, (name, access)): (usize, &(String, &str))| {
            format!("@group(0) @binding({}) var<storage, {access}> {name}: array<f32>;\n", at + 1)
        };
        let arrays: String = arrays.iter().enumerate().map(line).collect();
        let run = format!(
            "fn run(index: u32) {{\n    \
             let row = index / {columns}u;\n    var column = index % {columns}u;\n    \
             if (row < map.rows) {{\n{body}    }}\n}}\n"
        );
        let specialisation = self.specialisation();
        let specialisation: Vec<_> = specialisation.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        wgsl::assemble(&[IMPORTS, &arrays, functions, "\n", &run].concat(), &specialisation)
    }
}

/// Validates the kernels of a map for these numbers of columns.
#[cfg(test)]
pub(crate) fn validate_map<M: RowMap<I>, const I: usize>(map: &M, columns: [usize; I]) {
    use crate::gpu::layout_tests::check_layout;
    let kernel = RowKernel::new(map, columns).unwrap_or_else(|| panic!("{}: no kernel for {columns:?}", M::NAME));
    for text in [kernel.value_text(), kernel.gradient_text()] {
        check_layout::<MapBlock>(&text).unwrap_or_else(|error| panic!("{}: {error}", M::NAME));
    }
}
