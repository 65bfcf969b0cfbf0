"""Lets the published code be imported and run on a CPU: `cuda` becomes `cpu`, and packages that no compared line needs are
replaced by empty ones."""

import importlib.abc
import importlib.machinery
import os
import sys

sys.setdlopenflags(os.RTLD_LAZY)  # PyPI's torch without its CUDA packages: unused symbols stay unresolved (README)

import torch
from torch.overrides import TorchFunctionMode

import rasteriser

EMPTY = {"simple_knn", "open3d", "tkinter", "lpips", "matplotlib", "mmcv", "cv2", "torchvision", "imageio", "scipy",
         "sklearn", "tqdm", "pytorch3d", "torch_cluster", "easydict", "util", "pointops2", "kornia", "roma", "natsort",
         "tensorboard", "lpipsPyTorch", "pytorch_msssim", "einops", "submodules", "dearpygui", "nvdiffrast", "torch_scatter",
         "imagesize", "torchmetrics"}


class Empty:
    """Stands for anything that is imported and never used."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Empty()

    def __call__(self, *_, **__):
        return Empty()

    def __mro_entries__(self, _):
        return (object,)


class EmptyPackages(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name, path=None, target=None):
        return importlib.machinery.ModuleSpec(name, self, is_package=True) if name.split(".")[0] in EMPTY else None

    def exec_module(self, module):
        module.__getattr__ = Empty().__getattr__


class OnCpu(TorchFunctionMode):
    """Runs calls that name the device `cuda` on the CPU, and replaces the noise of splits."""

    split_noise = None  # (mean, std) → samples, where noise is shared
    uniform = []  # our uniform draws, in their order, where they are shared

    def __torch_function__(self, func, types, args=(), kwargs=None):
        kwargs = dict(kwargs or {})
        if str(kwargs.get("device", "")).startswith("cuda"):
            kwargs["device"] = "cpu"
        if func is torch.Tensor.cuda:
            return args[0]
        if func is torch.Tensor.to and len(args) > 1 and str(args[1]).startswith("cuda"):
            return args[0]
        if func is torch.normal and self.split_noise:
            return self.split_noise(kwargs["mean"], kwargs["std"])
        if func is torch.rand and self.uniform:
            shape = torch.Size(args[0] if args and not isinstance(args[0], int) else args)
            return torch.tensor([self.uniform.pop(0) for _ in range(shape.numel())]).view(shape)
        return func(*args, **kwargs)


def install(code):
    """Makes the modules of the folder `code` importable; returns the active mode."""
    sys.modules["diff_gaussian_rasterization"] = rasteriser
    sys.meta_path.insert(0, EmptyPackages())
    sys.path.insert(0, str(code))
    torch.cuda.empty_cache = lambda: None
    torch.set_num_threads(1)
    mode = OnCpu()
    mode.__enter__()
    return mode
