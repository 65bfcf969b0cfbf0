//! The adapters of this machine, their capabilities, and the choice of one.

use std::fmt;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, OnceLock};

use super::joined::FEWEST_ARRAYS;
use super::launch::WORKGROUP_SIZE;
use super::recorder::Recorder;
use super::{Context, Counters, Gpu, GpuFailure, lock};

/// Workgroup memory that the largest kernel uses: the least that WebGPU guarantees.
const WORKGROUP_BYTES: u32 = 16 * 1024;

/// Name and capabilities of an adapter.
#[derive(Clone, Debug)]
pub struct AdapterReport {
    /// The adapter's name, as the driver reports it.
    pub name: String,
    /// `"Vulkan"`, `"Metal"`, `"DX12"`.
    pub backend: String,
    /// `"discrete"`, `"integrated"`, `"virtual"`, `"software"` or `"other"`.
    pub kind: &'static str,
    /// `vendor:device` in hexadecimal digits.
    pub pci_id: String,
    /// The PCI bus address, if the driver reports it.
    pub pci_bus: String,
    /// The name and version of the driver.
    pub driver: String,
    /// Bytes of the largest array that a kernel can see.
    pub max_array_bytes: u64,
    /// Bytes shared by a workgroup.
    pub max_workgroup_bytes: u32,
    /// Invocations per workgroup.
    pub max_workgroup_size: u32,
    /// Arrays that a kernel can see.
    pub max_arrays: u32,
    /// Optional features that kernels could use.
    pub features: Vec<&'static str>,
    /// Invocations per subgroup, a power of two, if subgroup operations are available and the size is fixed.
    pub subgroup_size: Option<u32>,
    adapter: wgpu::Adapter,
}

/// Why there is no GPU to compute on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AdapterError {
    /// No adapter at all.
    None,
    /// No adapter has that name or id.
    NotFound {
        /// The requested name or id.
        wanted: String,
        /// The adapters present.
        found: Vec<String>,
    },
    /// The adapter lacks a feature that kernels need.
    Lacking {
        /// The adapter's name.
        name: String,
        /// The missing feature.
        what: String,
    },
    /// The driver refused.
    Refused {
        /// The adapter's name.
        name: String,
        /// The driver's message.
        reason: String,
    },
}

impl fmt::Display for AdapterError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => write!(
                formatter,
                "no GPU adapter found; hint: install a Vulkan driver, or Mesa's software one (mesa-vulkan-drivers); that of \
                 NVIDIA also needs libgl1 and libegl1"
            ),
            Self::NotFound { wanted, found } => {
                write!(formatter, "no adapter {wanted:?}; hint: there are {}", found.join(", "))
            }
            Self::Lacking { name, what } => write!(formatter, "adapter {name:?} lacks {what}"),
            Self::Refused { name, reason } => write!(formatter, "adapter {name:?} cannot be opened: {reason}"),
        }
    }
}

impl std::error::Error for AdapterError {}

/// All adapters, the likely fastest first; enumerated once per process.
pub fn adapters() -> &'static [AdapterReport] {
    static FOUND: OnceLock<Vec<AdapterReport>> = OnceLock::new();
    FOUND.get_or_init(enumerate_adapters)
}

fn enumerate_adapters() -> Vec<AdapterReport> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        // No validation layers: naga validates every kernel.
        flags: wgpu::InstanceFlags::empty(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let found = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    let mut reports: Vec<AdapterReport> = found.into_iter().map(AdapterReport::new).collect();
    reports.sort_by_key(|report| KINDS.iter().position(|kind| *kind == report.kind));
    reports
}

/// The adapter of that name (or part of it), PCI id (`10de:2335`) or PCI bus; the likely fastest for `"gpu"`.
pub fn choose(wanted: &str) -> Result<&'static AdapterReport, AdapterError> {
    let reports = adapters();
    if reports.is_empty() {
        return Err(AdapterError::None);
    }
    reports.iter().find(|report| wanted == "gpu" || report.is_called(wanted)).ok_or_else(|| {
        let found = reports.iter().map(|report| format!("{:?} ({})", report.name, report.pci_id)).collect();
        AdapterError::NotFound { wanted: wanted.to_owned(), found }
    })
}

/// Kinds of adapters, the likely fastest first.
const KINDS: [&str; 5] = ["discrete", "integrated", "virtual", "other", "software"];

/// The subgroup size, if the adapter supports subgroups and all of them have one size. Sizes in use are 4 to 128.
fn subgroup_size(info: &wgpu::AdapterInfo, features: wgpu::Features) -> Option<u32> {
    let size = info.subgroup_min_size;
    let is_usable = size.is_power_of_two() && (4..=128).contains(&size) && size == info.subgroup_max_size;
    (is_usable && features.contains(wgpu::Features::SUBGROUP)).then_some(size)
}

