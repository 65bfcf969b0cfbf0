"""A plain PyTorch rasteriser with the interface and the rules of diff-gaussian-rasterization (Kerbl et al. 2023).

`RULES` switches the few rules in which this project's rasteriser differs, so that the effect of each can be measured. It does not
switch the gradient of depth beyond the limits of the Jacobian, which is the derivative here as in this project; the published one is
that for positions within the limits.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch

TILE = 16
SH = (
    (0.28209479177387814,),
    (-0.4886025119029199, 0.4886025119029199, -0.4886025119029199),
    (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396),
    (-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658,
     1.445305721320277, -0.5900435899266435),
)


@dataclass
class Rules:
    """True: as in the CUDA code; False: as in this project."""

    tiles_of_three_sigma: bool = True  # splats reach the tiles of a square of 3σ; ours: every pixel with alpha ≥ 1/255
    gradient_through_cap: bool = True  # alphas capped at 0.99 pass their gradient on; ours: none
    visible_by_square: bool = True  # visible: the square touches a tile; ours: a box of alpha ≥ 1/255 touches the image
    raw_quaternions: bool = True  # quaternions are used as they are; ours: normalised
    precision: torch.dtype = torch.float32  # of the determinant ac − b², which cancels; ours avoids the difference


RULES = Rules()


class GaussianRasterizationSettings(NamedTuple):
    image_height: int
    image_width: int
    tanfovx: float
    tanfovy: float
    bg: torch.Tensor
    scale_modifier: float
    viewmatrix: torch.Tensor
    projmatrix: torch.Tensor
    sh_degree: int
    campos: torch.Tensor
    prefiltered: bool
    debug: bool


class GaussianRasterizer(torch.nn.Module):
    """Returns the image [3, H, W], radii [N], depth [1, H, W] and, of some forks, the opacity [1, H, W]."""

    returns_opacity = False

    def __init__(self, raster_settings):
        super().__init__()
        self.settings = raster_settings

    def forward(self, means3D, means2D, opacities, shs=None, colors_precomp=None, scales=None, rotations=None,
                cov3D_precomp=None, means2D_densify=None):
        settings = self.settings
        covariances = unpacked(cov3D_precomp) if scales is None else covariance(scales, rotations)
        colors = colors_precomp
        if colors is None:
            direction = torch.nn.functional.normalize(means3D - settings.campos, dim=1)
            colors = harmonics(settings.sh_degree, shs, direction)
        screen = [points for points in (means2D, means2D_densify) if points is not None]
        image, depth, opacity, radii = render(settings, means3D, covariances, opacities[:, 0], colors, screen)
        return (image, radii, depth, opacity) if self.returns_opacity else (image, radii, depth)


def harmonics(degree, coefficients, direction):
    """max(0, ½ + Σ Y·sh) of [N, K, 3] in directions [N, 3]."""
    x, y, z = direction.unbind(1)
    basis = [torch.ones_like(x)]
    if degree > 0:
        basis += [y, z, x]
    if degree > 1:
        basis += [x * y, y * z, 2 * z * z - x * x - y * y, x * z, x * x - y * y]
    if degree > 2:
        basis += [y * (3 * x * x - y * y), x * y * z, y * (4 * z * z - x * x - y * y),
                  z * (2 * z * z - 3 * x * x - 3 * y * y), x * (4 * z * z - x * x - y * y), z * (x * x - y * y),
                  x * (x * x - 3 * y * y)]
    factors = [factor for band in SH[: degree + 1] for factor in band]
    basis = torch.stack([factor * value for factor, value in zip(factors, basis)], 1)
    return torch.clamp_min((basis[:, :, None] * coefficients[:, : basis.shape[1]]).sum(1) + 0.5, 0)


def covariance(scales, quaternions):
    """R·diag(s²)·Rᵀ; quaternions (w, x, y, z) are not normalised."""
    scales, quaternions = scales.to(RULES.precision), quaternions.to(RULES.precision)
    if not RULES.raw_quaternions:
        quaternions = torch.nn.functional.normalize(quaternions, dim=1)
    w, x, y, z = quaternions.unbind(1)
    rotation = torch.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1).view(-1, 3, 3)
    factor = rotation * scales[:, None, :]
    return factor @ factor.transpose(1, 2)


def unpacked(upper):
    """[N, 6] upper triangles as [N, 3, 3]."""
    return upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].view(-1, 3, 3)


def render(settings, means, covariances, opacities, colors, screen_points):
    """Colour [3, H, W], depth [1, H, W], opacity [1, H, W] and radii [N]; gradients by `screen_points` are in NDC."""
    width, height = settings.image_width, settings.image_height
    size = means.new_tensor([width, height])
    view, homogeneous = transformed(means, settings.viewmatrix)[:, :3], transformed(means, settings.projmatrix)
    ndc = homogeneous[:, :2] / (homogeneous[:, 3:] + 1e-7)
    for points in screen_points:
        ndc = ndc + points[:, :2]
    centers = ((ndc + 1) * size - 1) / 2
    exact = lambda values: values.to(RULES.precision)
    camera = settings._replace(viewmatrix=exact(settings.viewmatrix))
    a, b, c = projected_covariance(camera, exact(view), exact(covariances), exact(size)).unbind(1)
    determinant = a * c - b * b
    conics = (torch.stack([c, -b, a], 1) / determinant[:, None]).float()
    a, c, determinant = a.float(), c.float(), determinant.float()

    middle = (a + c) / 2
    radius = torch.ceil(3 * torch.sqrt(middle + torch.sqrt(torch.clamp_min(middle**2 - determinant, 0.1))))
    in_front = (view[:, 2] > 0.2) & (determinant != 0)
    low, high = tiles(centers - radius[:, None], centers + radius[:, None], size)
    by_square = in_front & ((high - low) > 0).all(1)
    cutoff = torch.log(torch.clamp_min(opacities * 255, 1e-9))
    extent = torch.sqrt(2 * torch.clamp_min(cutoff, 0)[:, None] * torch.stack([a, c], 1))
    by_alpha = in_front & (cutoff >= 0) & (centers + 0.5 + extent >= 0).all(1) & (centers + 0.5 - extent <= size).all(1)
    if RULES.tiles_of_three_sigma:
        drawn = by_square
    else:
        drawn = by_alpha
        low, high = tiles(centers - extent - 1, centers + extent + 1, size)
    visible = by_square if RULES.visible_by_square else by_alpha

    order = torch.argsort(view[:, 2].detach(), stable=True)
    order = order[drawn[order]]
    splats = (centers, conics, opacities, torch.cat([colors, view[:, 2:]], 1))
    background = torch.cat([settings.bg, settings.bg.new_zeros(1)])
    rows = []
    for row in range((height + TILE - 1) // TILE):
        in_row = order[(low[order, 1] <= row) & (row < high[order, 1])]
        blended = [blend(splats, in_row[(low[in_row, 0] <= column) & (column < high[in_row, 0])], column, row, settings,
                         background) for column in range((width + TILE - 1) // TILE)]
        rows.append(torch.cat(blended, 2))
    image = torch.cat(rows, 1)
    return image[:3], image[3:4], image[4:], torch.where(visible, radius, 0).detach().int()


def transformed(points, matrix):
    """Rows (x, y, z, 1) times a matrix, summed as in the CUDA code: equal points have equal depths, whatever their row."""
    x, y, z = points[:, :, None].unbind(1)
    return x * matrix[0] + y * matrix[1] + z * matrix[2] + matrix[3]


def projected_covariance(settings, view, covariances, size):
    """(a, b, c) in px² with the dilation, for means [N, 3] in view space."""
    slope = view.new_tensor([settings.tanfovx, settings.tanfovy])
    focal = size / (2 * slope)
    depth = view[:, 2]
    inside = torch.clamp(view[:, :2] / depth[:, None], -1.3 * slope, 1.3 * slope)
    zero = torch.zeros_like(depth)
    jacobian = torch.stack([focal[0] / depth, zero, -focal[0] * inside[:, 0] / depth,
                            zero, focal[1] / depth, -focal[1] * inside[:, 1] / depth], 1).view(-1, 2, 3)
    map_ = jacobian @ settings.viewmatrix[:3, :3].T
    projected = map_ @ covariances @ map_.transpose(1, 2)
    return torch.stack([projected[:, 0, 0] + 0.3, projected[:, 0, 1], projected[:, 1, 1] + 0.3], 1)


def tiles(low, high, size):
    """The half-open range of tiles of boxes in px, truncated as in the CUDA code."""
    last = torch.div(size + TILE - 1, TILE, rounding_mode="floor")
    clip = lambda values: torch.minimum(torch.clamp_min(torch.trunc(values.detach()), 0), last).long()
    return clip(low / TILE), clip((high + TILE - 1) / TILE)


def blend(splats, chosen, column, row, settings, background):
    """Channels and opacity of one tile, front to back: [C + 1, h, w]."""
    centers, conics, opacities, values = (values[chosen] for values in splats)
    height, width = min(TILE, settings.image_height - row * TILE), min(TILE, settings.image_width - column * TILE)
    ys, xs = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    pixels = torch.stack([xs + column * TILE, ys + row * TILE], -1).view(-1, 1, 2)
    dx, dy = (centers[None] - pixels).unbind(2)
    power = -0.5 * (conics[:, 0] * dx * dx + conics[:, 2] * dy * dy) - conics[:, 1] * dx * dy
    free = opacities * torch.exp(torch.clamp_max(power, 0))
    alpha = torch.clamp_max(free, 0.99)
    if RULES.gradient_through_cap:
        alpha = free + (alpha - free).detach()
    alpha = torch.where((power <= 0) & (alpha >= 1 / 255), alpha, 0)
    after = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
    weights = torch.where(after >= 1e-4, alpha * before, 0)
    left = torch.where(after >= 1e-4, 1 - alpha, 1).prod(1)
    channels = weights @ values + left[:, None] * background
    return torch.cat([channels, 1 - left[:, None]], 1).T.reshape(-1, height, width)
