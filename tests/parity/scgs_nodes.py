"""SC-GS (yihua7/SC-GS): its node stage, driven as by `train_node_rendering_step` of its `train_gui.py`."""

from types import SimpleNamespace

import torch

import deformable3dgs
import gaussians
import scgs

# The places where this project departs on purpose. A comparison follows them unless requested otherwise.
DEPARTURES = {name: scgs.DEPARTURES[name] for name in ("box", "exact tiles", "visible", "cap", "order")} | {
    "rates": "step i has the candidates' learning rate of i, not of i − 1",
    "still": "candidates do not move before the motion learns; the published code applies the untrained network",
    "start": "the motion first learns after the last step of `place-candidates`, not in it",
    "moments": "the optimiser's moments restart with the motion",
    "rotations": "candidates, which are round, have no rotations to learn; those of the published code turn its splits",
    "losses": "no losses of elasticity and acceleration",
    "rigid nodes": "the ARAP loss holds at most 512 candidates, not the nodes of the last selection",
    "round": "no additional round of density control one step before the motion learns",
    "reset": "opacities are not reset when density control begins on a white background",
    "choice": "the optimiser steps in the step that chooses the nodes, too",
    "last step": "the optimiser steps in the last step of the stage, too",
}
ATTRIBUTES = gaussians.ATTRIBUTES
STAGE = ("place-candidates", "choose-nodes", "settle-nodes")
MOST_RIGID = 512


