"""Edges that run along three axes, made without a photo."""

import math

import torch
from torch import Tensor

from panoloc.core.features.line_support import Edges
from panoloc.core.geometry.rotations import even_directions, rotation_from_vector


def edges_along(axes_from_rig: Tensor, noise_deg: float = 0.3, seed: int = 0, count: int = 600) -> Edges:
    """Return edges that run along the axes, and a third of as many that run anywhere."""
    generator = torch.Generator().manual_seed(seed)
    directions = even_directions(4 * count)[::4]
    axis = axes_from_rig[torch.randint(3, (count,), generator=generator)]
    normals = torch.nn.functional.normalize(torch.linalg.cross(directions, axis), dim=-1)
    anyhow = torch.randn((count, 3), generator=generator)
    anyhow = torch.nn.functional.normalize(anyhow - (anyhow * directions).sum(-1, keepdim=True) * directions, dim=-1)
    normals = torch.where((torch.arange(count) % 4 == 0)[:, None], anyhow, normals)
    turned = torch.randn((count, 3), generator=generator) * math.radians(noise_deg)
    normals = (rotation_from_vector(turned) @ normals[..., None])[..., 0]
    return Edges(directions, torch.nn.functional.normalize(normals, dim=-1))
