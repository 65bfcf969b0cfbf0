"""prepare: packs programs, frames and a Vulkan loader into one small folder."""
import datetime, hashlib, io, json, lzma, os, pathlib, shutil, struct, subprocess, sys, tarfile, tempfile, zlib

from . import Problem

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
SPLITS = ("train", "val", "test")
STRONGEST = [{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME}]
# Bytes of scanlines, which have no alignment.
FRAMES = [{**STRONGEST[0], "lc": 4, "lp": 0, "pb": 0}]
# Sizes of the measurements. 23,000 steps are deformable4dgs's full schedule; the rehearsal's few only show that everything runs.
FULL = {"splats": 200000, "bench_px": 800, "schedule_scale": 1.0, "width": None, "steps": 200, "profile_scale": 0.02,
        "frames": None, "method_px": 64}
REHEARSAL = {"splats": 1000, "bench_px": 64, "schedule_scale": 0.002, "width": 48, "steps": 6, "profile_scale": 0.001,
             "frames": 6, "method_px": 32}


def prepare(given):
    """Packs the folder, and refuses it if it exceeds `--max-size`."""
    if given.out.exists() and any(given.out.iterdir()):
        raise Problem(f"{given.out} is not empty")
    sizes = REHEARSAL if given.rehearsal else FULL
    scenes = [scene for scene in given.scenes.split(",") if scene]
    given.out.mkdir(parents=True, exist_ok=True)
    for name, program in programs(given.kernel_tests).items():
        pack_program(program, given.out / f"{name}.xz")
    for scene in scenes:
        pack_scene(pathlib.Path(given.data_root) / "dnerf" / scene, given.out / f"{scene}.tar.xz", sizes["frames"])
    pack_loader(given.loader, given.out / "libvulkan.so.1")
    shutil.copy(ROOT / "ci/gpu-day", given.out / "gpu-day")
    shutil.copytree(ROOT / "ci/gpu_day", given.out / "gpu_day", ignore=shutil.ignore_patterns("__pycache__"))
    files = sorted(path for path in given.out.rglob("*") if path.is_file())
    manifest = {"packed": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"), "commit": commit(),
                "size": "rehearsal" if given.rehearsal else "full", "scenes": scenes, "sizes": sizes,
                "sha256": {str(path.relative_to(given.out)): digest(path) for path in files}}
    (given.out / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")
    return report(given.out, files, given.max_size)


def report(out, files, limit):
    for path in files:
        print(f"{path.stat().st_size / 1e6:8.2f} MB  {path.relative_to(out)}")
    total = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    print(f"{total / 1e6:8.2f} MB  {out}")
    if total > limit:
        shutil.rmtree(out)
        raise Problem(f"{total / 1e6:.1f} MB exceed --max-size {limit / 1e6:.1f} MB; hint: name fewer --scenes, or raise the limit")
    return 0


def programs(with_tests):
    """The programs: those named by PIPELINE, KERNEL_BENCH and KERNEL_TESTS, or built here."""
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release"
    build = {"pipeline": ["--bin", "pipeline"], "kernel_bench": ["-p", "shaders", "--example", "kernel_bench"]}
    places = {"pipeline": target / "pipeline", "kernel_bench": target / "examples/kernel_bench"}
    for name, options in build.items():
        if os.environ.get(name.upper()):
            places[name] = pathlib.Path(os.environ[name.upper()])
        else:
            subprocess.run(["cargo", "build", "--quiet", "--release", *options], cwd=ROOT, check=True)
    if with_tests:
        places["kernel_tests"] = pathlib.Path(os.environ.get("KERNEL_TESTS") or built_tests())
    return places


def built_tests():
    """The tests of the kernels, built here."""
    command = ["cargo", "test", "--quiet", "--release", "-p", "shaders", "--lib", "--no-run", "--message-format=json"]
    printed = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout
    messages = map(json.loads, printed.splitlines())
    return next(message["executable"] for message in messages if message.get("executable"))


def pack_program(program, packed):
    """The program without symbols, compressed. A script, which has none, stays as it is."""
    with tempfile.TemporaryDirectory() as folder:
        copy = pathlib.Path(folder) / "program"
        shutil.copy(program, copy)
        if copy.read_bytes()[:4] == b"\x7fELF":
            subprocess.run(["strip", copy], check=True)
        packed.write_bytes(lzma.compress(copy.read_bytes(), filters=[{"id": lzma.FILTER_X86}, *STRONGEST]))


def pack_scene(folder, packed, frames):
    """The frames that the splits name, with their pixels unchanged. PNG's own compression is undone, because the archive's is
    better."""
    with lzma.open(packed, "wb", filters=FRAMES) as stream, tarfile.open(fileobj=stream, mode="w|") as archive:
        for split in SPLITS:
            source = folder / f"transforms_{split}.json"
            if not source.is_file():
                raise Problem(f"{source} is missing; hint: --data-root is the folder of dnerf/")
            transforms = json.loads(source.read_text())
            named = transforms["frames"]
            transforms["frames"] = named[::max(1, len(named) // frames)][:frames] if frames else named
            add(archive, source.name, json.dumps(transforms).encode())
            for frame in transforms["frames"]:
                name = str(pathlib.PurePosixPath(frame["file_path"])) + ".png"
                add(archive, name, uncompressed(((folder / name).read_bytes())))


def add(archive, name, data):
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    archive.addfile(entry, io.BytesIO(data))


def uncompressed(png):
    """The same PNG with stored instead of compressed scanlines."""
    head, at, kept, scanlines = png[:8], 8, [], b""
    while at < len(png):
        length, kind = struct.unpack(">I4s", png[at:at + 8])
        if kind == b"IDAT":
            scanlines += png[at + 8:at + 8 + length]
        else:
            kept.append((kind, png[at:at + 12 + length]))
        at += 12 + length
    stored = zlib.compress(zlib.decompress(scanlines), 0)
    body = b"IDAT" + stored
    image = struct.pack(">I", len(stored)) + body + struct.pack(">I", zlib.crc32(body))
    end = next(index for index, (kind, _) in enumerate(kept) if kind == b"IEND")
    return head + b"".join(chunk for _, chunk in kept[:end]) + image + kept[end][1]


def pack_loader(given, packed):
    """libvulkan.so.1, for machines that have a driver but no loader."""
    places = [given] if given else [folder / packed.name for folder in map(pathlib.Path, (
        "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib"))]
    found = next((place for place in places if place.is_file()), None)
    if given and not found:
        raise Problem(f"{given} does not exist")
    if found:
        shutil.copy(found, packed)
    else:
        print("no Vulkan loader on this machine: the other machine must have libvulkan.so.1, or name one with --loader",
              file=sys.stderr)


def commit():
    """The commit, with a + if files differ from it; empty outside a repository."""
    def git(*arguments):
        return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True).stdout.strip()
    return git("rev-parse", "--short", "HEAD") + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()
