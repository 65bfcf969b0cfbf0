"""The published `GaussianModel` (any fork of Kerbl et al. 2023) on states of this project, and its density control."""

import torch

# Our tensor, the name of its parameter group, the attribute of the published model.
ATTRIBUTES = (
    ("gaussians.positions", "xyz", "_xyz"),
    ("gaussians.sh_dc", "f_dc", "_features_dc"),
    ("gaussians.sh_rest", "f_rest", "_features_rest"),
    ("gaussians.opacity_logits", "opacity", "_opacity"),
    ("gaussians.log_scales", "scaling", "_scaling"),
    ("gaussians.rotations", "rotation", "_rotation"),
)


def set_moments(optimizer, parameter, name, state):
    """The moments of one tensor; a fresh optimizer has none."""
    steps = state.after["optimizer_steps"][name]
    optimizer.state.pop(parameter, None)
    if steps > 0:
        optimizer.state[parameter] = {
            "step": torch.tensor(float(steps)), "exp_avg": state.first_moment[name].clone(),
            "exp_avg_sq": state.second_moment[name].clone()}


def load(model, state, attributes=ATTRIBUTES, keeps_moments=False):
    """Sets the Gaussians, their moments unless it `keeps_moments`, and the statistics of density control."""
    groups = {group["name"]: group for group in model.optimizer.param_groups}
    for name, group, attribute in attributes:
        kept = model.optimizer.state.pop(groups[group]["params"][0], None)
        parameter = torch.nn.Parameter(state.value[name].clone())
        groups[group]["params"] = [parameter]
        setattr(model, attribute, parameter)
        if not keeps_moments:
            set_moments(model.optimizer, parameter, name, state)
        elif kept:
            model.optimizer.state[parameter] = kept
    statistics = torch.tensor(state.after["hooks"][0]["statistics"]).view(-1, 3)
    count = model._xyz.shape[0]
    if len(statistics) < count:
        statistics = torch.cat([statistics, torch.zeros(count - len(statistics), 3)])
    model.xyz_gradient_accum, model.denom = statistics[:, :1].clone(), statistics[:, 1:2].clone()
    model.max_radii2D = statistics[:, 2].clone()
    model.active_sh_degree = state.after["sh_degree"]


def values(model):
    return {name: getattr(model, attribute).detach() for name, _, attribute in ATTRIBUTES}


def gradients(model):
    return {name: getattr(model, attribute).grad for name, _, attribute in ATTRIBUTES
            if getattr(model, attribute).grad is not None}


class SharedNoise:
    """Draws the children of splits from our stream, and knows the order of their rows.

    The published rows of children are all first children, then all second ones; ours are sibling by sibling.
    """

    def __init__(self, mode, model, noise):
        self.mode, self.model, self.noise = mode, model, noise
        self.parents, self.mask = 0, None

    def __enter__(self):
        self.mode.split_noise = self.samples
        self.prune = self.model.prune_points
        self.model.prune_points = self.record
        return self

    def __exit__(self, *_):
        self.mode.split_noise = None
        self.model.prune_points = self.prune

    def samples(self, mean, std):
        self.parents, columns = len(std) // 2, std.shape[1]
        draws = self.noise[: std.numel()].view(self.parents, 2, columns).transpose(0, 1).reshape(-1, columns)
        return mean + std * draws

    def record(self, mask):
        self.mask = mask.clone()
        self.prune(mask)

    def order(self):
        """The permutation that brings the published rows into our order."""
        rows = torch.arange(self.model._xyz.shape[0])
        if self.parents == 0:
            return rows
        kept = int((~self.mask[len(self.mask) - 2 * self.parents :]).sum()) // 2
        children = rows[len(rows) - 2 * kept :].view(2, kept).T.reshape(-1)
        return torch.cat([rows[: len(rows) - 2 * kept], children])
