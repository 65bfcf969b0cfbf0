"""Compares a training of this project, step by step, with the published code: `parity.py NAME CODE TRACE [--published …]`.

Each step starts from the published program's own state, which is set to ours every 20 steps, after every density event, when a
phase begins, and in each of the first 20 steps. Compared are the losses, the gradients, and the change of every tensor since the
last resynchronisation; as ‖theirs − ours‖ / ‖ours‖, without the one row in a hundred that differs most: a rounding moves a
pixel over a threshold, a point into the next texel, or exchanges two Gaussians at the same place.
"""

import argparse
import datetime
import functools
import importlib
import json
import os
import pathlib
import platform
import subprocess
import sys

import stand_ins  # before torch
import torch

import trace

RESYNC = 20
# Gradients smaller than this share of the largest one are rounding errors, which Adam may scale to full steps, e.g.
# those of the rotations of Gaussians that are still round. Elements whose root mean square gradient is below are not
# compared.
FLOOR = 1e-6
TOLERANCE = {"loss": 1e-4, "gradient": 1e-1, "change": 2e-2, "rate": 1e-6, "rows": 0.0}
# For gradients right after a resynchronisation; in the steps after it, Adam and the network amplify rounding errors.
FIRST_GRADIENT = 2e-2


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="module of this folder: deformable3dgs, deformable4dgs, …")
    parser.add_argument("code", type=pathlib.Path, help="clone of the published code")
    parser.add_argument("trace", type=pathlib.Path, help="folder that `write_trace` filled")
    parser.add_argument("--published", nargs="*", default=[], help="departures whose published rule is followed; all: every one")
    parser.add_argument("--each", action="store_true", help="follow the published rule of one departure after the other")
    parser.add_argument("--first", type=int, default=1, help="first step")
    parser.add_argument("--steps", type=int, default=10**9, help="number of steps")
    parser.add_argument("--stop", action="store_true", help="end at the first step above the tolerance")
    parser.add_argument("--out", type=pathlib.Path, help="write every compared number as JSON")
    args = parser.parse_args()
    args.trace = args.trace.resolve()
    sys.path.insert(0, str(pathlib.Path(__file__).parent))
    # The published code prints a lot.
    show, sys.stdout = functools.partial(print, file=sys.stdout, flush=True), open(os.devnull, "w")
    mode = stand_ins.install(args.code.resolve())
    module = importlib.import_module(args.name)
    views, scene = trace.read_scene(args.trace)
    departures = set(module.DEPARTURES)
    published = departures if args.published == ["all"] else set(args.published)
    if published - departures:
        sys.exit(f"{sorted(published - departures)} are not departures of {args.name}: {sorted(departures)}")
    show(provenance(args))
    if args.each:
        followed = compare(module.Original(mode, views, scene, departures), args)
        usual = {record["step"]: set(exceeds(record)) for record in followed}
        show(f"Above the tolerance with all departures followed: steps {[step for step, kinds in usual.items() if kinds]}")
        for departure, about in module.DEPARTURES.items():
            original = module.Original(mode, views, scene, departures - {departure})
            show(f"| {about} | {first_above(compare(original, args), usual)} |")
        return
    records = []
    for record in compare(module.Original(mode, views, scene, departures - published), args):
        records.append(record)
        show(line(record))
        if args.stop and exceeds(record):
            break
    if args.out:
        args.out.write_text(json.dumps(records))
    summarise(records, show)


def provenance(args):
    """What was compared: dates, commits and versions."""
    root = pathlib.Path(__file__).parents[2]
    minute = lambda time: f"{time:%Y-%m-%d %H:%M}"
    traced = datetime.datetime.fromtimestamp((args.trace / "scene.safetensors").stat().st_mtime)
    return (f"{minute(datetime.datetime.now())}, trace of {minute(traced)}; ours {commit(root)}; "
            f"published {commit(args.code)}; PyTorch {torch.__version__} with {torch.get_num_threads()} thread, "
            f"NumPy {trace.np.__version__}, Python {platform.python_version()}, {processor()}\n")


def commit(folder):
    """The commit of a work tree, and the folders (up to two levels) with tracked files that differ from it."""
    git = lambda *words: subprocess.run(["git", "-C", folder, *words], capture_output=True, text=True).stdout
    paths = git("diff", "--name-only", "HEAD").splitlines()
    changed = sorted({"/".join(pathlib.Path(path).parts[:2]) for path in paths})
    found = git("log", "-1", "--format=%h of %cs").strip()
    state = f"changed in {', '.join(changed)}" if changed else "clean"
    return f"{found}, {state}" if found else "unknown"


def processor():
    about = pathlib.Path("/proc/cpuinfo")
    names = [line.split(":")[1].strip() for line in about.read_text().splitlines() if line.startswith("model name")] \
        if about.exists() else []
    return names[0] if names else platform.machine()


def compare(original, args):
    """One record per step: the relative differences by kind and name."""
    before, synced = trace.read_step(args.trace, args.first - 1), None
    step = args.first
    while step < args.first + args.steps and (args.trace / f"{step:05}.safetensors").exists():
        after = trace.read_step(args.trace, step)
        if synced is None or step < args.first + RESYNC or (step - 1) % RESYNC == 0:
            original.load(before, after.facts["iteration"] == 1)
            synced, age = before, 0
        losses, gradients, order = original.step(after.facts, after.noise)
        record = {"step": step, "phase": after.facts["phase"], "iteration": after.facts["iteration"],
                  "age": age}
        record |= differences(original, before, after, synced, losses, gradients, order)
        yield record
        phase_ends = after.after["phase"] != before.after["phase"]
        if record["event"] or phase_ends:
            synced = None
        before, step, age = after, step + 1, age + 1


