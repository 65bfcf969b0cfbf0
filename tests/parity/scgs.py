"""SC-GS (yihua7/SC-GS): its modules after the node stage, driven as by `train_step` of its `train_gui.py`."""

from types import SimpleNamespace

import torch

import deformable3dgs
import gaussians
import rasteriser

# The places where this project departs on purpose. A comparison follows them unless requested otherwise.
DEPARTURES = {name: deformable3dgs.DEPARTURES[name] for name in (
    "box", "exact tiles", "visible", "cap", "rates", "moments", "order")} | {
    "warm-up end": "the motion first learns after the last step of the warm-up, not in it",
}
ATTRIBUTES = gaussians.ATTRIBUTES + (("gaussians.node_features", "feature", "feature"),)
HEADS = {"translation": "gaussian_warp", "rotation": "gaussian_rotation", "scale": "gaussian_scaling",
         "frame": "local_rotation"}


def knn_points(points, nodes, _lengths, _node_lengths, K, return_nn=False):
    """Squared distances and indices of the nearest nodes, as by PyTorch3D: distances have gradients."""
    with torch.no_grad():
        squared = ((points[0][:, None] - nodes[0][None]) ** 2).sum(-1)
        index = squared.topk(K, dim=1, largest=False, sorted=True).indices
    found = nodes[0][index]
    distances = ((points[0][:, None] - found) ** 2).sum(-1)
    return Neighbours((distances[None], index[None], found[None] if return_nn else None))


class Neighbours(tuple):
    dists, idx, knn = (property(lambda self, at=at: self[at]) for at in range(3))


