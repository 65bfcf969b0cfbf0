"""The measurements, in order of importance. Each is a function that takes the run and returns the result."""
import json, pathlib, re, statistics, subprocess, threading
from functools import partial

FULL_METHOD = "deformable4dgs"
MEASURED = ("device", "training_secs", "total_secs", "ms_per_iteration", "peak_memory_bytes", "curve", "phases")
# Tests of kernels per call, and at a time: a step may end between two calls.
TESTS_PER_CALL, TEST_THREADS = 40, 4
RENDERED = ("fps_raster", "fps_model", "fps_delivered")


def plan(run):
    """The tasks by name."""
    tasks = {"doctor": doctor, "kernels": kernels}
    for scene in run.manifest["scenes"]:
        tasks[f"train-{scene}"] = partial(full_training, scene=scene)
    if run.manifest["scenes"]:
        tasks["profile"] = profile
    for method in methods(run):
        tasks[f"method-{method}"] = partial(method_on_both, method=method)
    if "kernel_tests.xz" in run.manifest["sha256"]:
        tasks["kernel-tests"] = kernel_tests
    return tasks


def methods(run):
    """The methods of the CI recipe, as the packed program plans them."""
    jobs = json.loads(run.pipeline("plan", "ci", "--json", device="cpu"))["jobs"]
    return sorted({name.split("/")[2] for name in jobs if name.startswith("train/")})


def doctor(run):
    """Conformance: the program's own comparison of the adapter with the CPU."""
    text = run.call(run.program("pipeline"), "--store", str(run.store), "doctor", "--device", run.device)
    report = text[text.index("adapter "):]
    agrees = re.search(r"agrees with the CPU in (\d+) comparisons", report)
    return {"text": report.rstrip(), "comparisons": int(agrees[1]) if agrees else 0}


def kernels(run):
    """Kernels next to their minimum times, and every variant of the backward pass of blending."""
    return json.loads(run.call(run.program("kernel_bench"), run.device, str(run.sizes["splats"]), str(run.sizes["bench_px"])))


def dnerf_options(run, scene, scale):
    options = [f"nodes.train.params.schedule_scale={scale}", f'axes.scene=["{scene}"]', f'axes.method=["{FULL_METHOD}"]']
    if run.sizes["width"]:
        options += [f"nodes.capture.params.width={run.sizes['width']}", 'nodes.capture.params.resize="area"',
                    'nodes.capture.params.protocol=""', "nodes.train.params.initial_points.random_count=500"]
    return [part for option in options for part in ("-s", option)]


def full_training(run, scene):
    """The full protocol of a scene: training with its curve, renders with frames per second, metrics."""
    options = dnerf_options(run, scene, run.sizes["schedule_scale"])
    with GpuMemory() as memory:
        run.pipeline("run", "dnerf", *options, "--only", f"metrics/{scene}/{FULL_METHOD}/0")
    result = cell(run, "dnerf", f"{scene}/{FULL_METHOD}/0", options)
    return {**result, "gpu_memory_mib": memory.peak}


def profile(run):
    """The time of every kernel in a short training of the first scene; timing slows it down."""
    scene = run.manifest["scenes"][0]
    options = dnerf_options(run, scene, run.sizes["profile_scale"])
    only = f"train/{scene}/{FULL_METHOD}/0"
    run.pipeline("run", "dnerf", *options, "--only", only, "--profile")
    gpu = shown(run, "dnerf", only, options)["measurements"]["gpu"]
    return {"scene": scene, "gpu": gpu}


def method_on_both(run, method):
    """A few steps of a method on the CPU and on the GPU, and how far the results differ."""
    scale = run.sizes["steps"] / full_length(run, method)
    pixels = run.sizes["method_px"]
    settings = [f'axes.method=["{method}"]', f"nodes.train.params.schedule_scale={scale:.3e}",
                f"nodes.capture.params.width={pixels}", f"nodes.capture.params.height={pixels}"]
    if method == "l4dgs":  # The schedule's scale does not stretch its teacher.
        settings.append(f"nodes.train.params.l4dgs.teacher.iterations={run.sizes['steps']}")
    options = [part for setting in settings for part in ("-s", setting)]
    name, results = f"swinging-arm/{method}/0", {}
    for device in ("cpu", run.device):
        run.pipeline("run", "ci", *options, "--only", f"metrics/{name}", device=device)
        results["cpu" if device == "cpu" else "gpu"] = cell(run, "ci", name, options, device)
    cpu, gpu = results["cpu"], results["gpu"]
    return {"method": method, **results, "psnr_difference": gpu["psnr"] - cpu["psnr"]}


