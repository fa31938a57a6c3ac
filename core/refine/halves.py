"""Whether halves of a picture, refined apart, meet at one pose.

At the right pose all parts of a picture say the same, however little some of them still agree. At a wrong one what fits does so by chance,
and each half alone fits better elsewhere: by decimetres and degrees in rooms as bare as they come, where all other signs may be taken in
(docs/confidence.md).
"""

import math
from dataclasses import replace

import torch
from torch import Tensor

from panoloc.core.config import RefinementConfig
from panoloc.core.geometry.rotations import rotation_angle
from panoloc.core.image.level import Level
from panoloc.core.refine.patches import on_black_squares
from panoloc.core.refine.refinement import refine
from panoloc.core.refine.step import PointPlanes

NOWHERE = 10.0, math.pi  # metres and radians: how far off poses are of which nothing is known


def halves_apart(
    level: Level,
    points: PointPlanes,
    rotation: Tensor,
    position: Tensor,
    log_focals: Tensor | None,
    square_deg: float,
    config: RefinementConfig,
) -> Tensor:
    """Return how far apart (2,), metres and radians, the poses are that the two halves of a picture lead to from one pose.

    The halves are the black and the white squares of a chessboard on the sphere. points: of that one pose. rotation: (3, 3)
    map_from_camera; position: (3,) metres.
    """
    directions = torch.nn.functional.normalize((points.positions[0].T - position) @ rotation, dim=-1)
    is_black = on_black_squares(directions, square_deg)
    weights = points.weights[0] * torch.stack((is_black, ~is_black))
    both = replace(points.take(torch.zeros(2, dtype=torch.long, device=weights.device)), weights=weights)
    focals = None if log_focals is None else log_focals.expand(2)
    found = refine(
        level,
        both,
        rotation.expand(2, 3, 3),
        position.expand(2, 3),
        config.iterations,
        config.step,
        log_focals=focals,
    )
    distance = (found.positions[0] - found.positions[1]).norm()
    angle = rotation_angle(found.rotations[0], found.rotations[1])
    # Halves in which nothing agrees stay where they are, which is no agreement.
    is_blind = (found.hessian.diagonal(dim1=1, dim2=2).sum(-1) <= 0).any()
    return torch.stack((torch.where(is_blind, NOWHERE[0], distance), torch.where(is_blind, NOWHERE[1], angle)))
