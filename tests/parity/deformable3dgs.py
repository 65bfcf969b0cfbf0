"""Deformable-3DGS (ingra14m/Deformable-3D-Gaussians): its modules, driven as by its `train.py`."""

from types import SimpleNamespace

import torch

import gaussians
import rasteriser

# The places where this project departs on purpose. A comparison follows them unless requested otherwise.
DEPARTURES = {
    "box": "the network reads positions relative to the scene's box and predicts lengths in its unit",
    "unit quaternions": "the sum of the unit quaternion and its change is normalised before it turns a Gaussian",
    "exact tiles": "a splat reaches every pixel where its alpha is at least 1/255, not the tiles of a square of 3σ",
    "visible": "a splat counts as visible if its box of alpha ≥ 1/255 touches the image, not if its square of 3σ does",
    "cap": "alphas capped at 0.99 have no gradient",
    "rates": "step i has the learning rates of i, not of i − 1",
    "moments": "the optimiser's moments restart with the motion",
    "order": "the optimiser steps before density control, not after it (which drops that step's gradients)",
}


HEADS = {"position": "gaussian_warp", "rotation": "gaussian_rotation", "scale": "gaussian_scaling"}


def layer_names(depth, heads):
    """Our layers and the published ones."""
    names = {f"network.time.{layer}": f"timenet.{2 * layer}" for layer in range(2)}
    names |= {f"network.hidden.{layer}": f"linear.{layer}" for layer in range(depth)}
    names |= {f"network.{ours}": theirs for ours, theirs in heads.items()}
    return {f"{ours}.{part}": f"{theirs}.{part}" for ours, theirs in names.items() for part in ("weight", "bias")}