def differences(original, before, after, synced, losses, gradients, order):
    facts = after.facts
    rows = lambda state: state.value["gaussians.positions"].shape[0]
    total = sum(facts["losses"].values())
    record = {"losses": {name: abs(losses.get(name, 0.0) - value) / total for name, value in facts["losses"].items()}}
    record["terms"] = {name: abs(losses.get(name, 0.0) / value - 1) for name, value in facts["losses"].items() if value}
    record["losses"]["total"] = abs(sum(losses.values()) - total) / total
    floor = FLOOR * max(gradient.norm().item() for gradient in after.gradient.values())
    record["gradients"] = {name: trace.difference(gradient, gradients.get(name, torch.zeros(())), floor)
                           for name, gradient in after.gradient.items()}
    record["outliers"] = {name: trace.difference(gradient, gradients.get(name, torch.zeros(())), floor, trimmed=False)
                          for name, gradient in after.gradient.items()}
    rates = original.rates()
    record["rates"] = {name: abs(rates[name] / rate - 1) for name, rate in facts["rates"].items()
                       if rate and name in rates and name in gradients}
    record["event"] = "densified" if rows(after) != rows(before) else ""
    theirs = original.values()
    record["rows"] = [rows(after), theirs["gaussians.positions"].shape[0]]
    record["changes"] = {}
    if record["rows"][0] != record["rows"][1]:
        return record
    for name, value in theirs.items():
        if name not in after.value:
            continue
        ours, base = after.value[name], synced.value.get(name)
        if record["event"] and name.startswith("gaussians."):
            # Rows have moved, so whole values are compared.
            record["changes"][name] = trace.difference(ours, value[order])
        elif base is not None:
            counts = is_signal(after, name)
            record["changes"][name] = trace.difference((ours - base)[counts], (value - base)[counts])
    return record


def is_signal(state, name):
    """The elements of a tensor that have received more gradient than rounding since their moments began."""
    largest_moment = max(moment.max().item() for moment in state.second_moment.values() if moment.numel())
    return state.second_moment[name] > FLOOR**2 * largest_moment


def largest(values):
    return max(((value, name) for name, value in values.items()), default=(0.0, "-"))


def line(record):
    parts = [f"{record['step']:4} {record['phase'][:6]:6} loss {record['losses']['total']:.1e}"]
    for kind in ("gradients", "changes", "rates"):
        value, name = largest(record[kind])
        parts.append(f"{kind} {value:.1e} ({name.removeprefix('gaussians.')})")
    ours, theirs = record["rows"]
    parts.append(f"{ours} rows" if ours == theirs else f"{ours} rows, published {theirs}")
    return "  ".join(parts + [record["event"]])


def exceeds(record, usual=None):
    """The kinds of a record above their tolerance, except those that are `usual` in its step."""
    of = {"loss": record["losses"]["total"], "gradient": largest(record["gradients"])[0],
          "change": largest(record["changes"])[0], "rate": largest(record["rates"])[0],
          "rows": abs(record["rows"][0] - record["rows"][1])}
    tolerance = TOLERANCE | ({"gradient": FIRST_GRADIENT} if record["age"] == 0 else {})
    known = (usual or {}).get(record["step"], ())
    return {kind: value for kind, value in of.items() if not value <= tolerance[kind] and kind not in known}


def first_above(records, usual=None):
    """The first step above a tolerance, and the kinds that are."""
    steps = []
    for record in records:
        steps.append(record["step"])
        if above := exceeds(record, usual):
            kinds = ", ".join(f"{kind} {value:.2g}" for kind, value in above.items())
            return f"step {record['step']} ({record['phase']} {record['iteration']}): {kinds}"
    return f"none in steps {steps[0]} to {steps[-1]}"


def summarise(records, show=print):
    """A table of the differences, the density events, and the first step above a tolerance."""
    show("\n| | largest after a resynchronisation | median | 95 % | largest | of, at step |\n|---|---|---|---|---|---|")
    for kind in ("losses", "gradients", "outliers", "changes", "rates"):
        worst = max(records, key=lambda record: largest(record[kind])[0])
        values = sorted(largest(record[kind])[0] for record in records)
        share = [values[int(part * (len(values) - 1))] for part in (0.5, 0.95)]
        first = max(largest(record[kind])[0] for record in records if record["age"] == 0)
        value, name = largest(worst[kind])
        show(f"| {kind} | {first:.1e} | {share[0]:.1e} | {share[1]:.1e} | {value:.1e} | `{name}`, {worst['step']} |")
    terms = sorted({name for record in records for name in record["terms"]})
    for name in terms:
        values = sorted(record["terms"][name] for record in records if name in record["terms"])
        show(f"\nLoss {name} relative to itself: median {values[len(values) // 2]:.1e}, largest {values[-1]:.1e}")
    events = [f"{record['step']}: {record['rows'][0]}/{record['rows'][1]}" for record in records if record["event"]]
    show(f"\n{len(records)} steps; rows ours/published after density events at {', '.join(events) or 'none'}")
    show(f"First above tolerance: {first_above(records)}")


if __name__ == "__main__":
    main()