class Original:
    def __init__(self, mode, views, scene, ours):
        import pytorch3d.ops

        pytorch3d.ops.knn_points = knn_points
        rasteriser.GaussianRasterizer.returns_opacity = True
        from gaussian_renderer import render
        from scene.deform_model import DeformModel
        from scene.gaussian_model import GaussianModel
        from utils.loss_utils import l1_loss, ssim

        self.render, self.l1_loss, self.ssim = render, l1_loss, ssim
        self.mode, self.views, self.scene, self.ours = mode, views, scene, ours
        rasteriser.RULES = rasteriser.Rules("exact tiles" not in ours, "cap" not in ours, "visible" not in ours)
        settings = scene.params["scgs"]
        self.opt = options(scene.params)
        self.gaussians = GaussianModel(scene.params["harmonics"]["degree"], fea_dim=settings["features"],
                                       with_motion_mask=False)
        self.deform = DeformModel(deform_type="node", is_blender=True, d_rot_as_res=True, node_num=settings["nodes"]["count"],
                                  K=settings["nodes"]["per_gaussian"], hyper_dim=settings["features"], local_frame=True,
                                  with_arap_loss=True)
        self.warp = self.deform.deform
        self.warp.gs = SimpleNamespace(training_setup=lambda _: None)  # the Gaussians of the node stage, which is over
        self.background = torch.tensor(scene.background)
        for *_, attribute in ATTRIBUTES:
            setattr(self.gaussians, attribute, torch.nn.Parameter(torch.zeros(1, 1)))
        self.gaussians.training_setup(self.opt)
        self.deform.train_setting(self.opt)
        self.names = deformable3dgs.layer_names(settings["network"]["depth"], HEADS)
        self.query, self.warp.query_network = self.warp.query_network, self.query_in_box

    def load(self, state, phase_begins):
        """Continues from a state of ours."""
        gaussians.load(self.gaussians, state, ATTRIBUTES, keeps_moments=phase_begins and "moments" not in self.ours)
        low, high = state.value["network.bounds"]
        self.box = ((low + high) / 2, (high[0] - low[0]) / 2)
        layers = dict(self.warp.network.named_parameters())
        for ours, theirs in self.names.items():
            layers[theirs].data = state.value[ours].clone()
            gaussians.set_moments(self.deform.optimizer, layers[theirs], ours, state)
        joined = lambda part, positions: torch.cat([positions, part["nodes.features"]], 1)
        flat = {"nodes": joined(state.value, state.value["nodes.positions"]), "radii": state.value["nodes.log_radii"][:, 0],
                "gates": state.value["nodes.gates"]}
        zeros = torch.zeros_like(state.value["nodes.positions"])
        moments = [{"nodes": joined(part, zeros), "radii": part["nodes.log_radii"][:, 0], "gates": part["nodes.gates"]}
                   for part in (state.first_moment, state.second_moment)]
        steps = {"nodes": "nodes.features", "radii": "nodes.log_radii", "gates": "nodes.gates"}
        view = SimpleNamespace(first_moment=moments[0], second_moment=moments[1], after={"optimizer_steps": {
            name: state.after["optimizer_steps"][ours] for name, ours in steps.items()}})
        for name, parameter in self.node_parameters().items():
            parameter.data = flat[name].clone()
            gaussians.set_moments(self.deform.optimizer, parameter, name, view)

    def node_parameters(self):
        return {"nodes": self.warp.nodes, "radii": self.warp._node_radius, "gates": self.warp._node_weight}

    def in_our_names(self, get):
        found = {name: get(getattr(self.gaussians, attribute)) for name, _, attribute in ATTRIBUTES}
        layers = dict(self.warp.network.named_parameters())
        found |= {ours: get(layers[theirs]) for ours, theirs in self.names.items()}
        nodes = {name: get(parameter) for name, parameter in self.node_parameters().items()}
        if nodes["nodes"] is not None:
            found |= {"nodes.features": nodes["nodes"][:, 3:], "nodes.log_radii": nodes["radii"][:, None],
                      "nodes.gates": nodes["gates"]}
        return {name: tensor for name, tensor in found.items() if tensor is not None}

    def values(self):
        return self.in_our_names(lambda parameter: parameter.detach())

    def query_in_box(self, x, t, **rest):
        center, half = self.box if "box" in self.ours else (0.0, 1.0)
        changes = self.query(x=(x - center) / half, t=t, **rest)
        return changes | {name: changes[name] * half for name in ("d_xyz", "d_scaling")}

    def step(self, facts, noise):
        """One iteration of the published loop: losses, gradients, and the order of the rows after density control."""
        opt, model = self.opt, self.gaussians
        iteration = facts["iteration"] + (opt.warm_up if facts["phase"] == "all" else 0)
        view = self.views[facts["views"][0]]
        self.set_rates(iteration if "rates" in self.ours else iteration - 1)
        # Our degree counts the steps of the node stage, too.
        model.active_sh_degree = facts["sh_degree"]
        self.mode.uniform = noise.get("rigidity", torch.empty(0)).tolist()
        changes = self.deform.step(model.get_xyz.detach(), self.warp.expand_time(view.fid), iteration=iteration,
                                   feature=model.feature, motion_mask=model.motion_mask)
        self.mode.uniform = []
        if iteration < opt.warm_up or iteration == opt.warm_up and "warm-up end" in self.ours:
            changes = {name: change if change is None else change.detach() for name, change in changes.items()}
        pipe = SimpleNamespace(debug=False, compute_cov3D_python=False, convert_SHs_python=False)
        package = self.render(view, model, pipe, self.background, changes["d_xyz"], changes["d_rotation"],
                              changes["d_scaling"], d_rot_as_res=True)
        image, truth = package["render"], view.original_image
        loss = (1 - opt.lambda_dssim) * self.l1_loss(image, truth) + opt.lambda_dssim * (1 - self.ssim(image, truth))
        losses = {"photometric": loss.item()}
        if iteration > opt.warm_up:
            losses["rigidity"] = float(self.deform.reg_loss)
            loss = loss + self.deform.reg_loss
        loss.backward()
        gradients = {name: gradient.clone() for name, gradient in self.in_our_names(lambda tensor: tensor.grad).items()}
        package["viewspace_points_densify"] = package["viewspace_points"]
        with torch.no_grad():
            order = deformable3dgs.Original.finish(self, iteration, package, noise)
        return losses, gradients, order

    densify = deformable3dgs.Original.densify
    update = deformable3dgs.Original.update
    set_rates = deformable3dgs.Original.set_rates

    def rates(self):
        groups = {group["name"]: group["lr"] for group in self.gaussians.optimizer.param_groups}
        rates = {name: groups[group] for name, group, _ in ATTRIBUTES}
        of_nodes = {group["name"]: group["lr"] for group in self.deform.optimizer.param_groups}
        rates |= dict.fromkeys(self.names, of_nodes["deform"])
        return rates | dict.fromkeys(("nodes.features", "nodes.log_radii", "nodes.gates"), of_nodes["nodes"])


def options(params):
    """The published options with the values of our parameters."""
    found = deformable3dgs.options(params, "scgs")
    found.deform_lr_scale = 1.0
    return found
