"""Rotations spread uniformly over SO(3), directions spread evenly over the sphere, and small rotations for refinement.

Paper: §3.3 (N_r rotations spread uniformly over SO(3)). The spread is a super-Fibonacci spiral (Alexa, CVPR 2022), which exists for any
number of rotations and covers SO(3) more evenly than a grid of Euler angles.
"""

import math
from functools import lru_cache
from itertools import permutations

import torch
from torch import Tensor

from panoloc.core.geometry.pose import matrix_from_quaternion

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
    return torch.from_numpy(matrix_from_quaternion(quaternions.numpy())).float()


def rotation_spacing(count: int) -> float:
    """Return how far apart (rad) so many rotations are that are spread evenly: the edge of each one's cube of the volume of SO(3)."""
    return math.cbrt(8 * math.pi**2 / count)


def rotation_from_vector(vector: Tensor) -> Tensor:
    """Return rotation matrices (..., 3, 3) of rotation vectors (..., 3) in radians (exponential map)."""
    angle = vector.norm(dim=-1)[..., None, None]
    axes = torch.eye(3, dtype=vector.dtype, device=vector.device).expand(*vector.shape, 3)
    cross = torch.linalg.cross(vector[..., None], axes, dim=-2)
    # Rodrigues: 1 + sin a / a [v] + (1 - cos a) / a² [v]²; both quotients are smooth where the angle vanishes.
    first, second = torch.sinc(angle / math.pi), torch.sinc(angle / (2 * math.pi)).square() / 2
    result: Tensor = first * cross + second * (cross @ cross)
    torch.diagonal(result, dim1=-2, dim2=-1).add_(1)
    return result


def turns_of_axes(device: str) -> Tensor:
    """Return the 24 rotations (24, 3, 3) that bring three axes at right angles onto themselves."""
    signs = torch.tensor([-1.0, 1.0])
    flips = torch.cartesian_prod(signs, signs, signs)
    orders = torch.eye(3)[torch.tensor(list(permutations(range(3))))]
    turns = (flips[:, None, :, None] * orders).flatten(0, 1)
    return turns[torch.linalg.det(turns) > 0].to(device)


@lru_cache(maxsize=6)
@torch.inference_mode(False)  # they outlive the query that asked for them first
def rotations_of(count: int, device: str) -> Tensor:
    """Return so many rotations (R, 3, 3) spread evenly over SO(3), made once. Not to be changed: many share them."""
    return uniform_rotations(count).to(device)


@lru_cache(maxsize=4)
@torch.inference_mode(False)  # they outlive the query that asked for them first
def rotations_of_axes(count: int, device: str) -> Tensor:
    """Return, of `count` rotations spread evenly over SO(3), those (K, 3, 3) that suffice for three axes at right angles: of the 24
    rotations that bring such axes onto themselves none is nearer to them than the identity."""
    rotations = uniform_rotations(count).to(device)
    # The angle of a rotation falls with its trace.
    traces = rotations.flatten(1) @ turns_of_axes(device).flatten(1).T
    return rotations[traces.amax(1) <= torch.diagonal(rotations, dim1=-2, dim2=-1).sum(-1) + 1e-6]


@lru_cache(maxsize=2)
@torch.inference_mode(False)
def rotations_by_axes(count: int, device: str) -> Tensor:
    """Return about `count` rotations (24 K, 3, 3) spread over SO(3): the K of `rotations_of_axes`, under one turn of the axes after the
    other."""
    return (turns_of_axes(device)[:, None] @ rotations_of_axes(count, device)).flatten(0, 1)


def rotation_angle(first: Tensor, second: Tensor) -> Tensor:
    """Return the angle (...) in radians between rotation matrices (..., 3, 3)."""
    trace = (first * second).sum((-1, -2))
    return torch.arccos(((trace - 1) / 2).clamp(-1, 1))


def even_directions(count: int, reach: float = math.pi) -> Tensor:
    """Return float32 unit vectors on a Fibonacci lattice of `count` over the sphere, the same for every call: those (N, 3) that lie within
    `reach`, radians, of the third axis."""
    step = torch.arange(math.ceil(count * (1 - math.cos(min(reach, math.pi))) / 2), dtype=torch.float64) + 0.5
    height = 1 - 2 * step / count
    # Of an angle within a turn single precision suffices, and takes a third of the time.
    azimuth = 2 * math.pi * ((1 + math.sqrt(5)) / 2 * step).frac_().float()
    radius = (1 - height * height).sqrt().float()
    return torch.stack((radius * azimuth.cos(), radius * azimuth.sin(), height.float()), dim=-1)
