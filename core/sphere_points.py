"""Directions spread evenly over the sphere, so that every point drawn along them stands for the same solid angle."""

import math

import torch
from torch import Tensor


def even_directions(count: int) -> Tensor:
    """Return (count, 3) float32 unit vectors on a Fibonacci lattice, the same for every call."""
    step = torch.arange(count, dtype=torch.float64) + 0.5
    height = 1 - 2 * step / count
    azimuth = math.pi * (1 + math.sqrt(5)) * step
    radius = (1 - height * height).sqrt()
    return torch.stack((radius * azimuth.cos(), radius * azimuth.sin(), height), dim=-1).float()
