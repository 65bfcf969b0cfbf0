//! `--device`: results of GPU and CPU agree and are kept apart.

use serde_json::Value;

use crate::product::{Ended, TINY_JOBS, World, program};

/// Largest difference between the devices in dB. Rounding errors grow within a hundred short steps.
const PSNR: f64 = 0.5;

/// Whether there is a GPU, hardware or software; without one, reports the test as skipped.
fn has_gpu() -> bool {
    let doctor = Ended::of(program(&["doctor", "--device", "gpu"]));
    let required = std::env::var("REQUIRE_ADAPTER").is_ok_and(|value| value == "1");
    assert!(doctor.code == 0 || !required, "REQUIRE_ADAPTER=1: {}", doctor.stdout);
    if doctor.code != 0 {
        support::skip("no GPU adapter");
    }
    doctor.code == 0
}

#[test]
fn results_of_a_gpu_agree_with_the_cpu_and_are_kept_apart() {
    if !has_gpu() {
        return;
    }
    let world = World::tiny();
    world.run(&["--device", "cpu"]);
    // All jobs but the two captures.
    let on_gpu = world.run(&["--device", "gpu"]);
    assert_eq!((on_gpu.counts["executed"], on_gpu.counts["cached"]), (TINY_JOBS as u64 - 2, 2));
    for device in ["gpu", "cpu"] {
        assert_eq!(world.run(&["--device", device]).counts["executed"], 0, "a second run on the {device}");
    }
    let of_training = |device: &str| -> Value {
        let job = "train/bouncing-spheres/deformable4dgs/0";
        serde_json::from_str(&world.call("show", &[job, "--json", "--device", device]).ok()).unwrap()
    };
    let (cpu, gpu) = (of_training("cpu"), of_training("gpu"));
    let psnr = |shown: &Value| {
        let curve = shown["measurements"]["curve"].as_array().unwrap();
        curve.last().unwrap()["psnr_val"].as_f64().unwrap()
    };
    assert!((psnr(&cpu) - psnr(&gpu)).abs() <= PSNR, "{} dB on the CPU, {} on the GPU", psnr(&cpu), psnr(&gpu));
    assert_eq!(cpu["measurements"]["device"], "cpu");
    assert_ne!(gpu["measurements"]["device"], "cpu");
    assert_ne!(cpu["record"]["components"]["environment"], gpu["record"]["components"]["environment"]);
}

#[test]
fn a_missing_device_is_refused_before_any_job_runs() {
    let world = World::tiny();
    let refused = world.call("run", &["--device", "no such adapter"]);
    assert_eq!(refused.code, 13, "{}", refused.stderr);
    let message = if has_gpu() {
        "error: no adapter \"no such adapter\"; hint: there are "
    } else {
        "error: no GPU adapter found; hint: install a Vulkan driver"
    };
    assert!(refused.stderr.contains(message) && !world.path("store/results").exists(), "{}", refused.stderr);
}

#[test]
fn a_machine_without_an_adapter_plans_for_gpus_and_reads_their_results() {
    // Without drivers, no adapter is found, as on a login node.
    let without_adapter = |world: &World, verb: &str, arguments: &[&str]| {
        let mut command = world.command(verb, &[&["--device", "gpu"], arguments].concat());
        Ended::of({
            command.env("VK_DRIVER_FILES", "/none").env("VK_ICD_FILENAMES", "/none");
            command
        })
    };
    let world = World::tiny();
    let plan = without_adapter(&world, "plan", &[]).ok();
    assert!(plan.contains("will run     train/"), "{plan}");
    let run = without_adapter(&world, "run", &[]);
    assert!(run.code == 13 && run.stderr.contains("no GPU adapter found"), "{}", run.stderr);
    if !has_gpu() {
        return;
    }
    let one_method = r#"-saxes.method=["static3dgs"]"#;
    world.run(&[one_method, "--device", "gpu"]);
    let table = without_adapter(&world, "table", &[one_method]).ok();
    assert!(table.contains("static3dgs"), "{table}");
    assert_eq!(without_adapter(&world, "run", &[one_method]).code, 0, "every result exists");
}

#[test]
fn devices_of_this_machine_share_a_run() {
    if !has_gpu() {
        return;
    }
    let (alone, shared) = (World::tiny(), World::tiny());
    let one_method = r#"-saxes.method=["static3dgs"]"#;
    let expected = alone.run(&[one_method, "--device", "gpu"]);
    let found = shared.run(&[one_method, "--device", "gpu", "--devices", "0,0", "--threads", "2"]);
    // Two captures, and a training, a render and a metric of each; the report.
    assert_eq!(found.timeless_of(9), expected.timeless_of(9));
    let runs = std::fs::read_dir(shared.path("store/runs")).unwrap().flatten();
    let took: Vec<usize> = runs
        .flat_map(|run| [1, 2].map(|worker| run.path().join(format!("events-worker-{worker}.jsonl"))))
        .map(|path| std::fs::read_to_string(path).unwrap().matches("\"started\"").count())
        .collect();
    assert!(took.len() == 2 && took.iter().all(|jobs| *jobs > 0), "{took:?}");
    let again = shared.run(&[one_method, "--device", "gpu", "--devices", "all"]);
    assert_eq!(again.counts["executed"], 0);
}

#[test]
fn devices_that_cannot_be_used_are_refused() {
    let world = World::tiny();
    let refused = world.call("run", &["--device", "cpu", "--devices", "99"]);
    assert_eq!(refused.code, 13, "{}", refused.stderr);
    let reason = if has_gpu() { "99" } else { "no GPU adapter" };
    assert!(refused.stderr.contains(reason) && refused.stderr.contains("hint"), "{}", refused.stderr);
    if has_gpu() {
        let other_class = world.call("run", &["--device", "cpu", "--devices", "0"]);
        assert!(other_class.code == 3 && other_class.stderr.contains("add --device gpu"), "{}", other_class.stderr);
    }
    assert!(!world.path("store/results").exists());
}
