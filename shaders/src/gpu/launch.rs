//! Kernels: their text, their pipelines, and the constants and bindings of a launch.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use super::{Binding, Context, Gpu, Groups, count, lock, module, wgsl};

/// Invocations per workgroup of every kernel for which no other number is stated; the least that WebGPU guarantees.
pub(crate) const WORKGROUP_SIZE: usize = 256;
/// Workgroups along the first dimension of a dispatch; a larger dispatch is folded (`flat_group` in WGSL). The least that
/// WebGPU guarantees.
const MAX_GROUPS: u32 = 65_535;

/// One run of a kernel. Its constants are at binding 0 of group 0 (there must be some), its arrays from binding 1 on.
pub(crate) struct Launch<'a> {
    /// Kernel and specialisation: one pipeline is kept for each.
    pub name: String,
    /// The WGSL, whose entry point is `main`; called once per pipeline.
    pub source: &'a dyn Fn() -> String,
    /// A `repr(C)` struct laid out as the kernel's.
    pub constants: &'a [u8],
    pub arrays: &'a [Binding<'a>],
    pub groups: Groups<'a>,
}

/// A compiled kernel.
pub(crate) struct Pipeline {
    /// A number that no other pipeline of its GPU has.
    pub(super) id: u64,
    /// The name of the kernel, without its specialisation.
    pub kernel: String,
    pub launches: AtomicU64,
    /// Total time of all launches on the GPU's clock, ns; counted only while kernels are timed.
    pub nanoseconds: AtomicU64,
    /// Invocations per workgroup, if the text states a number.
    pub(crate) workgroup_size: Option<usize>,
    pub compute: wgpu::ComputePipeline,
    pub layout: wgpu::BindGroupLayout,
}

/// Invocations that share a row of `len` terms: a power of two up to a workgroup, each with a few terms.
pub(crate) fn lanes_for(len: usize) -> usize {
    let terms = 4;
    len.div_ceil(terms).next_power_of_two().min(WORKGROUP_SIZE)
}

/// Columns of `len` that a workgroup adds up at once: a power of two up to 128 bytes, as memory is read.
pub(crate) fn columns_for(len: usize) -> usize {
    len.next_power_of_two().min(32)
}

/// Defines a `repr(C)` block of constants with the layout of a WGSL struct. A test compares the offsets of their
/// fields.
macro_rules! uniforms {
    ($(#[$meta:meta])* $vis:vis struct $name:ident as $wgsl:literal { $($field:ident: $type:ty),+ $(,)? }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name { $($vis $field: $type),+ }

        #[cfg(test)]
        impl $crate::gpu::layout_tests::Fields for $name {
            const NAME: &'static str = $wgsl;
            fn offsets() -> Vec<(&'static str, usize)> {
                vec![$((stringify!($field), std::mem::offset_of!($name, $field))),+]
            }
        }
    };
}
pub(crate) use uniforms;

/// A kernel, with the WGSL of its entry file.
pub(crate) struct Kernel {
    pub name: &'static str,
    /// The WGSL of its entry file, which declares its imports and constants ([`wgsl`]).
    pub text: &'static str,
}

impl Kernel {
    /// The text, specialised.
    #[cfg(test)]
    pub(crate) fn source(&self, specialisation: &[(&str, u32)]) -> String {
        self.source_with("", specialisation)
    }

    /// The complete WGSL of the kernel for a specialisation, with `declarations` before the text of the entry file.
    pub(crate) fn source_with(&self, declarations: &str, specialisation: &[(&str, u32)]) -> String {
        let text = wgsl::assemble(&(declarations.to_owned() + self.text), specialisation);
        #[cfg(test)]
        let text = super::fault_tests::planted(self.name, text);
        text
    }

    /// The name under which its pipeline is kept.
    fn pipeline_name(&self, specialisation: &[(&str, u32)]) -> String {
        let name = format!("{} {specialisation:?}", self.name);
        #[cfg(test)]
        let name = super::fault_tests::marked(self.name, name);
        name
    }

    /// Records one run.
    pub(crate) fn launch<'a>(
        &self,
        gpu: Gpu,
        specialisation: &[(&str, u32)],
        constants: &'a impl bytemuck::NoUninit,
        arrays: &'a [Binding<'a>],
        groups: impl Into<Groups<'a>>,
    ) {
        self.launch_with(gpu, &String::new, specialisation, bytemuck::bytes_of(constants), arrays, groups);
    }

    /// Records one run of the kernel with `declarations` before its text. The specialisation must determine the
    /// declarations, because it identifies the pipeline.
    pub(crate) fn launch_with<'a>(
        &self,
        gpu: Gpu,
        declarations: &dyn Fn() -> String,
        specialisation: &[(&str, u32)],
        constants: &'a [u8],
        arrays: &'a [Binding<'a>],
        groups: impl Into<Groups<'a>>,
    ) {
        gpu.launch(&Launch {
            name: self.pipeline_name(specialisation),
            source: &|| self.source_with(&declarations(), specialisation),
            constants,
            arrays,
            groups: groups.into(),
        });
    }
}

