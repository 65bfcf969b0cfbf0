"""4D-GS (fudan-zvg/4d-gaussian-splatting): its modules, driven as by its `train.py`."""

import math
import sys
from types import ModuleType, SimpleNamespace
from typing import NamedTuple

import torch

import gaussians
import rasteriser

# The places where this project departs on purpose. A comparison follows them unless requested otherwise.
DEPARTURES = {
    "exact tiles": "a splat reaches every pixel where its alpha is at least 1/255, not the tiles of a square of 3σ",
    "visible": "a splat counts as visible if its box of alpha ≥ 1/255 touches the image, not if its square of 3σ does",
    "cap": "alphas capped at 0.99 have no gradient",
    "wave gradient": "the gradient of the waves by a Gaussian's time is the derivative, not the negative one of the last wave",
    "count": "the first step is step 1; the published counter begins at 2",
    "order": "the optimiser steps before density control, not after it (which drops that step's gradients)",
    "last step": "the optimiser steps in the last iteration, too",
}
ATTRIBUTES = gaussians.ATTRIBUTES[:2] + gaussians.ATTRIBUTES[3:5] + (
    ("gaussians.times", "t", "_t"),
    ("gaussians.log_scales_time", "scaling_t", "_scaling_t"),
    ("gaussians.rotations_right", "rotation", "_rotation"),
    ("gaussians.rotations_left", "rotation_r", "_rotation_r"),
)
REST = ("gaussians.sh_rest", "gaussians.sh_waves")


class Settings(NamedTuple):
    image_height: int
    image_width: int
    tanfovx: float
    tanfovy: float
    bg: torch.Tensor
    scale_modifier: float
    viewmatrix: torch.Tensor
    projmatrix: torch.Tensor
    sh_degree: int
    sh_degree_t: int
    campos: torch.Tensor
    timestamp: float
    time_duration: float
    rot_4d: bool
    gaussian_dim: int
    force_sh_3d: bool
    prefiltered: bool
    debug: bool


class Rasteriser(torch.nn.Module):
    """In place of the CUDA rasteriser of 4D Gaussians: slices them at the time of the settings and renders the slices."""

    published_wave_gradient = False

    def __init__(self, raster_settings):
        super().__init__()
        self.settings = raster_settings

    def forward(self, means3D, means2D, opacities, shs, ts, scales, scales_t, rotations, rotations_r, **_):
        settings = self.settings
        from utils.general_utils import build_rotation_4d

        factor = build_rotation_4d(rotations, rotations_r) * torch.cat([scales, scales_t], 1)[:, None]
        covariance = factor @ factor.transpose(1, 2)
        across, variance = covariance[:, :3, 3], covariance[:, 3, 3:]
        offset = settings.timestamp - ts
        share = torch.exp(-0.5 * offset**2 / variance)
        rows = (share[:, 0] > 0.05).nonzero()[:, 0]
        slices = covariance[:, :3, :3] - across[:, :, None] * across[:, None] / variance[:, :, None]
        means = means3D + across / variance * offset
        colors = self.colors(means[rows], shs[rows], -offset[rows])
        image, depth, alpha, radii = rasteriser.render(settings, means[rows], slices[rows], (opacities * share)[rows, 0],
                                                       colors, [means2D[rows]])
        return image, torch.zeros(len(ts), dtype=radii.dtype).index_copy(0, rows, radii), depth, alpha, None, None

    def colors(self, means, coefficients, time):
        """Harmonics whose coefficients are those of the space plus cosines of the time."""
        settings = self.settings
        count = 16
        sums = coefficients[:, :count]
        for wave in range(1, settings.sh_degree_t + 1):
            used = time
            if self.published_wave_gradient:
                # `backward.cu` has the negative derivative of a wave, and that of the second overwrites that of the first.
                used = time.detach() if wave < settings.sh_degree_t else 2 * time.detach() - time
            cosine = torch.cos(2 * math.pi * wave * used / settings.time_duration)
            sums = sums + cosine[:, :, None] * coefficients[:, wave * count : (wave + 1) * count]
        direction = torch.nn.functional.normalize(means - settings.campos, dim=1)
        return rasteriser.harmonics(settings.sh_degree, sums, direction)


def knnquery(count, points, queries, *_):
    """Indices of the nearest `count` points and their distances, as by the CUDA code: a point is its own neighbour."""
    squared = sum((queries[:, None, axis] - points[None, :, axis]) ** 2 for axis in range(3))
    squared, index = squared.topk(min(count, len(points)), dim=1, largest=False)
    return index, squared.sqrt()


