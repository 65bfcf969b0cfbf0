//! `--device`: what trains and renders.

use engine::{DeviceClass, Failure, FailureKind};
use shaders::check::conformance;
use shaders::gpu::{self, AdapterError, AdapterReport};

use crate::error::CliError;

/// What was chosen.
#[derive(Clone, Copy, Debug)]
pub enum ChosenDevice {
    Cpu,
    Gpu(&'static AdapterReport),
}

impl ChosenDevice {
    /// `cpu`; `auto`, the likely fastest adapter that is no software and can be used, else the CPU; or what
    /// [`gpu::choose`] understands.
    pub fn choose(wanted: &str) -> Result<Self, CliError> {
        match wanted {
            "cpu" => Ok(Self::Cpu),
            "auto" => Ok(gpu::adapters().iter().find(|adapter| adapter.is_hardware()).map_or(Self::Cpu, Self::Gpu)),
            name => Ok(Self::Gpu(gpu::choose(name).map_err(refused)?)),
        }
    }

    pub fn class(self) -> DeviceClass {
        match self {
            Self::Cpu => DeviceClass::Cpu,
            Self::Gpu(_) => DeviceClass::Gpu,
        }
    }

    /// What a job finds it by.
    pub fn id(self) -> String {
        match self {
            Self::Cpu => DeviceClass::Cpu.as_str().into(),
            Self::Gpu(adapter) => adapter.id().into(),
        }
    }

    /// An error if a GPU does not compute what the CPU computes: nobody relies on such a one.
    pub fn check(self) -> Result<(), CliError> {
        let Self::Gpu(adapter) = self else { return Ok(()) };
        let hint = "choose another one with --device, or --device cpu; `pipeline doctor` describes them";
        let gpu = adapter.open().map_err(refused)?;
        match conformance::check(gpu) {
            Ok(_) => Ok(()),
            Err(error) => {
                let message = format!("adapter {:?} does not compute what the CPU computes: {error}", adapter.name);
                Err(CliError::Other(Failure::new(FailureKind::World, message).hint(hint).into()))
            }
        }
    }
}

/// An adapter that is not there is the machine's fault, whoever asked for it.
fn refused(error: AdapterError) -> CliError {
    CliError::Other(Failure::new(FailureKind::World, error.to_string()).into())
}
