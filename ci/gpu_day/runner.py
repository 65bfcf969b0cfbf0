"""run: unpacks the folder, runs tasks until the time of the step is over, and keeps all results in one JSON file."""
import ctypes.util, datetime, hashlib, json, lzma, os, pathlib, platform, signal, subprocess, sys, tarfile, time

from . import Problem, tasks

EXIT_FAILED, EXIT_UNFINISHED = 1, 75
# A stopped training writes its checkpoint in this time.
GRACE_SECS = 20
DRIVERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")


class Stopped(Exception):
    """The time of this step is over."""


class Failed(Exception):
    """A program failed: its exit code and the end of its output."""


class Run:
    """One step of the measurements."""

    def __init__(self, given):
        self.folder, self.device = given.folder.resolve(), given.device
        if not (self.folder / "manifest.json").is_file():
            raise Problem(f"{self.folder} is not a packed folder; hint: `ci/gpu-day prepare --out DIR`, then `DIR/gpu-day run`")
        self.manifest = json.loads((self.folder / "manifest.json").read_text())
        self.sizes, self.work = self.manifest["sizes"], self.folder / "work"
        self.report_file = given.out or self.folder / "gpu-day.json"
        self.deadline = time.monotonic() + given.step_time if given.step_time else None
        self.data, self.store, self.task = self.work / "data", self.work / "store", "unpack"
        # Tests of kernels fail without an adapter.
        self.environment = {**os.environ, "REQUIRE_ADAPTER": "1"}

    def program(self, name):
        return str(self.work / name)

    def unpack(self):
        """Unpacks programs and scenes that are missing, and checks their hashes."""
        for name, expected in self.manifest["sha256"].items():
            packed = self.folder / name
            target = self.data / "dnerf" / name[:-7] if name.endswith(".tar.xz") else self.work / name[:-3]
            if not name.endswith(".xz") or target.exists():
                continue
            if hashlib.sha256(packed.read_bytes()).hexdigest() != expected:
                raise Problem(f"{packed} is damaged: copy it again")
            unpacked = target.with_name(target.name + ".part")
            unpacked.parent.mkdir(parents=True, exist_ok=True)
            if name.endswith(".tar.xz"):
                with tarfile.open(packed) as archive:
                    archive.extractall(unpacked)
            else:
                unpacked.write_bytes(lzma.decompress(packed.read_bytes()))
                unpacked.chmod(0o755)
            unpacked.rename(target)

    def find_driver(self):
        """Uses the packed loader where there is none, and drivers outside the folders that loaders search."""
        if ctypes.util.find_library("vulkan") is None and (self.folder / "libvulkan.so.1").is_file():
            paths = [str(self.folder), self.environment.get("LD_LIBRARY_PATH", "")]
            self.environment["LD_LIBRARY_PATH"] = ":".join(filter(None, paths))
        is_set = any(self.environment.get(name) for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"))
        if not is_set and not any(list(pathlib.Path(folder).glob("*nvidia*.json")) for folder in DRIVERS):
            found = sorted(map(str, pathlib.Path("/usr/local").glob("*/share/vulkan/icd.d/*.json")))
            if found:
                self.environment["VK_DRIVER_FILES"] = self.environment["VK_ICD_FILENAMES"] = ":".join(found)

    def remaining(self):
        return float("inf") if self.deadline is None else self.deadline - GRACE_SECS - time.monotonic()

    def call(self, *command, accepted=(0,)):
        """The output of a program. At the end of the step the program is asked to stop, which saves the progress of trainings."""
        logs = self.work / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        printed, said = logs / f"{self.task}.out", logs / f"{self.task}.err"
        if self.remaining() <= 0:
            raise Stopped
        with open(printed, "w") as stdout, open(said, "w") as stderr:
            process = subprocess.Popen(command, stdout=stdout, stderr=stderr, env=self.environment, cwd=self.work)
            try:
                wait = self.remaining()
                code = process.wait(None if wait == float("inf") else max(wait, 0))
            except subprocess.TimeoutExpired:
                end(process)
                raise Stopped
            except BaseException:
                end(process)
                raise
        if code not in accepted:
            tail = "\n".join((said.read_text(errors="replace") + printed.read_text(errors="replace")).splitlines()[-20:])
            raise Failed(f"exit code {code}: {' '.join(command)}\n{tail}")
        return printed.read_text(errors="replace")

    def pipeline(self, verb, recipe, *options, device=None):
        """Runs a verb of the program on a built-in recipe."""
        place = ["--data-root", str(self.data), "--device", device or self.device]
        return self.call(self.program("pipeline"), "--store", str(self.store), verb, f"builtin:{recipe}", *options, *place)


def end(process):
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(GRACE_SECS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def machine(run):
    """The machine, and what the vendor's tool reports about the GPU."""
    cpu = pathlib.Path("/proc/cpuinfo")
    models = [line.split(":")[1].strip() for line in cpu.read_text().splitlines() if line.startswith("model name")] \
        if cpu.exists() else []
    query = ["nvidia-smi", "--query-gpu=name,driver_version,memory.total,clocks.max.sm", "--format=csv,noheader"]
    try:
        gpu = subprocess.run(query, capture_output=True, text=True, timeout=60).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        gpu = ""
    drivers = {key: run.environment[key] for key in ("VK_DRIVER_FILES", "LD_LIBRARY_PATH") if key in run.environment}
    return {"system": platform.platform(), "cpu": models[0] if models else platform.processor(), "threads": os.cpu_count(),
            "gpu": gpu, "environment": drivers}


def save(path, report):
    """Replaces the report atomically: a killed process leaves the old or the new one."""
    new = path.with_name(path.name + ".new")
    new.write_text(json.dumps(report, indent=1) + "\n")
    new.replace(path)


def start_report(run):
    if run.report_file.exists():
        report = json.loads(run.report_file.read_text())
        if report["commit"] != run.manifest["commit"] or report["size"] != run.manifest["size"]:
            raise Problem(f"{run.report_file} belongs to another package; move it away, or name another --out")
        return report
    kept = {key: run.manifest[key] for key in ("packed", "commit", "size", "scenes", "sizes")}
    return {"schema": 1, **kept, "date": datetime.date.today().isoformat(), "device": run.device, "machine": machine(run),
            "tasks": {}}


def run(given):
    """Runs the tasks that have no result yet. The exit code is 75 if time ran out, 1 if a task failed."""
    run = Run(given)
    run.unpack()
    run.find_driver()
    report = start_report(run)
    wanted = [name for name in given.only.split(",") if name]
    planned = tasks.plan(run)
    unknown = set(wanted) - set(planned)
    if unknown:
        raise Problem(f"no task {', '.join(sorted(unknown))}; there are {', '.join(planned)}")
    report["missing"] = [name for name in planned if "result" not in report["tasks"].get(name, {})]
    for name in [name for name in planned if not wanted or name in wanted]:
        state = report["tasks"].setdefault(name, {"seconds": 0.0, "calls": 0})
        if "result" in state or ("error" in state and not given.retry):
            continue
        if not attempt(run, planned[name], name, state):
            save(run.report_file, report)
            print(f"{name}: unfinished; run again to continue", flush=True)
            return EXIT_UNFINISHED
        report["missing"] = [name for name in planned if "result" not in report["tasks"].get(name, {})]
        save(run.report_file, report)
        print(f"{name}: {'FAILED' if 'error' in state else 'done'} after {state['seconds']:.1f} s", flush=True)
        if name == "doctor" and "error" in state:
            raise Problem(f"the device is unusable; nothing else is measured:\n{state['error']}")
    print(run.report_file)
    return EXIT_FAILED if any("error" in state for state in report["tasks"].values()) else 0


def attempt(run, task, name, state):
    """Runs a task; `False` if the time of the step ended first. Seconds add up over steps."""
    start, run.task = time.monotonic(), name
    state.pop("error", None)
    state["calls"] += 1
    try:
        state["result"] = task(run)
    except Stopped:
        return False
    except (Failed, KeyError, ValueError) as problem:
        state["error"] = f"{type(problem).__name__}: {problem}"
        print(state["error"], file=sys.stderr)
    finally:
        state["seconds"] += time.monotonic() - start
    return True