def full_length(run, method):
    """The steps of all phases of a method, before stretching."""
    name = f"train/swinging-arm/{method}/0"
    text = run.pipeline("explain", "ci", name, "-s", f'axes.method=["{method}"]', device="cpu")
    lengths = re.findall(r"^\s+iterations\.\S+ = (\d+)\b", text, re.MULTILINE)
    if not lengths:
        raise ValueError(f"explain shows no iterations of {name}")
    return sum(map(int, lengths))


def kernel_tests(run):
    """Every test of the kernels, on the adapter that the tests choose: a software driver, if there is one. Failures keep their messages."""
    program, kept = run.program("kernel_tests"), run.work / "kernel-tests.json"
    ended = json.loads(kept.read_text()) if kept.exists() else {}
    listed = re.findall(r"^(\S+): test$", run.call(program, "--list"), re.MULTILINE)
    left = [name for name in listed if name not in ended]
    for first in range(0, len(left), TESTS_PER_CALL):
        names = left[first:first + TESTS_PER_CALL]
        printed = run.call(program, "--exact", f"--test-threads={TEST_THREADS}", *names, accepted=(0, 101))
        said = re.findall(r"^---- (\S+) stdout ----\n(.*?)(?=\n\n----|\n\nfailures:)", printed, re.MULTILINE | re.DOTALL)
        messages = dict(said)
        for name, verdict in re.findall(r"^test (\S+)(?: - should panic)? \.\.\. (ok|FAILED)$", printed, re.MULTILINE):
            ended[name] = "" if verdict == "ok" else messages.get(name, "failed without a message").strip()
        kept.write_text(json.dumps(ended))
    failed = {name: message for name, message in ended.items() if message}
    return {"passed": len(ended) - len(failed), "failed": failed, "without_verdict": sorted(set(listed) - set(ended))}


def shown(run, recipe, job, options, device=None):
    return json.loads(run.pipeline("show", recipe, job, *options, "--json", device=device))


def cell(run, recipe, name, options, device=None):
    """Training, renders and metrics of one (scene, method, seed)."""
    training = shown(run, recipe, f"train/{name}", options, device)["measurements"]
    rendering = shown(run, recipe, f"render/{name}", options, device)["measurements"]
    metrics = pathlib.Path(shown(run, recipe, f"metrics/{name}", options, device)["path"]) / "metrics.json"
    images = json.loads(metrics.read_text())["images"]
    result = {key: training[key] for key in MEASURED if key in training}
    result["gpu"] = {key: value for key, value in (training.get("gpu") or {}).items() if key != "kernels"}
    result.update({key: rendering[key] for key in RENDERED if key in rendering})
    for metric in ("psnr", "ssim"):
        result[metric] = statistics.fmean(image["values"][metric] for image in images)
    last = training["curve"][-1]
    return {**result, "images": len(images), "iterations": last["iteration"], "gaussians": last["n_gaussians"]}


class GpuMemory:
    """The largest memory in use that nvidia-smi reports while something runs; `None` without it. It counts all programs."""

    def __enter__(self):
        self.peak, self.over = None, threading.Event()
        self.thread = threading.Thread(target=self.watch, daemon=True)
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()

    def watch(self):
        query = ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits"]
        while True:
            try:
                used = subprocess.run(query, capture_output=True, text=True, timeout=10).stdout.split()
                self.peak = max([int(mib) for mib in used] + [self.peak or 0])
            except (OSError, ValueError, subprocess.TimeoutExpired):
                return
            if self.over.wait(1):
                return
