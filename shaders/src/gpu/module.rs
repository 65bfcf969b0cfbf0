//! Compiled text of kernels, without the checks at run time that untrusted text needs.

// One call is unsafe, because it leaves checks out.
#![allow(unsafe_code)]

/// The module of a kernel.
///
/// By default, wgpu adds a counter to every loop, clamps every index into an array of fixed size, and guards every integer
/// division. The counters alone keep drivers from unrolling loops ([results](../../../ci/README.md#checks-at-run-time)). Every
/// kernel here is the program's own: its loops end, its indices are in range, and its divisors are not zero, as its tests
/// show with these checks off. Accesses to the arrays of a launch stay checked where the driver does it
/// (`robustBufferAccess2`). Software drivers keep the counters (`counts_loops`), because compiling unrolled loops takes them a
/// minute for some kernels.
pub(super) fn create(device: &wgpu::Device, counts_loops: bool, name: &str, source: String) -> wgpu::ShaderModule {
    let checks = wgpu::ShaderRuntimeChecks {
        bounds_checks: false,
        force_loop_bounding: counts_loops,
        int_div_checks: false,
        ..wgpu::ShaderRuntimeChecks::checked()
    };
    let descriptor =
        wgpu::ShaderModuleDescriptor { label: Some(name), source: wgpu::ShaderSource::Wgsl(source.into()) };
    // SAFETY: the text is one of this crate's kernels, whose loops end and whose indices and divisors are valid.
    unsafe { device.create_shader_module_trusted(descriptor, checks) }
}