impl AdapterReport {
    fn new(adapter: wgpu::Adapter) -> Self {
        let (info, limits, has) = (adapter.get_info(), adapter.limits(), adapter.features());
        let kind = match info.device_type {
            wgpu::DeviceType::DiscreteGpu => "discrete",
            wgpu::DeviceType::IntegratedGpu => "integrated",
            wgpu::DeviceType::VirtualGpu => "virtual",
            wgpu::DeviceType::Cpu => "software",
            wgpu::DeviceType::Other => "other",
        };
        let optional = [
            ("subgroups", wgpu::Features::SUBGROUP),
            ("f16", wgpu::Features::SHADER_F16),
            ("64-bit atomics", wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS),
            ("timestamps", wgpu::Features::TIMESTAMP_QUERY),
        ];
        Self {
            subgroup_size: subgroup_size(&info, has),
            name: info.name,
            backend: format!("{:?}", info.backend),
            kind,
            pci_id: format!("{:04x}:{:04x}", info.vendor, info.device),
            pci_bus: info.device_pci_bus_id,
            driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
            max_array_bytes: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
            max_workgroup_bytes: limits.max_compute_workgroup_storage_size,
            max_workgroup_size: limits.max_compute_invocations_per_workgroup,
            max_arrays: limits.max_storage_buffers_per_shader_stage,
            features: optional.iter().filter(|(_, feature)| has.contains(*feature)).map(|(name, _)| *name).collect(),
            adapter,
        }
    }

    /// Whether the adapter is hardware (no software driver) and has the features that kernels need.
    pub fn is_hardware(&self) -> bool {
        self.kind != "software" && self.lacking().is_none()
    }

    /// An id by which [`choose`] finds this adapter on this machine.
    pub fn id(&self) -> &str {
        if self.pci_bus.is_empty() { &self.name } else { &self.pci_bus }
    }

    fn is_called(&self, wanted: &str) -> bool {
        let wanted = wanted.to_lowercase();
        self.name.to_lowercase().contains(&wanted) || self.pci_id == wanted || self.pci_bus == wanted
    }

    /// The first feature that kernels need and the adapter lacks.
    fn lacking(&self) -> Option<String> {
        let needs = [
            ("arrays per kernel", self.max_arrays, FEWEST_ARRAYS),
            ("invocations per workgroup", self.max_workgroup_size, WORKGROUP_SIZE as u32),
            ("bytes of workgroup memory", self.max_workgroup_bytes, WORKGROUP_BYTES),
        ];
        let short = needs.iter().filter(|(_, has, needed)| has < needed);
        let list: Vec<String> = short.map(|(what, has, needed)| format!("{what} ({has} of {needed})")).collect();
        (!list.is_empty()).then(|| list.join(", "))
    }

    /// Opens this adapter. The first call creates its context, which lives until the process ends; later calls return
    /// it. Errors name a missing capability, or the driver's reason.
    pub fn open(&self) -> Result<Gpu, AdapterError> {
        self.open_numbered(0)
    }

    /// One of several contexts of this adapter, which share nothing: made once per process and kept.
    pub(crate) fn open_numbered(&self, number: usize) -> Result<Gpu, AdapterError> {
        static OPEN: Mutex<Vec<(String, Gpu)>> = Mutex::new(Vec::new());
        let identity = format!("{} {} {} {} {number}", self.name, self.backend, self.pci_id, self.pci_bus);
        let mut open = lock(&OPEN);
        if let Some((_, gpu)) = open.iter().find(|(known, _)| *known == identity) {
            return Ok(*gpu);
        }
        if let Some(what) = self.lacking() {
            return Err(AdapterError::Lacking { name: self.name.clone(), what });
        }
        let gpu = Gpu(Box::leak(Box::new(self.context()?)));
        open.push((identity, gpu));
        Ok(gpu)
    }

    fn context(&self) -> Result<Context, AdapterError> {
        let limits = self.adapter.limits();
        let request = self.adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("pipeline"),
            required_features: self.adapter.features() & (wgpu::Features::TIMESTAMP_QUERY | wgpu::Features::SUBGROUP),
            required_limits: limits.clone(),
            experimental_features: wgpu::ExperimentalFeatures::disabled(),
            memory_hints: wgpu::MemoryHints::Performance,
            trace: wgpu::Trace::Off,
        });
        let refused = |error: wgpu::RequestDeviceError| AdapterError::Refused {
            name: self.name.clone(),
            reason: error.to_string(),
        };
        let (device, queue) = pollster::block_on(request).map_err(refused)?;
        let name = self.name.clone();
        device.on_uncaptured_error(std::sync::Arc::new(move |error| match error {
            wgpu::Error::OutOfMemory { source } => {
                GpuFailure::OutOfMemory(format!("adapter {name:?} has too little memory: {source}")).raise()
            }
            // The remaining errors are kernels that the driver rejects: bugs of ours.
            bug => panic!("adapter {name:?}: {bug}"),
        }));
        let recorder = Recorder::new(&device, limits.min_uniform_buffer_offset_alignment);
        Ok(Context {
            name: self.name.clone(),
            device,
            queue,
            limits,
            is_software: self.kind == "software",
            subgroup_size: self.subgroup_size,
            pipelines: Mutex::default(),
            arrays: Mutex::default(),
            staging: Mutex::default(),
            recorder: Mutex::new(recorder),
            timed: AtomicBool::new(false),
            counters: Counters::default(),
        })
    }
}
