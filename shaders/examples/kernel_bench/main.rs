//! `kernel_bench DEVICE SPLATS SIZE`: the time of kernels on an adapter or on the CPU, and the minimum that its measured rates
//! allow, as JSON.
//!
//! A floor is the time for the data that a kernel must at least move and the arithmetic that it must at least do: every
//! input read once, every output written once, and the arithmetic of its definition. On a GPU, every variant of summing pixels in
//! the backward pass of blending is timed, too. `ci/cpu-floors`, `ci/gpu-bench` and `ci/gpu-day` run this.

mod cpu;
mod gpu;
mod scenes;
mod work;

use std::process::ExitCode;

use shaders::tape::Device;
use work::Row;

/// The allocator of the `pipeline` binary: the system's allocator returns tens of megabytes per run to the kernel.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [device, splats, size] = &arguments[..] else { return usage() };
    let (Ok(splats), Ok(size)) = (splats.parse(), size.parse()) else { return usage() };
    let report = match Device::open(device) {
        Ok(Device::Cpu) => Ok(cpu::report(splats, size)),
        Ok(Device::Gpu(gpu)) => gpu::report(gpu, splats, size),
        Err(error) => Err(format!("{error}")),
    };
    match report {
        Ok(Report { about, rows }) => {
            let rows: Vec<String> = rows.iter().map(Row::json).collect();
            let about: String = about.iter().map(|(key, value)| format!("  \"{key}\": {value},\n")).collect();
            println!(
                "{{\n{about}  \"splats\": {splats}, \"size_px\": {size},\n  \"kernels\": [\n{}\n  ]\n}}",
                rows.join(",\n")
            );
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The measurements of a device.
struct Report {
    /// Facts about the device, as keys and JSON.
    about: Vec<(&'static str, String)>,
    rows: Vec<Row>,
}

fn usage() -> ExitCode {
    eprintln!("usage: kernel_bench DEVICE SPLATS SIZE, e.g. kernel_bench gpu 200000 800");
    ExitCode::FAILURE
}
