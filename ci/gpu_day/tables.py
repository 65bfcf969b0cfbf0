"""tables: the results of `run` as Markdown."""
import math


def table(heads, rows):
    """A Markdown table; columns after the first are aligned to the right."""
    lines = [heads, ["---"] + ["---:"] * (len(heads) - 1), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def number(value, digits=1, factor=1.0):
    return "–" if value is None else f"{value * factor:.{digits}f}"


def results(report, prefix):
    """The results of tasks whose names begin with `prefix`, by the rest of the name."""
    return {name[len(prefix):]: state["result"] for name, state in report["tasks"].items()
            if name.startswith(prefix) and "result" in state}


def of(report):
    """All sections."""
    machine = report["machine"]
    gpu = machine["gpu"] or "no GPU tool on this machine"
    title = f"# {adapter(report)}, {report['date']}"
    what = "Rehearsal: tiny sizes, which say nothing about speed. " if report["size"] == "rehearsal" else ""
    parts = [title, f"{what}Commit {report['commit']}; {machine['cpu']}, {machine['threads']} threads; {gpu}.",
             doctor(report), kernels(report), backward(report), trainings(report), curves(report), launches(report),
             methods(report), kernel_tests(report), failures(report)]
    return "\n\n".join(part for part in parts if part)


def adapter(report):
    return report["tasks"].get("kernels", {}).get("result", {}).get("adapter", report["device"])


def doctor(report):
    found = results(report, "doctor").get("")
    return found and f"```\n{found['text']}\n```"


def kernel_table(found):
    """The output of `kernel_bench` as text: the rates of the device, and kernels relative to the minimum times that they allow."""
    rates = f"{found['copied_bytes_per_sec'] / 1e9:.1f} GB/s (copies), {found['flops_per_sec'] / 1e9:.1f} GFLOP/s"
    has_launches = "launches" in found["kernels"][0]
    rows = [[row["kernel"], *([row["launches"]] if has_launches else []), number(row["ms"], 3), number(row["floor_ms"], 4),
             number(row["ms"] / row["floor_ms"]) if row["ms"] > 0 and row["floor_ms"] > 0 else "–",
             number(row["bytes"], 2, 1e-6), number(row["flops"], 1, 1e-6)] for row in found["kernels"]]
    heads = ["kernel", *(["launches"] if has_launches else []), "ms", "floor (ms)", "times the floor", "MB", "MFLOP"]
    # Absent on a CPU, and from files of earlier programs.
    host = found.get("host_us_per_launch")
    launch = f" The host records and submits a launch in {number(host)} µs." if host else ""
    return f"Measured rates: {rates}. {found['splats']} splats, {found['size_px']} px.{launch}\n\n{table(heads, rows)}"


def kernels(report):
    found = results(report, "kernels").get("")
    return found and f"## Kernels\n\n{kernel_table(found)}"


def backward(report):
    found = results(report, "kernels").get("", {})
    ways = [way for way in found.get("backward", []) if way["ms"] > 0]
    if not ways:
        return None
    fastest = min(ways, key=lambda way: way["ms"])
    rows = [[way["sums"], number(way["ms"], 3), number(way["ms"] / fastest["ms"], 2), "yes" if way["is_used"] else ""]
            for way in ways]
    size = found["subgroup_size"] or "no fixed size"
    verdict = "which the program uses" if fastest["is_used"] else "**which the program does not use**"
    return (f"## Backward pass of blending\n\nSubgroups of {size}. The fastest way is {fastest['sums']}, {verdict}.\n\n"
            + table(["way of summing pixels", "ms", "times the fastest", "used"], rows))


def trainings(report):
    found = results(report, "train-")
    rows = [[scene, number(cell["psnr"], 2), number(cell["ssim"], 4), cell["iterations"], number(cell["training_secs"]),
             number(cell["ms_per_iteration"], 2), cell["gaussians"],
             *[number((cell.get(key) or {}).get("mean")) for key in ("fps_raster", "fps_model", "fps_delivered")],
             number(cell.get("peak_memory_bytes"), 0, 1e-6), number(cell.get("gpu_memory_mib"), 0)]
            for scene, cell in found.items()]
    heads = ["scene", "PSNR (dB)", "SSIM", "steps", "training (s)", "ms per step", "Gaussians", "FPS raster", "FPS model",
             "FPS delivered", "host memory (MB)", "GPU memory (MiB, all programs)"]
    title = "## deformable4dgs on D-NeRF" + (", full protocol" if report["size"] == "full" else "")
    return rows and f"{title}\n\nOne seed each.\n\n" + table(heads, rows)


def curves(report):
    rows = [[scene, point["iteration"], number(point["seconds"]), number(point["psnr_val"], 2), point["n_gaussians"]]
            for scene, cell in results(report, "train-").items() for point in thinned(cell["curve"])]
    heads = ["scene", "step", "seconds", "PSNR on validation views (dB)", "Gaussians"]
    return rows and "## Curves\n\n" + table(heads, rows)


def thinned(curve, most=12):
    """At most `most` points, including the last one."""
    step = max(1, math.ceil(len(curve) / most))
    return curve[::-1][::step][::-1]


def launches(report):
    cells = {f"{scene}, full": cell for scene, cell in results(report, "train-").items()}
    cells |= {f"{name}, few steps": both["gpu"] for name, both in results(report, "method-").items()}
    rows = [[name, number(gpu["launches"]), number(gpu["submissions"], 2), number(gpu["readbacks"], 2),
             number(gpu["uploads"], 2)] for name, cell in cells.items() if (gpu := cell.get("gpu"))]
    heads = ["training", "launches per step", "submissions", "readbacks", "uploads"]
    slowest = ""
    if profiled := results(report, "profile").get(""):
        costs = {name: cost["launches"] * cost["ms_per_launch"] for name, cost in profiled["gpu"]["kernels"].items()}
        order = sorted(costs, key=costs.get, reverse=True)[:20]
        slowest = (f"\n\nThe slowest kernels in a short training of {profiled['scene']} with timed kernels:\n\n"
                   + table(["kernel", "launches per step", "ms per step"],
                           [[name, number(profiled["gpu"]["kernels"][name]["launches"], 2), number(costs[name], 4)]
                            for name in order]))
    return rows and "## Launches\n\n" + table(heads, rows) + slowest


def methods(report):
    rows = [[name, both["gpu"]["iterations"], number(both["cpu"]["psnr"], 2), number(both["gpu"]["psnr"], 2),
             f"{both['psnr_difference']:+.3f}", number(both["cpu"]["training_secs"], 2),
             number(both["gpu"]["training_secs"], 2)] for name, both in results(report, "method-").items()]
    heads = ["method", "steps", "PSNR on the CPU (dB)", "on the GPU (dB)", "difference (dB)", "CPU (s)", "GPU (s)"]
    pixels = report["sizes"]["method_px"]
    return rows and f"## Every method on both devices\n\nswinging-arm at {pixels} px, one seed.\n\n" + table(heads, rows)


def kernel_tests(report):
    found = results(report, "kernel-tests").get("")
    if not found:
        return None
    said = {name: [line for line in message.splitlines() if not line.startswith("note: ")][-1]
            for name, message in found["failed"].items()}
    failed = [f"* {name}: {line}" for name, line in said.items()]
    failed += [f"* {name}: no verdict" for name in found["without_verdict"]]
    return "\n".join([f"## Tests of the kernels\n\n{found['passed']} pass, {len(found['failed'])} fail.\n", *failed]).rstrip()


def failures(report):
    failed = [f"* {name}: {state['error'].splitlines()[0]}" for name, state in report["tasks"].items() if "error" in state]
    missing = report.get("missing") or []
    lines = failed + ([f"* not measured: {', '.join(missing)}"] if missing else [])
    return lines and "## Missing\n\n" + "\n".join(lines)
