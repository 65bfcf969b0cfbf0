//! `doctor`: checks this machine for the requirements of runs.

use std::path::{Path, PathBuf};

use anyhow::Context;
use engine::{DeviceClass, Store, exit};
use metric_evaluation::{LPIPS_FOLDER, lpips_files};
use shaders::check::conformance;
use shaders::gpu::{self, AdapterReport};

use crate::args::DoctorArgs;
use crate::error::CliError;
use crate::output::{bytes, note, print};
use crate::stages::stages;
use crate::verbs::data;

/// Checks the store, the data folder and the GPUs, and prints a report. The exit code is not 0 if the store or the
/// GPU that the user named is unusable, or with `--cluster` the file system or Slurm.
pub(crate) fn doctor(store: &Path, args: &DoctorArgs) -> Result<u8, CliError> {
    // `auto`, a value of the variable, names no adapter.
    let (data_root, device) = (args.data.root.as_path(), args.device.as_deref().filter(|device| *device != "auto"));
    let mut text = format!("pipeline {}\n", env!("CARGO_PKG_VERSION"));
    text += &format!("threads      {}\n", std::thread::available_parallelism().map_or(1, usize::from));
    let store_is_sound = match try_store(store) {
        Ok(message) => {
            text += &format!("store        {message}\n");
            true
        }
        Err(error) => {
            text += &format!("store        NOT USABLE: {error:#}\n");
            false
        }
    };
    let data = if data_root.is_dir() { "exists" } else { "missing (recipes with sources will report missing data)" };
    text += &format!("data root    {}: {data}\n", data_root.display());
    text += &data_sets(data_root)?;
    text += &format!("LPIPS        {}\n", lpips(data_root));
    text += &free_space(store, data_root);
    let recipes = stages().recipes().len();
    text += &format!("recipes      {recipes} built in; `pipeline recipes list`\n");
    print(&text)?;
    let device_is_sound = try_adapters(device)?;
    let cluster_is_sound = match &args.cluster {
        Some(file) => try_cluster(store, file.as_deref())?,
        None => true,
    };
    Ok(if store_is_sound && device_is_sound && cluster_is_sound { exit::OK } else { exit::INFRASTRUCTURE })
}

/// The data sets that have scenes below the data folder.
fn data_sets(data_root: &Path) -> Result<String, CliError> {
    let mut sets = data::present(data_root)?;
    sets.retain(|set| set.exist > 0);
    let width = data::name_width(&sets);
    let found: Vec<String> = sets.iter().map(|set| set.text(data_root, width)).collect();
    let none = || vec!["none found; `pipeline data list` lists the known ones\n".to_owned()];
    let found = if found.is_empty() { none() } else { found };
    Ok(found.iter().map(|line| format!("data set     {line}")).collect())
}

/// Whether the weights of LPIPS are in their conventional folder, or elsewhere below the data folder, and how to use them.
fn lpips(data_root: &Path) -> String {
    let convention = data_root.join(LPIPS_FOLDER);
    let entries = std::fs::read_dir(data_root).into_iter().flatten().flatten().map(|entry| entry.path());
    let others = [data_root.to_owned()].into_iter().chain(entries.filter(|path| path.is_dir() && *path != convention));
    let folders: Vec<PathBuf> = [convention.clone()].into_iter().chain(others).collect();
    let has = |folder: &&PathBuf, files: &[&str]| files.iter().all(|file| folder.join(file).is_file());
    let found: Vec<(&str, &PathBuf)> = lpips_files()
        .iter()
        .filter_map(|(network, files)| Some((*network, folders.iter().find(|folder| has(folder, files))?)))
        .collect();
    let Some((network, folder)) = found.first() else {
        let (_, [classifier, head]) = lpips_files()[0];
        return format!(
            "not measured: put {classifier} and {head} into {} (pipeline eval --help)",
            convention.display()
        );
    };
    if **folder != convention {
        let name = folder.strip_prefix(data_root).unwrap_or(folder).display();
        return format!(
            "{network} in {}; move it to {}, or use it with -s 'nodes.metrics.params.lpips_weights=\"{name}\"'",
            folder.display(),
            convention.display()
        );
    }
    let here: Vec<&str> =
        found.iter().filter(|(_, folder)| **folder == convention).map(|(network, _)| *network).collect();
    format!("{} in {}, which every recipe uses", here.join(", "), convention.display())
}

/// The free space on the disks of the store and of the data folder.
fn free_space(store: &Path, data_root: &Path) -> String {
    let existing =
        |path: &Path| std::path::absolute(path).ok()?.ancestors().find(|path| path.exists()).map(Path::to_owned);
    let free = |path: &Path| {
        let stat = rustix::fs::statvfs(&existing(path)?).ok()?;
        Some(bytes(stat.f_bavail.saturating_mul(stat.f_frsize)))
    };
    let line = |what: &str, path: &Path| free(path).map(|free| format!("disk         {free} free for the {what}\n"));
    [line("store", store), line("data", data_root)].into_iter().flatten().collect()
}

