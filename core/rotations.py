"""Rotations spread uniformly over SO(3), and small rotations for refinement.

Paper: §3.3 (N_r rotations spread uniformly over SO(3)). The spread is a super-Fibonacci spiral (Alexa, CVPR 2022), which exists for any
number of rotations and covers SO(3) more evenly than a grid of Euler angles.
"""

import math

import torch
from torch import Tensor

# Roots used by the spiral: φ = √2 and ψ with ψ⁴ = ψ + 4 (Alexa 2022, §3).
_PHI = math.sqrt(2.0)
_PSI = 1.533751168755204288118041


def uniform_rotations(count: int) -> Tensor:
    """Return (count, 3, 3) float32 rotation matrices spread evenly over SO(3), the same for every call."""
    s = torch.arange(count, dtype=torch.float64) + 0.5
    t = s / count
    r, big_r = t.sqrt(), (1 - t).sqrt()
    alpha, beta = 2 * math.pi * s / _PHI, 2 * math.pi * s / _PSI
    quaternions = torch.stack((r * alpha.sin(), r * alpha.cos(), big_r * beta.sin(), big_r * beta.cos()), dim=-1)
    return matrix_from_quaternion(quaternions).float()


def matrix_from_quaternion(quaternion: Tensor) -> Tensor:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4) in the order x, y, z, w."""
    x, y, z, w = quaternion.unbind(-1)
    rows = (
        torch.stack((1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)), dim=-1),
        torch.stack((2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)), dim=-1),
        torch.stack((2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)), dim=-1),
    )
    return torch.stack(rows, dim=-2)


def rotation_from_vector(vector: Tensor) -> Tensor:
    """Return rotation matrices (..., 3, 3) of rotation vectors (..., 3) in radians (exponential map)."""
    angle = vector.norm(dim=-1, keepdim=True)
    half = angle / 2
    # sin(a/2)/a tends to 1/2; below 1e-6 the series is exact to float precision.
    scale = torch.where(angle > 1e-6, half.sin() / angle.clamp_min(1e-12), torch.full_like(angle, 0.5))
    return matrix_from_quaternion(torch.cat((vector * scale, half.cos()), dim=-1))


def rotation_angle(first: Tensor, second: Tensor) -> Tensor:
    """Return the angle (...) in radians between rotation matrices (..., 3, 3)."""
    trace = (first * second).sum((-1, -2))
    return torch.arccos(((trace - 1) / 2).clamp(-1, 1))
