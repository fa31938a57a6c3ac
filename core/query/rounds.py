"""The rounds of search: what gravity and lines allow, and everything."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch

from panoloc.core.config import DISTANCES, SearchConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.map.aliases import aliases_in_another_map
from panoloc.core.options import PosePrior
from panoloc.core.query.map_query import MapQuery
from panoloc.core.search.map_search import search_maps
from panoloc.core.search.pose_limits import PoseLimits


@dataclass(frozen=True)
class Round:
    """One search of all maps of a query: the limits in each map, and whether only rotations are searched that lines agree with."""

    limits: list[PoseLimits]
    by_lines: bool


def rounds_of(queries: Sequence[MapQuery], config: SearchConfig) -> Iterator[Round]:
    """Yield the rounds that a query takes one after the other, until an answer is sure.

    Where a rig covers little of the sphere, first the poses that cameras held level leave, and of these the ones that lines agree with,
    where there are any to ask. What covers much of it is mostly found among all poses at once, and lines are asked where it is not.
    """
    limits, is_wide = [query.limits for query in queries], queries[0].rig.is_wide
    tilt = math.radians(config.level_tilt_deg)
    if is_wide:
        yield Round(limits, by_lines=False)
    leaves_tilts = any(limit.leaves_tilts_beyond(tilt) for limit in limits)
    has_lines = any(query.lines is not None for query in queries)
    if leaves_tilts and (has_lines or not is_wide):
        yield Round([replace(limit, max_tilt=tilt) for limit in limits], has_lines)
    if has_lines:
        yield Round(limits, by_lines=True)
    if not is_wide:
        yield Round(limits, by_lines=False)


def propose(
    queries: Sequence[MapQuery], searched: Round, config: SearchConfig
) -> tuple[list[list[Hypothesis]], int, int]:
    """Search all maps in one round. Return portions of the best poses over all maps, best first, how many starts the limits left, and how
    many poses were scored."""
    lines = [query.lines if searched.by_lines else None for query in queries]
    found, num_starts, num_poses = search_maps([query.search for query in queries], searched.limits, lines, config)
    scored: list[tuple[float, Hypothesis]] = []
    for query, some in zip(queries, found, strict=True):
        columns = some.scores.tolist(), some.starts.tolist(), some.rotations, some.positions
        for score, start, rotation, position in zip(*columns, strict=True):
            scored.append((score, Hypothesis(query.number, start, rotation, position)))
    scored.sort(key=lambda pair: -pair[0])
    best, first = [hypothesis for _, hypothesis in scored[: config.num_candidates]], config.num_candidates // 4
    return [part for part in (best[:first], best[first:]) if part], num_starts, num_poses


def poses_of_prior(query: MapQuery, prior: PosePrior) -> list[Hypothesis]:
    """Return poses of the rig where the caller expects its first camera.

    Refinement comes back from as far off as a pose is right; where the rig may be farther off, it begins beside it and turned as well.
    """
    index, rig = query.index, query.rig.pyramid
    camera = Pose.from_frame(prior.position_m, prior.quaternion_xyzw, prior.frame)
    rotation = torch.from_numpy(camera.rotation).to(index.starts) @ rig.rotations[0].T
    middle = torch.from_numpy(camera.position - index.origin_offset).to(index.starts) - rotation @ rig.centers[0]
    most = DISTANCES.elsewhere
    reach_m, turn_deg = min(prior.position_std_m, most.distance_m), min(prior.orientation_std_deg, most.angle_deg)
    moves = [(0.0, 0.0, 0.0)]
    if reach_m >= DISTANCES.right.distance_m:
        moves += [(reach_m, 0.0, 0.0), (-reach_m, 0.0, 0.0), (0.0, reach_m, 0.0), (0.0, -reach_m, 0.0)]
    if turn_deg > DISTANCES.right.angle_deg:
        moves += [(0.0, 0.0, math.radians(turn_deg)), (0.0, 0.0, -math.radians(turn_deg))]
    steps = torch.tensor(moves, device=middle.device)
    places = middle + torch.nn.functional.pad(steps[:, :2], (0, 1))
    turned = rotation_from_vector(torch.nn.functional.pad(steps[:, 2:], (2, 0))) @ rotation
    starts = (index.starts - places[:, None]).norm(dim=-1).argmin(1).tolist()
    poses = [Hypothesis(query.number, *each) for each in zip(starts, turned, places, strict=True)]
    return [pose for pose in poses if query.allows(pose)]


def aliases_of_pose(queries: Sequence[MapQuery], found: Hypothesis) -> list[Hypothesis]:
    """Return the poses from which the maps look as from one that was found: what is stored of the start beside it, and of other maps what
    looks as from there."""
    own = queries[found.map_number]
    start = int((own.index.starts - found.position).norm(dim=1).argmin())
    off = found.position - own.index.starts[start]
    poses = []
    for query in queries:
        if query is own:
            stored = own.index.aliases.take(torch.tensor([start], device=off.device))
            is_one = stored.starts[0] >= 0
            starts, turns = stored.starts[0][is_one].long(), stored.turns[0][is_one]
        elif query.rig is own.rig:
            starts, turns = aliases_in_another_map(
                own.index.views, start, query.index.views, query.index.starts, query.config.aliases
            )
        else:
            continue
        turned = rotation_from_vector(torch.nn.functional.pad(turns[:, None], (2, 0)))
        for number, turn in zip(starts.tolist(), turned, strict=True):
            pose = Hypothesis(query.number, number, turn @ found.rotation, query.index.starts[number] + turn @ off)
            if query.allows(pose):
                poses.append(pose)
    return poses