def of_ours(quaternions):
    """Our quaternions as the published ones, whose axes are in reverse order; its own inverse."""
    return quaternions[:, [0, 3, 2, 1]] * quaternions.new_tensor([1, -1, -1, -1])


class Original:
    def __init__(self, mode, views, scene, ours):
        stand_in = ModuleType("gaussian_renderer.diff_gaussian_rasterization")
        stand_in.GaussianRasterizationSettings, stand_in.GaussianRasterizer = Settings, Rasteriser
        sys.modules[stand_in.__name__] = stand_in
        from gaussian_renderer import render
        from scene.gaussian_model import GaussianModel
        from utils import general_utils
        from utils.loss_utils import l1_loss, ssim

        general_utils.knnquery = knnquery
        self.knn = general_utils.knn
        self.render, self.l1_loss, self.ssim = render, l1_loss, ssim
        self.mode, self.views, self.scene, self.ours = mode, views, scene, ours
        length = scene.params["realtime4dgs"]["clip_length"]
        for view in views:
            view.timestamp = view.time * length
        rasteriser.RULES = rasteriser.Rules("exact tiles" not in ours, "cap" not in ours, "visible" not in ours)
        Rasteriser.published_wave_gradient = "wave gradient" not in ours
        self.opt = options(scene.params)
        model = GaussianModel(scene.params["harmonics"]["degree"], gaussian_dim=4, time_duration=[0.0, length],
                              rot_4d=True, sh_degree_t=2)
        self.gaussians, self.background = model, torch.tensor(scene.background)
        model.spatial_lr_scale = scene.extent
        for attribute in [attribute for *_, attribute in ATTRIBUTES] + ["_features_rest"]:
            setattr(model, attribute, torch.nn.Parameter(torch.zeros(1, 1)))
        model.training_setup(self.opt)

    def load(self, state, phase_begins):
        """Continues from a state of ours."""
        model = self.gaussians
        merged = SimpleNamespace(value=converted(state.value), first_moment=converted(state.first_moment),
                                 second_moment=converted(state.second_moment, square=True), after=state.after)
        merged.after["optimizer_steps"]["rest"] = merged.after["optimizer_steps"]["gaussians.sh_rest"]
        attributes = ATTRIBUTES + (("rest", "f_rest", "_features_rest"),)
        gaussians.load(model, merged, attributes)
        model.t_gradient_accum = torch.zeros_like(model.denom)

    def in_our_names(self, get):
        model = self.gaussians
        found = {name: get(getattr(model, attribute)) for name, _, attribute in ATTRIBUTES}
        rest = get(model._features_rest)
        if rest is not None:
            found |= dict(zip(REST, (rest[:, :15], rest[:, 15:])))
        found = {name: tensor for name, tensor in found.items() if tensor is not None}
        turned = {name: of_ours(tensor) for name, tensor in found.items() if "rotations" in name}
        return found | turned

    def values(self):
        return self.in_our_names(lambda parameter: parameter.detach())

    def step(self, facts, noise):
        """One iteration of the published loop: losses, gradients, and the order of the rows after density control."""
        opt, model = self.opt, self.gaussians
        iteration = facts["iteration"] + (0 if "count" in self.ours else 1)
        model.update_learning_rate(iteration)
        self.set_degrees(iteration)
        pipe = SimpleNamespace(debug=False, compute_cov3D_python=False, convert_SHs_python=False, env_map_res=0)
        total, packages = 0.0, []
        for at in facts["views"]:
            package = self.render(self.views[at], model, pipe, self.background)
            image, truth = package["render"], self.views[at].original_image
            loss = (1 - opt.lambda_dssim) * self.l1_loss(image, truth) + opt.lambda_dssim * (1 - self.ssim(image, truth))
            total += loss.item() / len(facts["views"])
            if opt.lambda_rigid > 0:
                rigidity = opt.lambda_rigid * self.rigidity()
                loss = loss + rigidity
            loss = loss / len(facts["views"])
            loss.backward()
            packages.append(package)
        gradients = {name: gradient.clone() for name, gradient in self.in_our_names(lambda tensor: tensor.grad).items()}
        with torch.no_grad():
            order = self.finish(iteration, packages, noise)
        losses = {"photometric": total}
        return losses | ({"rigid": rigidity.item()} if opt.lambda_rigid > 0 else {}), gradients, order

    def rigidity(self):
        """The rigid loss of the published loop."""
        model, count = self.gaussians, self.opt.rigid_neighbors
        positions = model.get_xyz[None].contiguous().detach()
        index, distance = self.knn(positions, positions, count)
        _, velocity = model.get_current_covariance_and_mean_offset(1.0, model.get_t + 0.1)
        apart = torch.norm(velocity[index] - velocity[None, :, None], p=2, dim=-1)
        return (torch.exp(-100 * distance) * apart).sum() / count / len(velocity)

    def set_degrees(self, iteration):
        """As by `oneupSHdegree` in every interval."""
        model, ups = self.gaussians, iteration // self.opt.sh_increase_interval
        model.active_sh_degree = min(ups, model.max_sh_degree)
        model.active_sh_degree_t = min(max(ups - model.max_sh_degree, 0), 2)

    def finish(self, iteration, packages, noise):
        """Statistics, the optimiser's step and density control."""
        opt, model, count = self.opt, self.gaussians, len(packages)
        norms = torch.stack([package["viewspace_points"].grad[:, :2].norm(dim=1) for package in packages], 1).sum(1)
        seen_by = torch.stack([package["visibility_filter"] for package in packages], 1).sum(1)
        radii = torch.stack([package["radii"] for package in packages], 1).max(1)[0]
        seen = seen_by > 0
        norms[seen] = norms[seen] * count / seen_by[seen]
        if "order" in self.ours:
            self.update(iteration)
        order = torch.arange(len(seen))
        if iteration < opt.densify_until_iter:
            model.max_radii2D[seen] = torch.max(model.max_radii2D[seen], radii[seen].float())
            model.add_densification_stats_grad(norms[:, None], seen, torch.zeros_like(model.denom))
            if iteration > opt.densify_from_iter and iteration % opt.densification_interval == 0:
                order = self.densify(iteration, noise)
            white = bool((self.background == 1).all())
            if iteration % opt.opacity_reset_interval == 0 or (white and iteration == opt.densify_from_iter):
                model.reset_opacity()
        if "order" not in self.ours:
            self.update(iteration)
        return order

    def densify(self, iteration, noise):
        opt, model = self.opt, self.gaussians
        size_threshold = opt.max_radius if iteration > opt.opacity_reset_interval else None
        with gaussians.SharedNoise(self.mode, model, noise["split"]) as shared:
            model.densify_and_prune(opt.densify_grad_threshold, opt.min_opacity, self.scene.extent, size_threshold, 1.0)
            return shared.order()

    def update(self, iteration):
        if "last step" in self.ours or iteration < self.opt.iterations:
            self.gaussians.optimizer.step()
        self.gaussians.optimizer.zero_grad(set_to_none=True)

    def rates(self):
        groups = {group["name"]: group["lr"] for group in self.gaussians.optimizer.param_groups}
        return {name: groups[group] for name, group, _ in ATTRIBUTES} | dict.fromkeys(REST, groups["f_rest"])


