"""4DGaussians (hustvl/4DGaussians): its modules, driven as by its `train.py`."""

from types import SimpleNamespace

import torch

import gaussians
import rasteriser

# The places where this project departs on purpose. A comparison follows them unless requested otherwise.
DEPARTURES = {
    "exact tiles": "a splat reaches every pixel where its alpha is at least 1/255, not the tiles of a square of 3σ",
    "visible": "a splat counts as visible if its box of alpha ≥ 1/255 touches the image, not if its square of 3σ does",
    "cap": "alphas capped at 0.99 have no gradient",
    "order": "the optimiser steps before density control, not after it (which drops that step's gradients)",
}
HEADS = {"position": "pos_deform", "scale": "scales_deform", "rotation": "rotations_deform",
         "opacity": "opacity_deform", "harmonics": "shs_deform"}
PAIRS = ("xy", "xz", "xt", "yz", "yt", "zt")


def layer_names(heads):
    """Our layers and the published ones."""
    names = {"network.trunk": "feature_out.0"}
    names |= {f"network.{head}.{at}": f"{HEADS[head]}.{2 * at + 1}" for head in heads for at in range(2)}
    return {f"{ours}.{part}": f"deformation_net.{theirs}.{part}" for ours, theirs in names.items()
            for part in ("weight", "bias")}


def flipped(plane, pair):
    """The published box has its corners exchanged, so that its spatial axes run backwards. [C, H, W] either way."""
    return torch.flip(plane, [2] if "t" in pair else [1, 2])


class Original:
    def __init__(self, mode, views, scene, ours):
        from gaussian_renderer import render
        from scene.gaussian_model import GaussianModel
        from utils.loss_utils import l1_loss, ssim

        self.render, self.l1_loss, self.ssim = render, l1_loss, ssim
        self.mode, self.views, self.scene, self.ours = mode, views, scene, ours
        rasteriser.RULES = rasteriser.Rules("exact tiles" not in ours, "cap" not in ours, "visible" not in ours)
        self.opt, self.settings = options(scene.params), scene.params["deformable4dgs"]
        self.gaussians = GaussianModel(scene.params["harmonics"]["degree"], hidden_options(self.settings, scene))
        self.gaussians.spatial_lr_scale = scene.extent
        self.background = torch.tensor(scene.background)
        for attribute in ("_xyz", "_features_dc", "_features_rest", "_opacity", "_scaling", "_rotation"):
            setattr(self.gaussians, attribute, torch.nn.Parameter(torch.zeros(1, 1)))
        self.gaussians.training_setup(self.opt)
        heads = [head for head, is_on in self.settings["heads"].items() if is_on]
        self.layers = layer_names(heads)
        self.planes = {f"field.plane_{scale}_{pair}": (scale, at, pair) for scale in range(len(self.settings["multipliers"]))
                       for at, pair in enumerate(PAIRS)}
        self.has_field = False

    def load(self, state, phase_begins):
        """Continues from a state of ours."""
        model = self.gaussians
        if phase_begins:
            model.training_setup(self.opt)
        gaussians.load(model, state)
        count = len(model._xyz)
        model._deformation_table, model._deformation_accum = torch.ones(count, dtype=torch.bool), torch.zeros(count, 3)
        low, high = state.value["field.bounds"]
        model._deformation.deformation_net.set_aabb(high.tolist(), low.tolist())
        if "network.trunk.weight" not in state.value:
            return
        self.has_field = True
        parameters = dict(model._deformation.named_parameters())
        for ours, theirs in self.layers.items():
            parameters[theirs].data = state.value[ours].clone()
            gaussians.set_moments(model.optimizer, parameters[theirs], ours, state)
        for ours, (scale, at, pair) in self.planes.items():
            parameter = self.grids()[scale][at]
            to_theirs = lambda plane: flipped(plane.permute(2, 0, 1), pair)[None].contiguous()
            parameter.data = to_theirs(state.value[ours])
            gaussians.set_moments(model.optimizer, parameter, ours, state)
            for moment in ("exp_avg", "exp_avg_sq"):
                if parameter in model.optimizer.state:
                    model.optimizer.state[parameter][moment] = to_theirs(model.optimizer.state[parameter][moment])

    def grids(self):
        return self.gaussians._deformation.deformation_net.grid.grids

    def of_field(self, get):
        """Values or gradients of the network and the planes in our names and layouts."""
        parameters = dict(self.gaussians._deformation.named_parameters())
        found = {ours: get(parameters[theirs]) for ours, theirs in self.layers.items()}
        for ours, (scale, at, pair) in self.planes.items():
            plane = get(self.grids()[scale][at])
            found[ours] = None if plane is None else flipped(plane[0], pair).permute(1, 2, 0)
        return {name: tensor for name, tensor in found.items() if tensor is not None}

    def values(self):
        field = self.of_field(lambda parameter: parameter.detach()) if self.has_field else {}
        return gaussians.values(self.gaussians) | field

    def step(self, facts, noise):
        """One iteration of the published loop: losses, gradients, and the order of the rows after density control."""
        opt, model, iteration = self.opt, self.gaussians, facts["iteration"]
        model.update_learning_rate(iteration)
        if iteration % self.scene.params["harmonics"]["interval"] == 0:
            model.oneupSHdegree()
        pipe = SimpleNamespace(debug=False, compute_cov3D_python=False, convert_SHs_python=False)
        packages = [self.render(self.views[at], model, pipe, self.background, stage=facts["phase"]) for at in facts["views"]]
        images = torch.stack([package["render"] for package in packages])
        truths = torch.stack([self.views[at].original_image for at in facts["views"]])
        losses = {"photometric": self.l1_loss(images, truths)}
        loss = losses["photometric"]
        weights = self.settings["temporal_smoothness"], self.settings["time_to_one"], self.settings["spatial_smoothness"]
        if facts["phase"] == "fine":
            loss = loss + model.compute_regulation(*weights)
            parts = (model._time_regulation(), model._l1_regulation(), model._plane_regulation())
            names = ("temporal_smoothness", "time_to_one", "spatial_smoothness")
            losses |= {name: weight * part for name, weight, part in zip(names, weights, parts)}
        if opt.lambda_dssim:
            loss = loss + opt.lambda_dssim * (1 - self.ssim(images, truths))
        loss.backward()
        gradients = gaussians.gradients(model) | self.of_field(lambda parameter: parameter.grad)
        gradients = {name: gradient.clone() for name, gradient in gradients.items()}
        with torch.no_grad():
            order = self.finish(iteration, packages, noise)
        return {name: value.item() for name, value in losses.items()}, gradients, order

    def finish(self, iteration, packages, noise):
        """Statistics, the optimiser's step and density control."""
        opt, model = self.opt, self.gaussians
        radii = torch.stack([package["radii"] for package in packages]).max(0).values
        seen = torch.stack([package["visibility_filter"] for package in packages]).any(0)
        gradient = sum(package["viewspace_points"].grad for package in packages)
        if "order" in self.ours:
            self.update()
        order = torch.arange(len(seen))
        if iteration < opt.densify_until_iter:
            model.max_radii2D[seen] = torch.max(model.max_radii2D[seen], radii[seen].float())
            model.add_densification_stats(gradient, seen)
            order = self.control_density(iteration, noise)
            if iteration % opt.opacity_reset_interval == 0:
                model.reset_opacity()
        if "order" not in self.ours:
            self.update()
        return order

    def control_density(self, iteration, noise):
        opt, model = self.opt, self.gaussians
        size_threshold = opt.max_radius if iteration > opt.opacity_reset_interval else None
        if iteration <= opt.densify_from_iter:
            return torch.arange(len(model._xyz))
        with gaussians.SharedNoise(self.mode, model, noise["split"]) as shared:
            if iteration % opt.densification_interval == 0 and len(model._xyz) < 360000:
                model.densify(opt.densify_grad_threshold, opt.min_opacity, self.scene.extent, size_threshold, 5, 5)
            if iteration % opt.pruning_interval == 0 and len(model._xyz) > opt.prune_above:
                model.prune(opt.densify_grad_threshold, opt.min_opacity, self.scene.extent, size_threshold)
            return shared.order()

    def update(self):
        self.gaussians.optimizer.step()
        self.gaussians.optimizer.zero_grad(set_to_none=True)

    def rates(self):
        groups = {group["name"]: group["lr"] for group in self.gaussians.optimizer.param_groups}
        rates = {name: groups[group] for name, group, _ in gaussians.ATTRIBUTES}
        return rates | dict.fromkeys(self.layers, groups["deformation"]) | dict.fromkeys(self.planes, groups["grid"])