class Original(scgs.Original):
    def __init__(self, mode, views, scene, ours):
        super().__init__(mode, views, scene, ours)
        from scene.gaussian_model import StandardGaussianModel
        from utils.time_utils import farthest_point_sample

        self.farthest = farthest_point_sample
        self.gaussians = StandardGaussianModel(sh_degree=0, all_the_same=True, with_motion_mask=False)
        for *_, attribute in ATTRIBUTES:
            setattr(self.gaussians, attribute, torch.nn.Parameter(torch.zeros(1, 1)))
        self.gaussians.training_setup(self.opt)
        ends = torch.tensor([scene.params["iterations"][phase] for phase in STAGE]).cumsum(0).tolist()
        self.before = dict(zip(STAGE, [0] + ends))
        self.opt.node_warm_up, self.opt.node_sampling, self.opt.node_end = ends
        self.initial = None

    def load(self, state, phase_begins):
        """Continues from a state of ours."""
        model = self.gaussians
        parts = {part: dict(getattr(state, part)) for part in ("value", "first_moment", "second_moment")}
        count = len(parts["value"]["gaussians.positions"])
        for part in parts.values():
            part["gaussians.sh_rest"] = torch.zeros(count, 0, 3)
        after = dict(state.after, hooks=state.after["hooks"] or [{"statistics": []}])
        after["optimizer_steps"] = after["optimizer_steps"] | {"gaussians.sh_rest": 0}
        keeps = phase_begins and "moments" not in self.ours
        gaussians.load(model, SimpleNamespace(**parts, after=after), ATTRIBUTES, keeps_moments=keeps)
        model.active_sh_degree = 0
        low, high = state.value["network.bounds"]
        self.box = ((low + high) / 2, (high[0] - low[0]) / 2)
        layers = dict(self.warp.network.named_parameters())
        for ours, theirs in self.names.items():
            layers[theirs].data = state.value[ours].clone()
            if not keeps:
                gaussians.set_moments(self.deform.optimizer, layers[theirs], ours, state)
        if self.initial is None:
            self.initial = state.value["gaussians.positions"]

    def in_our_names(self, get):
        """Without the rotations, which are not trained here."""
        found = {name: get(getattr(self.gaussians, attribute)) for name, _, attribute in ATTRIBUTES
                 if name not in ("gaussians.rotations", "gaussians.sh_rest")}
        layers = dict(self.warp.network.named_parameters())
        found |= {ours: get(layers[theirs]) for ours, theirs in self.names.items()}
        return {name: tensor for name, tensor in found.items() if tensor is not None}

    def step(self, facts, noise):
        """One iteration of the published loop: losses, gradients, and the order of the rows after density control."""
        opt, model = self.opt, self.gaussians
        iteration = facts["iteration"] + self.before[facts["phase"]]
        view, interval = self.views[facts["views"][0]], 1 / len(self.views)
        self.gaussians.update_learning_rate(iteration if "rates" in self.ours else iteration - 1)
        self.deform.update_learning_rate(iteration)
        if "rotations" in self.ours:
            next(group for group in model.optimizer.param_groups if group["name"] == "rotation")["lr"] = 0.0
        places = model.get_xyz
        shift = self.warp.query_network(x=places.detach(), t=view.fid[None].expand(len(places), -1))["d_xyz"]
        if iteration < opt.node_warm_up or iteration == opt.node_warm_up and "start" in self.ours:
            shift = 0.0 if "still" in self.ours else shift.detach()
        pipe = SimpleNamespace(debug=False, compute_cov3D_python=False, convert_SHs_python=False)
        package = self.render(view, model, pipe, self.background, shift, 0.0, 0.0, d_rot_as_res=True)
        image, truth = package["render"], view.original_image
        loss = (1 - opt.lambda_dssim) * self.l1_loss(image, truth) + opt.lambda_dssim * (1 - self.ssim(image, truth))
        losses = {"photometric": loss.item()}
        if iteration > opt.node_warm_up:
            self.set_nodes(places.detach() if "rigid nodes" in self.ours else self.initial)
            if "losses" not in self.ours:
                loss = loss + 1e-3 * self.warp.elastic_loss(t=view.fid, delta_t=interval)
                loss = loss + 1e-5 * self.warp.acc_loss(t=view.fid, delta_t=3 * interval)
            self.mode.uniform = noise["rigidity"].tolist()
            rigidity = self.scene.params["scgs"]["candidate_rigidity"] * self.warp.arap_loss()
            self.mode.uniform = []
            losses["rigidity"] = float(rigidity)
            loss = loss + rigidity
        loss.backward()
        gradients = {name: gradient.clone() for name, gradient in self.in_our_names(lambda tensor: tensor.grad).items()}
        with torch.no_grad():
            order = self.finish(iteration, package, noise)
        return losses, gradients, order

    def set_nodes(self, places):
        """The nodes of the regularising losses, of initial size."""
        if len(places) > MOST_RIGID:
            places = places[torch.arange(MOST_RIGID) * len(places) // MOST_RIGID]
        count = len(places)
        self.warp.nodes = torch.nn.Parameter(torch.cat([places, torch.full((count, self.warp.hyper_dim), 1e-2)], 1))
        radius = torch.log(0.1 * (places.max() - places.min()) + 1e-7)
        self.warp._node_radius = torch.nn.Parameter(radius.expand(count).clone())
        self.warp._node_weight = torch.nn.Parameter(torch.zeros(count, 1))

    def finish(self, iteration, package, noise):
        """Statistics, the optimiser's step, density control, and the choice of the nodes."""
        opt, model, seen = self.opt, self.gaussians, package["visibility_filter"]
        steps = "choice" in self.ours if iteration == opt.node_sampling else \
            "last step" in self.ours or iteration != opt.node_end - 1
        if "order" in self.ours and steps:
            self.update()
        order = torch.arange(len(seen))
        if iteration < opt.node_sampling:
            model.add_densification_stats(package["viewspace_points"], seen)
            extra = "round" not in self.ours and iteration == opt.node_warm_up - 1
            if iteration % opt.densification_interval == 0 or extra:
                order = deformable3dgs.Original.densify(self, iteration, noise)
            white = "reset" not in self.ours and bool((self.background == 1).all())
            if iteration % opt.opacity_reset_interval == 0 or white and iteration == opt.densify_from_iter:
                model.reset_opacity()
        if "order" not in self.ours and steps:
            self.update()
        return self.choose() if iteration == opt.node_sampling else order

    def choose(self):
        """Keeps the candidates with the most distant paths; the published code begins with a random one, ours with the first."""
        model, places = self.gaussians, self.gaussians.get_xyz
        times = torch.linspace(0, 1, 16)
        shifts = [self.warp.query_network(x=places, t=time.expand(len(places), 1))["d_xyz"] for time in times]
        paths = (torch.stack(shifts, 1) + places[:, None]).reshape(len(places), -1)
        random, torch.randint = torch.randint, lambda *_, **__: torch.zeros(1, dtype=torch.long)
        chosen = self.farthest(paths[None], self.scene.params["scgs"]["nodes"]["count"])[0]
        torch.randint = random
        for *_, attribute in ATTRIBUTES:
            setattr(model, attribute, torch.nn.Parameter(getattr(model, attribute)[chosen]))
        return torch.arange(len(chosen))

    def rates(self):
        groups = {group["name"]: group["lr"] for group in self.gaussians.optimizer.param_groups}
        rates = {name: groups[group] for name, group, _ in ATTRIBUTES}
        return rates | dict.fromkeys(self.names, self.deform.optimizer.param_groups[0]["lr"])
