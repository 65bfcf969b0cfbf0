"""Reads the files that `trainer/trace_tests.rs` writes, and compares tensors."""

import json
import math
import struct
from types import SimpleNamespace

import numpy as np
import torch


def read(path):
    """Tensors by name and the metadata of a safetensors file."""
    data = path.read_bytes()
    length = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8 : 8 + length])
    metadata = {key: json.loads(value) for key, value in header.pop("__metadata__", {}).items()}
    start = 8 + length
    tensors = {}
    for name, entry in header.items():
        low, high = entry["data_offsets"]
        values = np.frombuffer(data, np.float32, (high - low) // 4, start + low).reshape(entry["shape"])
        tensors[name] = torch.from_numpy(values.copy())
    return tensors, metadata


def read_scene(folder):
    """Views with cameras as the published code describes them, and the facts of the scene."""
    tensors, metadata = read(folder / "scene.safetensors")
    facts = metadata["scene"]
    views = [camera(view, tensors[f"image.{at:03}"]) for at, view in enumerate(facts["views"])]
    return views, SimpleNamespace(**{key: facts[key] for key in ("params", "extent", "unit_world", "background", "time_count")})


def camera(view, image):
    """A view with the attributes of the published `Camera` classes (row vectors, transposed matrices)."""
    width, height = view["width"], view["height"]
    world_view = torch.eye(4)
    world_view[:3, :3] = torch.tensor(view["rotation"]).T
    world_view[3, :3] = torch.tensor(view["translation"])
    tangents = [size / (2 * focal) for size, focal in zip((width, height), view["focal"])]
    near, far = 0.01, 100.0
    projection = torch.zeros(4, 4)
    projection[0, 0], projection[1, 1] = 1 / tangents[0], 1 / tangents[1]
    projection[2, 2], projection[2, 3], projection[3, 2] = far / (far - near), -far * near / (far - near), 1.0
    assert view["center"] == [width / 2, height / 2], "the published projections have their centre in the middle"
    return SimpleNamespace(
        image_width=width, image_height=height, FoVx=2 * math.atan(tangents[0]), FoVy=2 * math.atan(tangents[1]),
        world_view_transform=world_view, full_proj_transform=world_view @ projection.T,
        camera_center=world_view.inverse()[3, :3], original_image=image.permute(2, 0, 1).contiguous(),
        time=view["time"], fid=torch.tensor([view["time"]], dtype=torch.float32))


def read_step(folder, step):
    """One step: `value`, `first_moment`, `second_moment`, `gradient` and `noise` by name, `after` and `step`."""
    tensors, metadata = read(folder / f"{step:05}.safetensors")
    # The Gaussians of a node stage are compared by the names of the others, which do not exist yet.
    plain = lambda name: name.replace("candidates.", "gaussians.")
    parts = {part: {} for part in ("value", "first_moment", "second_moment", "gradient", "noise")}
    for name, tensor in tensors.items():
        part, name = name.split(".", 1)
        parts[part][plain(name)] = tensor
    after, facts = metadata["trace"]["after"], metadata["trace"]["step"]
    for of, key in ((after, "optimizer_steps"), (facts, "rates")):
        if of:
            of[key] = {plain(name): value for name, value in of[key].items()}
    return SimpleNamespace(**parts, after=after, facts=facts)


def difference(ours, theirs, floor=0.0, trimmed=True):
    """‖theirs − ours‖ / ‖ours‖ (L2); of smaller tensors than `floor`, divided by that.

    `trimmed` leaves out the one row in a hundred that differs most.
    """
    if len(ours) == 0:
        return 0.0
    if theirs.shape != ours.shape:
        theirs = torch.zeros_like(ours)
    size = max(ours.double().norm().item(), floor)
    rows = (theirs.double() - ours.double()).reshape(len(ours), -1).norm(dim=1).sort().values
    error = rows[: len(rows) - len(rows) // 100 if trimmed else None].norm().item()
    return error / size if size > 0 else error