def converted(tensors, square=False):
    """Tensors by name with the published quaternions, and the harmonics beyond the constant in one tensor `rest`."""
    found = {name: of_ours(tensor) if "rotations" in name else tensor for name, tensor in tensors.items()}
    if square:
        found = {name: tensor.abs() for name, tensor in found.items()}
    return found | {"rest": torch.cat([tensors[name] for name in REST], 1)}


def options(params):
    """The published options with the values of our parameters."""
    density, rates, settings = params["density"], params["learning_rates"], params["realtime4dgs"]
    return SimpleNamespace(
        iterations=params["iterations"]["train"], rigid_neighbors=settings["rigid_neighbors"],
        lambda_rigid=settings["rigid_weight"] if "rigid" in params["effects"] else 0.0,
        position_lr_init=rates["position"]["start"], position_lr_final=rates["position"]["end"], position_t_lr_init=-1.0,
        position_lr_delay_mult=0.01, position_lr_max_steps=rates["position"]["steps"], feature_lr=rates["sh_dc"],
        opacity_lr=rates["opacity"], scaling_lr=rates["scale"], rotation_lr=rates["rotation"],
        percent_dense=density["split_above"], lambda_dssim=params["loss"]["lambda_dssim"],
        sh_increase_interval=params["harmonics"]["interval"], densification_interval=density["interval"],
        opacity_reset_interval=density["opacity_reset_interval"] or 10**9, densify_from_iter=density["from"],
        densify_until_iter=density["until"], densify_grad_threshold=density["gradient_threshold"],
        max_radius=20, min_opacity=density["min_opacity"])