class Original:
    def __init__(self, mode, views, scene, ours):
        from gaussian_renderer import render
        from scene.deform_model import DeformModel
        from scene.gaussian_model import GaussianModel
        from utils.loss_utils import l1_loss, ssim

        self.render, self.l1_loss, self.ssim = render, l1_loss, ssim
        self.mode, self.views, self.scene, self.ours = mode, views, scene, ours
        rasteriser.RULES = rasteriser.Rules("exact tiles" not in ours, "cap" not in ours, "visible" not in ours,
                                            "unit quaternions" not in ours)
        self.opt = options(scene.params)
        self.gaussians = GaussianModel(scene.params["harmonics"]["degree"])
        self.deform = DeformModel(is_blender=True)
        self.background = torch.tensor(scene.background)
        for attribute in ("_xyz", "_features_dc", "_features_rest", "_opacity", "_scaling", "_rotation"):
            setattr(self.gaussians, attribute, torch.nn.Parameter(torch.zeros(1, 1)))
        self.gaussians.training_setup(self.opt)
        self.deform.train_setting(self.opt)
        self.names = layer_names(scene.params["deformable3dgs"]["network"]["depth"], HEADS)
        self.box = None

    def load(self, state, phase_begins):
        """Continues from a state of ours."""
        gaussians.load(self.gaussians, state, keeps_moments=phase_begins and "moments" not in self.ours)
        if "network.bounds" not in state.value:
            return
        low, high = state.value["network.bounds"]
        self.box = ((low + high) / 2, (high[0] - low[0]) / 2)
        layers = dict(self.deform.deform.named_parameters())
        for ours, theirs in self.names.items():
            layers[theirs].data = state.value[ours].clone()
            gaussians.set_moments(self.deform.optimizer, layers[theirs], ours, state)

    def values(self):
        layers = dict(self.deform.deform.named_parameters())
        network = {ours: layers[theirs].detach() for ours, theirs in self.names.items()}
        return gaussians.values(self.gaussians) | (network if self.box else {})

    def step(self, facts, noise):
        """One iteration of the published loop: losses, gradients, and the order of the rows after density control."""
        opt, model = self.opt, self.gaussians
        iteration = facts["iteration"] + (opt.warm_up if facts["phase"] == "all" else 0)
        view = self.views[facts["views"][0]]
        self.set_rates(iteration if "rates" in self.ours else iteration - 1)
        if iteration % self.scene.params["harmonics"]["interval"] == 0:
            model.oneupSHdegree()
        # The published code already moves in the last step of the warm-up, when our state has no network yet.
        changes = self.changes(view) if iteration > opt.warm_up else (0.0, 0.0, 0.0)
        package = self.render(view, model, SimpleNamespace(debug=False, compute_cov3D_python=False,
                              convert_SHs_python=False), self.background, *changes)
        image, truth = package["render"], view.original_image
        loss = (1 - opt.lambda_dssim) * self.l1_loss(image, truth) + opt.lambda_dssim * (1 - self.ssim(image, truth))
        loss.backward()
        layers = dict(self.deform.deform.named_parameters())
        gradients = gaussians.gradients(model)
        gradients |= {ours: layers[theirs].grad for ours, theirs in self.names.items() if layers[theirs].grad is not None}
        gradients = {name: gradient.clone() for name, gradient in gradients.items()}
        with torch.no_grad():
            order = self.finish(iteration, package, noise)
        return {"photometric": loss.item()}, gradients, order

    def changes(self, view):
        positions = self.gaussians.get_xyz.detach()
        center, half = self.box if "box" in self.ours else (0.0, 1.0)
        time = view.fid.unsqueeze(0).expand(len(positions), -1)
        shift, turn, growth = self.deform.step((positions - center) / half, time)
        return shift * half, turn, growth * half

    def finish(self, iteration, package, noise):
        """Statistics, the optimiser's step and density control."""
        opt, model, seen, radii = self.opt, self.gaussians, package["visibility_filter"], package["radii"]
        model.max_radii2D[seen] = torch.max(model.max_radii2D[seen], radii[seen].float())
        if "order" in self.ours:
            self.update()
        order = torch.arange(len(seen))
        if iteration < opt.densify_until_iter:
            model.add_densification_stats(package["viewspace_points_densify"], seen)
            if iteration > opt.densify_from_iter and iteration % opt.densification_interval == 0:
                order = self.densify(iteration, noise)
            white = bool((self.background == 1).all())
            if iteration % opt.opacity_reset_interval == 0 or (white and iteration == opt.densify_from_iter):
                model.reset_opacity()
        if "order" not in self.ours:
            self.update()
        return order

    def densify(self, iteration, noise):
        opt, model = self.opt, self.gaussians
        size_threshold = opt.max_radius if iteration > opt.opacity_reset_interval else None
        with gaussians.SharedNoise(self.mode, model, noise["split"]) as shared:
            model.densify_and_prune(opt.densify_grad_threshold, opt.min_opacity, self.scene.extent, size_threshold)
            return shared.order()

    def update(self):
        self.gaussians.optimizer.step()
        self.deform.optimizer.step()
        self.gaussians.optimizer.zero_grad(set_to_none=True)
        self.deform.optimizer.zero_grad()

    def set_rates(self, iteration):
        self.gaussians.update_learning_rate(iteration)
        self.deform.update_learning_rate(iteration)

    def rates(self):
        groups = {group["name"]: group["lr"] for group in self.gaussians.optimizer.param_groups}
        rates = {name: groups[group] for name, group, _ in gaussians.ATTRIBUTES}
        return rates | {name: self.deform.optimizer.param_groups[0]["lr"] for name in self.names}


def options(params, method="deformable3dgs"):
    """The published options with the values of our parameters."""
    density, rates = params["density"], params["learning_rates"]
    network = params[method]["network"]["rate"]
    return SimpleNamespace(
        warm_up=params["iterations"]["warm-up"], position_lr_init=rates["position"]["start"],
        position_lr_final=rates["position"]["end"], position_lr_delay_mult=0.01,
        position_lr_max_steps=rates["position"]["steps"], deform_lr_max_steps=network["steps"],
        feature_lr=rates["sh_dc"], opacity_lr=rates["opacity"], scaling_lr=rates["scale"] / 5,
        rotation_lr=rates["rotation"], percent_dense=density["split_above"], lambda_dssim=params["loss"]["lambda_dssim"],
        densification_interval=density["interval"], opacity_reset_interval=density["opacity_reset_interval"],
        densify_from_iter=density["from"], densify_until_iter=density["until"],
        densify_grad_threshold=density["gradient_threshold"], max_radius=20,
        min_opacity=density["min_opacity"])