/// Checks that the store can be written or, if it is missing, created; describes it.
fn try_store(path: &Path) -> anyhow::Result<String> {
    let store = Store::open_read_only(path)?;
    if !store.exists() {
        let root = store.root();
        let parent = root.ancestors().find(|folder| folder.exists()).unwrap_or(root);
        let probe = parent.join(format!(".pipeline-doctor-{}", std::process::id()));
        let probed = std::fs::create_dir(&probe).and_then(|()| std::fs::remove_dir(&probe));
        probed.with_context(|| format!("it cannot be created: {}", root.display()))?;
        return Ok(format!("{}: missing; the first run creates it", root.display()));
    }
    let in_use = store.lock_shared()?;
    std::fs::write(store.scratch("doctor")?.path().join("probe"), "probe")?;
    drop(in_use);
    let busy = if store.try_lock_exclusive()?.is_some() { "idle" } else { "in use by a run" };
    Ok(format!("{}: writable, {busy}", store.root().display()))
}

/// Checks the store's file system, Slurm and the cluster file. Returns whether all are usable.
fn try_cluster(store: &Path, file: Option<&Path>) -> Result<bool, CliError> {
    let folder = store.ancestors().find(|path| path.is_dir()).unwrap_or(Path::new("."));
    let mut is_sound = true;
    match cluster::probe_file_system(folder) {
        Ok(lines) => lines.iter().try_for_each(|line| print(&format!("file system  {line}\n")))?,
        Err(error) => {
            is_sound = false;
            print(&format!("file system  NOT USABLE for several processes: {error:#}\n"))?;
        }
    }
    let settings = ["SLURM_VERSION", "MaxArraySize", "PreemptMode", "AccountingStorageType"];
    let read =
        settings.iter().map(|key| Ok(format!("{key} {}", cluster::slurm::config(key)?.unwrap_or("unknown".into()))));
    match read.collect::<anyhow::Result<Vec<String>>>() {
        Ok(values) => print(&format!("slurm        {}\n", values.join(", ")))?,
        Err(error) => {
            is_sound = false;
            print(&format!("slurm        NOT USABLE: {error:#}\n"))?;
        }
    }
    if let Some(file) = file {
        cluster::ClusterFile::read(file)?;
        print(&format!("cluster file {}: valid\n", file.display()))?;
    }
    Ok(is_sound)
}

/// Describes all GPUs, or the named one, and compares each with the CPU. Returns whether the named GPU is usable;
/// without a name, always true, because everything runs on the CPU.
fn try_adapters(device: Option<&str>) -> Result<bool, CliError> {
    if device == Some(DeviceClass::Cpu.as_str()) {
        print("adapter      none requested: everything runs on the CPU\n")?;
        return Ok(true);
    }
    let chosen = match device {
        None => Ok(gpu::adapters().iter().collect()),
        Some(name) => gpu::choose(name).map(|adapter| vec![adapter]),
    };
    let adapters: Vec<&AdapterReport> = match chosen {
        Ok(adapters) => adapters,
        Err(error) => {
            print(&format!("adapter      NOT USABLE: {error}\n"))?;
            return Ok(false);
        }
    };
    if adapters.is_empty() {
        print("adapter      none found: everything runs on the CPU\n")?;
    }
    let mut all_are_sound = true;
    for adapter in adapters {
        print(&describe(adapter))?;
        if !adapter.is_hardware() {
            note("comparing this adapter with the CPU, about a minute in software; --device cpu leaves it out");
        }
        let (verdict, is_sound) = match try_adapter(adapter) {
            Ok(message) => (message, true),
            Err(error) => (format!("NOT USABLE: {error:#}"), false),
        };
        all_are_sound &= is_sound;
        print(&format!("             conformance: {verdict}\n"))?;
    }
    Ok(all_are_sound || device.is_none())
}

/// The adapter's name, limits and features, on one line each.
fn describe(adapter: &AdapterReport) -> String {
    let AdapterReport { name, backend, kind, pci_id, pci_bus, driver, .. } = adapter;
    let bus = if pci_bus.is_empty() { String::new() } else { format!(" at {pci_bus}") };
    let features = if adapter.features.is_empty() { "none".to_owned() } else { adapter.features.join(", ") };
    let sums = adapter.subgroup_size.map_or("workgroup memory".to_owned(), |size| format!("subgroups of {size}"));
    let (array, shared) = (bytes(adapter.max_array_bytes), bytes(adapter.max_workgroup_bytes.into()));
    format!("adapter      {name}: {kind}, {backend}, PCI {pci_id}{bus}, {driver}\n")
        + &format!("             limits: arrays of {array}, {} per kernel; ", adapter.max_arrays)
        + &format!("workgroups of {} with {shared}\n", adapter.max_workgroup_size)
        + &format!("             optional features: {features}\n")
        + &format!("             pixel gradients are summed in {sums}\n")
}

/// Opens the adapter, compares it with the CPU, and describes the result.
fn try_adapter(adapter: &AdapterReport) -> anyhow::Result<String> {
    let gpu = adapter.open()?;
    let conformance = conformance::check(gpu)?;
    let launches = gpu.counts().launches;
    Ok(format!(
        "agrees with the CPU in {} comparisons ({launches} launches, {:.1} s)",
        conformance.comparisons, conformance.secs
    ))
}
