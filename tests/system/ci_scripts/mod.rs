//! The Python of `ci/`: it compiles, and `ci/cpu-floors`, `ci/gpu-day`, `ci/opensplat` and `ci/snakemake` work with stand-ins
//! for the programs that they run.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use tempfile::TempDir;

use crate::product::{Ended, program, root};

/// An 8-bit grey PNG of 2×1 pixels: 10 and 200.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x02\0\0\0\x01\x08\0\0\0\0\xd1\x49\x20\x56\
    \0\0\0\x0bIDAT\x78\xda\x63\xe0\x3a\x01\0\0\xdf\0\xd3\xd8\x85\xd2\xae\0\0\0\0IEND\xae\x42\x60\x82";

/// Whether this machine has Python; without it, reports the test as skipped.
fn has_python() -> bool {
    let found = Command::new("python3").arg("--version").output().is_ok_and(|output| output.status.success());
    if !found {
        support::skip("no python3");
    }
    found
}

/// A folder with a D-NeRF scene of one frame per split, and the state of the fake programs.
struct World(TempDir);

impl World {
    fn new() -> Self {
        let world = Self(tempfile::tempdir().unwrap());
        let scene = world.path("data/dnerf/balls");
        fs::create_dir_all(&scene).unwrap();
        fs::create_dir(world.path("state")).unwrap();
        for split in ["train", "val", "test"] {
            let frames = format!(r#"{{"frames": [{{"file_path": "./{split}/r_0"}}]}}"#);
            fs::write(scene.join(format!("transforms_{split}.json")), frames).unwrap();
            fs::create_dir(scene.join(split)).unwrap();
            fs::write(scene.join(split).join("r_0.png"), PNG).unwrap();
        }
        world
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn call(&self, script: PathBuf, arguments: &[&str], environment: &[(&str, &str)]) -> Ended {
        let fakes = root().join("tests/system/ci_scripts");
        let mut command = Command::new("python3");
        command.arg("-B").arg(script).args(arguments).env("FAKE_STATE", self.path("state"));
        command.env("PIPELINE", fakes.join("fake_pipeline")).env("KERNEL_BENCH", fakes.join("fake_kernel_bench"));
        command.env("KERNEL_TESTS", fakes.join("fake_kernel_tests"));
        command.env("PIPELINE_DATA", self.path("data")).envs(environment.iter().copied());
        Ended::of(command)
    }

    fn prepare(&self, options: &[&str]) -> Ended {
        let out = self.path("packed");
        let fixed = ["prepare", "--scenes", "balls", "--out", out.to_str().unwrap()];
        self.call(root().join("ci/gpu-day"), &[&fixed, options].concat(), &[])
    }

    fn day(&self, options: &[&str]) -> Ended {
        self.call(self.path("packed/gpu-day"), &[&["run"], options].concat(), &[])
    }

    fn tables(&self) -> String {
        let report = self.path("packed/gpu-day.json");
        self.call(root().join("ci/gpu-day"), &["tables", report.to_str().unwrap()], &[]).ok()
    }

    fn opensplat(&self, environment: &[(&str, &str)]) -> Ended {
        let images = self.path("data/capture/images");
        fs::create_dir_all(&images).unwrap();
        fs::write(images.join("a.png"), PNG).unwrap();
        let binary = root().join("tests/system/ci_scripts/fake_opensplat");
        let options = ["--source", "capture", "--steps", "100", "--opensplat", binary.to_str().unwrap()];
        self.call(root().join("ci/opensplat"), &options, environment)
    }
}

#[test]
fn scripts_of_ci_compile() {
    if !has_python() {
        return;
    }
    let files = walkdir::WalkDir::new(root().join("ci")).into_iter().map(|entry| entry.unwrap().into_path());
    let is_python = |file: &PathBuf| {
        let text = fs::read_to_string(file).unwrap_or_default();
        text.starts_with("#!/usr/bin/env python3") || file.extension().is_some_and(|extension| extension == "py")
    };
    let scripts: Vec<PathBuf> = files.filter(|file| file.is_file() && is_python(file)).collect();
    assert!(scripts.len() >= 6, "{scripts:?}");
    let compile = "import ast, sys\nfor file in sys.argv[1:]: ast.parse(open(file).read(), file)";
    let compiled = |files: &[PathBuf]| {
        Ended::of({
            let mut command = Command::new("python3");
            command.args(["-c", compile]).args(files);
            command
        })
    };
    compiled(&scripts).ok();
    let wrong = tempfile::tempdir().unwrap().path().join("wrong.py");
    assert_ne!(compiled(&[wrong]).code, 0);
}

#[test]
fn a_day_on_a_gpu_is_packed_resumed_and_tabulated() {
    if !has_python() {
        return;
    }
    let world = World::new();
    let refused = world.prepare(&["--max-size", "1K"]);
    assert!(refused.code == 2 && refused.stderr.contains("exceed --max-size"), "{}", refused.stderr);
    let packed = world.prepare(&["--max-size", "2M", "--kernel-tests"]).ok();
    assert!(packed.contains("balls.tar.xz") && packed.contains("pipeline.xz"), "{packed}");

    // The first step ends while a training waits.
    let first = world.day(&["--step-time", "24"]);
    assert_eq!(first.code, 75, "{}{}", first.stdout, first.stderr);
    let tables = world.tables();
    assert!(
        tables.contains("not measured: train-balls, profile, method-scgs, method-static3dgs, kernel-tests"),
        "{tables}"
    );
    let second = world.day(&[]).ok();
    assert!(!second.contains("doctor:") && second.contains("method-static3dgs: done"), "{second}");
    let tables = world.tables();
    for row in [
        "| blending | 2 | 0.500 | 0.2500 | 2.0 |",
        "Subgroups of 32. The fastest way is InWorkgroups, **which the program does not use**.",
        "| balls | 30.00 | 0.9000 | 200 | 2.0 | 10.00 | 100 | 500.0 | 500.0 | 500.0 | 1 |",
        "| balls | 200 | 2.0 | 29.00 | 100 |",
        "| balls, full | 55.5 | 1.00 | 0.10 | 3.00 |",
        "2 pass, 1 fail.",
        "* field::reads: layer differs from the CPU's: 2e0 instead of 1e0",
        "| scgs | 200 | 31.00 | 30.00 | -1.000 | 2.00 | 2.00 |",
    ] {
        assert!(tables.contains(row), "{row} in\n{tables}");
    }
    assert!(!tables.contains("Missing"), "{tables}");
    let calls = fs::read_to_string(world.path("state/calls")).unwrap();
    // 200 of the 70,000 steps.
    assert!(calls.contains("nodes.train.params.schedule_scale=2.857e-03"), "{calls}");
    let frame = world.path("packed").join("work/data/dnerf/balls/train/r_0.png");
    assert_eq!(scene::image_file::decode(&frame).unwrap().into_luma8().into_raw(), [10, 200]);
}

#[test]
fn a_day_without_conformance_or_with_a_damaged_package_ends() {
    if !has_python() {
        return;
    }
    let world = World::new();
    world.prepare(&[]).ok();
    let broken = world.day(&["--device", "broken"]);
    assert!(broken.code == 2 && broken.stderr.contains("a render differs"), "{}", broken.stderr);
    assert!(world.tables().contains("* doctor: Failed"));
    fs::remove_dir_all(world.path("packed/work")).unwrap();
    fs::write(world.path("packed/balls.tar.xz"), "damaged").unwrap();
    let damaged = world.day(&[]);
    assert!(damaged.code == 2 && damaged.stderr.contains("balls.tar.xz is damaged"), "{}", damaged.stderr);
}

#[test]
fn kernels_of_the_cpu_are_compared_with_their_floors() {
    if !has_python() {
        return;
    }
    let table = World::new().call(root().join("ci/cpu-floors"), &["--threads", "1"], &[]).ok();
    assert!(table.contains("4000.0 GB/s") && table.contains("| blending | 0.500 | 0.2500 | 2.0 |"), "{table}");
}

#[test]
fn opensplat_is_compared_at_equal_counts() {
    if !has_python() {
        return;
    }
    let world = World::new();
    let compared = world.opensplat(&[("FAKE_COUNT", "100")]).ok();
    assert_eq!(compared.matches("| OpenSplat | ").count(), 2, "{compared}");
    assert!(compared.contains("PSNR of OpenSplat on a.png: 30.00 dB"), "{compared}");
    assert!(compared.contains("PSNR of static3dgs on a.png: 31.00 dB"), "{compared}");
    let unequal = world.opensplat(&[("FAKE_COUNT", "99")]);
    assert!(
        unequal.code == 1 && unequal.stderr.contains("different numbers of Gaussians: 99, 100"),
        "{}",
        unequal.stderr
    );
    let short = world.opensplat(&[("FAKE_COUNT", "100"), ("FAKE_MISSING", "50")]);
    assert!(short.code == 1 && short.stderr.contains("stopped at step 50 of 100"), "{}", short.stderr);
}

#[test]
fn trivial_jobs_are_compared_with_snakemake() {
    if !has_python() {
        return;
    }
    let world = World::new();
    let snakemake = root().join("tests/system/ci_scripts/fake_snakemake");
    let options = ["--jobs", "3", "--rounds", "2", "--snakemake", snakemake.to_str().unwrap()];
    let ours = program(&[]);
    let compare = |environment: &[(&str, &str)]| {
        let environment = [&[("PIPELINE", ours.get_program().to_str().unwrap())], environment].concat();
        world.call(root().join("ci/snakemake"), &options, &environment)
    };
    let compared = compare(&[]).ok();
    for row in [
        "| Snakemake | all jobs | ",
        "| this program | nothing to do | ",
        "nothing to do, CPU seconds: Snakemake takes ",
    ] {
        assert!(compared.contains(row), "{row} in\n{compared}");
    }
    let incomplete = compare(&[("FAKE_MISSING", "1")]);
    assert!(
        incomplete.code == 1 && incomplete.stderr.contains("Snakemake has 2 results instead of 3"),
        "{}",
        incomplete.stderr
    );
}