impl Launch<'_> {
    /// The name of the kernel without its specialisation.
    pub(crate) fn kernel(&self) -> &str {
        self.name.split(" [").next().unwrap_or_default()
    }
}

impl Gpu {
    /// Records a launch whose bindings are within the adapter's limits.
    pub(super) fn record(self, launch: &Launch) {
        let pipeline = self.0.pipeline(launch);
        let mut recorder = lock(&self.0.recorder);
        if recorder.is_full(launch.constants.len()) {
            recorder.submit(self.0);
        }
        recorder.record(self.0, &pipeline, launch);
        count(&self.0.counters.launches, 1);
        count(&pipeline.launches, 1);
    }
}

/// Invocations per workgroup that the text of a kernel states as a number; `None` if it names a constant.
fn workgroup_size(source: &str) -> Option<usize> {
    source.split("@workgroup_size(").nth(1)?.split(')').next()?.parse().ok()
}

/// The workgroups folded into two dimensions, each within the limit.
pub(super) fn folded(groups: usize) -> [u32; 2] {
    let groups = u32::try_from(groups).expect("fewer than 2³² workgroups");
    let columns = groups.min(MAX_GROUPS);
    [columns, groups.div_ceil(columns)]
}

impl Context {
    fn pipeline(&self, launch: &Launch) -> Arc<Pipeline> {
        let mut pipelines = lock(&self.pipelines);
        if let Some(pipeline) = pipelines.get(&launch.name) {
            return pipeline.clone();
        }
        let pipeline = Arc::new(self.compile(launch, pipelines.len() as u64));
        pipelines.insert(launch.name.clone(), pipeline.clone());
        pipeline
    }

    fn compile(&self, launch: &Launch, id: u64) -> Pipeline {
        let label = Some(launch.name.as_str());
        let source = (launch.source)();
        let workgroup_size = workgroup_size(&source);
        let entry = |binding: u32, ty: wgpu::BufferBindingType| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: binding == 0, min_binding_size: None },
            count: None,
        };
        let array = |(index, binding): (usize, &Binding)| {
            let read_only = binding.is_read_only();
            entry(index as u32 + 1, wgpu::BufferBindingType::Storage { read_only })
        };
        let arrays = launch.arrays.iter().enumerate().map(array);
        let entries: Vec<_> = std::iter::once(entry(0, wgpu::BufferBindingType::Uniform)).chain(arrays).collect();
        let layout =
            self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
        let module = module::create(&self.device, self.is_software, &launch.name, source);
        let pipeline_layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let compute = self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label,
            layout: Some(&pipeline_layout),
            module: &module,
            entry_point: Some("main"),
            compilation_options: wgpu::PipelineCompilationOptions {
                // No kernel reads workgroup memory that it has not written.
                zero_initialize_workgroup_memory: false,
                ..Default::default()
            },
            cache: None,
        });
        let kernel = launch.kernel().to_owned();
        Pipeline {
            id,
            kernel,
            launches: AtomicU64::new(0),
            nanoseconds: AtomicU64::new(0),
            workgroup_size,
            compute,
            layout,
        }
    }

    /// The arrays of a launch, and its constants at a dynamic offset.
    pub(super) fn bind_group(&self, pipeline: &Pipeline, launch: &Launch, constants: &wgpu::Buffer) -> wgpu::BindGroup {
        let size = std::num::NonZero::new(launch.constants.len() as u64);
        let constants = wgpu::BufferBinding { buffer: constants, offset: 0, size };
        let resources = std::iter::once(wgpu::BindingResource::Buffer(constants));
        let resources = resources.chain(launch.arrays.iter().map(|binding| binding.resource())).enumerate();
        let entry = |(index, resource)| wgpu::BindGroupEntry { binding: index as u32, resource };
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.layout,
            entries: &resources.map(entry).collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
#[test]
fn large_dispatches_fold() {
    assert_eq!([1, 65_535, 65_536, 1_000_000].map(folded), [[1, 1], [65_535, 1], [65_535, 2], [65_535, 16]]);
}