def options(params):
    """The published options with the values of our parameters."""
    density, rates, settings = params["density"], params["learning_rates"], params["deformable4dgs"]
    network, planes = settings["network_rate"], settings["plane_rate"]
    return SimpleNamespace(
        position_lr_init=rates["position"]["start"], position_lr_final=rates["position"]["end"],
        position_lr_delay_mult=0.01, position_lr_max_steps=rates["position"]["steps"],
        deformation_lr_init=network["start"], deformation_lr_final=network["end"], deformation_lr_delay_mult=0.01,
        grid_lr_init=planes["start"], grid_lr_final=planes["end"], feature_lr=rates["sh_dc"],
        opacity_lr=rates["opacity"], scaling_lr=rates["scale"], rotation_lr=rates["rotation"],
        percent_dense=density["split_above"], lambda_dssim=params["loss"]["lambda_dssim"],
        densification_interval=density["interval"], opacity_reset_interval=density["opacity_reset_interval"] or 10**9,
        densify_from_iter=density["from"], densify_until_iter=density["until"],
        densify_grad_threshold=density["gradient_threshold"], max_radius=20,
        pruning_interval=density["prune_interval"], prune_above=density["prune_above_count"],
        min_opacity=density["min_opacity"])


def hidden_options(settings, scene):
    """The published `ModelHiddenParams` with the values of our settings."""
    assert settings["time_axis"] == "upper-half", "the published code reads the upper half of the time axis"
    time = settings["time_resolution"] or (scene.time_count + 1) // 2
    heads = settings["heads"]
    return SimpleNamespace(
        net_width=settings["width"], timebase_pe=4, defor_depth=0, posebase_pe=10, scale_rotation_pe=2, opacity_pe=2,
        timenet_width=64, timenet_output=32, bounds=1.6, multires=settings["multipliers"], grid_pe=0, no_grid=False,
        kplanes_config={"grid_dimensions": 2, "input_coordinate_dim": 4, "output_coordinate_dim": settings["channels"],
                        "resolution": [settings["spatial_resolution"]] * 3 + [time]},
        no_dx=not heads["position"], no_ds=not heads["scale"], no_dr=not heads["rotation"],
        no_do=not heads["opacity"], no_dshs=not heads["harmonics"], empty_voxel=False, static_mlp=False,
        apply_rotation=False)
