//! `--device`: the device that trains and renders.

use engine::{DeviceClass, Failure, FailureKind};
use shaders::check::conformance;
use shaders::gpu::{self, AdapterError, AdapterReport};

use crate::error::CliError;

/// The chosen device.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ChosenDevice {
    Cpu,
    Gpu(&'static AdapterReport),
    /// A GPU of another machine: this one has no adapter, but may plan for GPUs and read their results.
    ElsewhereGpu,
}

impl ChosenDevice {
    /// Parses `--device`: `cpu`; `auto` for the hardware adapter that is likely fastest, or the CPU if there is none;
    /// or anything that [`gpu::choose`] accepts. Without any adapter, `gpu` is [`Self::ElsewhereGpu`].
    pub(crate) fn choose(wanted: &str) -> Result<Self, CliError> {
        match wanted {
            "cpu" => Ok(Self::Cpu),
            "auto" => Ok(gpu::adapters().iter().find(|adapter| adapter.is_hardware()).map_or(Self::Cpu, Self::Gpu)),
            "gpu" if gpu::adapters().is_empty() => Ok(Self::ElsewhereGpu),
            name => Ok(Self::Gpu(gpu::choose(name).map_err(refused)?)),
        }
    }

    /// Like [`Self::choose`], for a process whose batch system grants some of the machine's GPUs: `auto` and `gpu` mean the
    /// first granted one. Vulkan ignores `CUDA_VISIBLE_DEVICES`, so all jobs would otherwise compute on the first GPU.
    pub(crate) fn choose_granted(wanted: &str) -> Result<Self, CliError> {
        match granted_bus().filter(|_| ["auto", "gpu"].contains(&wanted)) {
            Some(bus) => Self::choose(&bus),
            None => Self::choose(wanted),
        }
    }

    /// Parses the names of `--devices`: adapters by number or as [`Self::choose`] accepts them, or `all`: the hardware
    /// adapters, or the software ones if there are no others.
    pub(crate) fn choose_several(wanted: &[String]) -> Result<Vec<Self>, CliError> {
        let adapters = gpu::adapters();
        if wanted == ["all"] {
            let hardware: Vec<Self> = adapters.iter().filter(|adapter| adapter.is_hardware()).map(Self::Gpu).collect();
            let chosen = if hardware.is_empty() { adapters.iter().map(Self::Gpu).collect() } else { hardware };
            return if chosen.is_empty() { Err(refused(AdapterError::None)) } else { Ok(chosen) };
        }
        let by_number = |name: &String| name.parse::<usize>().ok().and_then(|at| adapters.get(at)).map(Self::Gpu);
        wanted.iter().map(|name| by_number(name).map_or_else(|| Self::choose(name), Ok)).collect()
    }

    /// The device's class, which is part of the keys of jobs that compute on it.
    pub(crate) fn class(self) -> DeviceClass {
        match self {
            Self::Cpu => DeviceClass::Cpu,
            Self::Gpu(_) | Self::ElsewhereGpu => DeviceClass::Gpu,
        }
    }

    /// The identifier by which a job finds the device again.
    pub(crate) fn id(self) -> String {
        match self {
            Self::Cpu => DeviceClass::Cpu.as_str().into(),
            Self::Gpu(adapter) => adapter.id().into(),
            Self::ElsewhereGpu => DeviceClass::Gpu.as_str().into(),
        }
    }

    /// Returns an error if there is no GPU here, or if it does not agree with the CPU; no run may use such a GPU.
    pub(crate) fn check(self) -> Result<(), CliError> {
        let adapter = match self {
            Self::Cpu => return Ok(()),
            Self::ElsewhereGpu => return Err(refused(AdapterError::None)),
            Self::Gpu(adapter) => adapter,
        };
        let hint = "choose another one with --device, or --device cpu; `pipeline doctor` describes them";
        let gpu = adapter.open().map_err(refused)?;
        match conformance::check(gpu) {
            Ok(_) => Ok(()),
            Err(error) => {
                let message = format!("adapter {:?} does not agree with the CPU: {error}", adapter.name);
                Err(CliError::Other(Failure::new(FailureKind::World, message).hint(hint).into()))
            }
        }
    }
}

/// The PCI bus of the first GPU that `CUDA_VISIBLE_DEVICES` grants, if NVIDIA's tool knows it.
fn granted_bus() -> Option<String> {
    let granted = std::env::var("CUDA_VISIBLE_DEVICES").ok()?;
    let arguments = ["--query-gpu=index,uuid,pci.bus_id", "--format=csv,noheader"];
    let output = std::process::Command::new("nvidia-smi").args(arguments).output().ok()?;
    bus_of(granted.split(',').next()?.trim(), &String::from_utf8_lossy(&output.stdout))
}

/// The PCI bus of a GPU by its index or the beginning of its UUID, from lines `index, UUID, bus`.
fn bus_of(granted: &str, lines: &str) -> Option<String> {
    let is_granted = |line: &&str| {
        let mut fields = line.split(',').map(str::trim);
        let (index, uuid) = (fields.next(), fields.next());
        !granted.is_empty() && (index == Some(granted) || uuid.is_some_and(|uuid| uuid.starts_with(granted)))
    };
    let bus = lines.lines().find(is_granted)?.rsplit(',').next()?.trim().to_lowercase();
    // The tool prints a domain of eight digits, adapters have four.
    Some(bus.get(bus.len().checked_sub("0000:01:00.0".len())?..)?.to_owned())
}

/// A missing or unusable adapter is a failure of the machine, even if the user named it.
fn refused(error: AdapterError) -> CliError {
    let message = match &error {
        AdapterError::NotFound { .. } => format!("{error}; the names cpu, gpu and auto are also valid"),
        _ => error.to_string(),
    };
    CliError::Other(Failure::new(FailureKind::World, message).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hint_for_an_unknown_adapter_has_the_names_of_classes() {
        let error = refused(AdapterError::NotFound { wanted: "gpuu".into(), found: vec!["llvmpipe".into()] });
        let expected =
            "error: no adapter \"gpuu\"; hint: there are llvmpipe; the names cpu, gpu and auto are also valid";
        assert_eq!(error.to_string(), expected);
    }

    #[test]
    fn granted_gpus_are_found_by_index_and_uuid() {
        let lines = "0, GPU-1a2b, 00000000:01:00.0\n1, GPU-3c4d, 00000000:41:00.0\n";
        assert_eq!(bus_of("1", lines).as_deref(), Some("0000:41:00.0"));
        assert_eq!(bus_of("GPU-1a", lines).as_deref(), Some("0000:01:00.0"));
        for unknown in ["", "2", "NoDevFiles"] {
            assert_eq!(bus_of(unknown, lines), None, "{unknown}");
        }
    }
}
