"""`python -m panoloc.lab.evaluation.fit_changes FOLDER`: fit the network that tells what came and went (`panoloc.core.changes.network`).

Makes procedural rooms with known changes, keeps what is said of their voxels in FOLDER, and fits for a number of steps, from the beginning
or from weights of earlier fits. With a thread of one processor (OMP_NUM_THREADS=1) 20 minutes for rooms, of which several processes can
each make a part beforehand, and 40 for 7,200 steps; 6 GB of disk and memory. Seeds from 10,000 are for this alone; `python -m
tests.campaign changes` measures on others.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.evidence import photo_evidence
from panoloc.core.changes.network import CELL, MULTIPLE, OUTPUTS, WEIGHTS, VoxelNetwork, fitted_network, write_weights
from panoloc.core.changes.voxels import COLOR_FEATURES, VoxelGrid, voxel_features
from panoloc.core.geometry.pose import Pose
from panoloc.core.render.render_cloud import make_render_cloud, point_spacing
from panoloc.lab.rooms.capture.change_truth import ChangedObject
from panoloc.lab.rooms.capture.shooting import rotation_of
from panoloc.lab.rooms.changed_rooms import make_changed_room

_FIRST_SEED = 10_000
_CROP = (64, 64, 32)
_BATCH = 3
_RATE = 3e-3
_POSE_NOISE = 0.01, 0.15  # metres and degrees, as poses are found
_LEAST_SR, _LEAST_POINTS = 0.002, 40  # of what counts; what is hidden counts neither way
_AT_M, _NEAR_M = 0.175, 0.1  # from a middle: cells so near are at it, and how quickly others count as far
_IGNORED_FROM = 0.1
_LEAST_M = 0.02  # side of a box

Sample = tuple[NDArray[np.float16], NDArray[np.float16]]


def main(arguments: Sequence[str]) -> int:
    """Make the rooms that are missing, fit, and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rooms", type=int, default=800)
    parser.add_argument("--steps", type=int, default=7200)
    parser.add_argument(
        "--begin",
        type=Path,
        nargs="+",
        help="weights of earlier fits, whose mean it begins with; by default random ones",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the crops that it is fitted to")
    parser.add_argument(
        "--weights", type=Path, default=WEIGHTS, help="where to write them; those of the package by default"
    )
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed in range(_FIRST_SEED, _FIRST_SEED + given.rooms):
        path = given.folder / f"{seed}.npz"
        if not path.exists():
            features, targets = described_room(seed)
            np.savez(path, features=features, targets=targets)
    network = _unfitted() if given.begin is None else mean_network(given.begin)
    if given.steps > 0:
        fit(network, sorted(given.folder.glob("*.npz")), given.steps, given.seed)
    write_weights(network, given.weights)
    return 0


def described_room(seed: int) -> Sample:
    """Return features (C, X, Y, Z) of a room, and what the network is to say (2, OUTPUTS, X / CELL, ...): of what went, and what came."""
    rng = np.random.default_rng((seed, 98))
    num_photos = int(rng.choice((1, 2, 3, 4), p=(0.15, 0.2, 0.5, 0.15)))
    room = make_changed_room(
        seed, num_photos, width=512, any_look=bool(rng.random() < 0.5), imperfect=bool(rng.random() < 0.2)
    )
    points, colors = torch.from_numpy(room.cloud.positions), torch.from_numpy(room.cloud.colors).float() / 255
    cloud = make_render_cloud(points, colors, point_spacing(points))
    metres, degrees = _POSE_NOISE
    poses = [
        Pose(
            rotation_of(rng.normal(0, np.radians(degrees), 3)) @ pose.rotation, pose.position + rng.normal(0, metres, 3)
        )
        for pose in room.poses
    ]
    seen = [photo_evidence(cloud, *each) for each in zip(room.panoramas, poses, strict=True)]
    low, high = (
        np.asarray(np.quantile(room.cloud.positions, q, axis=0) + margin, np.float64)
        for q, margin in ((0.0005, -0.15), (0.9995, 0.15))
    )
    x, y, z = (MULTIPLE * max(1, math.ceil(extent / CHANGES.voxel_m / MULTIPLE)) for extent in high - low)
    grid = VoxelGrid(low, (x, y, z), CHANGES.voxel_m)
    features = voxel_features(grid, room.cloud.positions, colors.numpy(), seen).numpy()
    return features.astype(np.float16), targets(grid, room.objects).astype(np.float16)


def targets(grid: VoxelGrid, objects: Sequence[ChangedObject]) -> NDArray[np.float32]:
    """Return (2, OUTPUTS, x, y, z) of the cells of a grid.

    In the place of logits: how near the next middle is, 1 at it, and 1 in what belongs to an object; -1 for what counts neither way.
    """
    x, y, z = (count // CELL for count in grid.shape)
    cells = VoxelGrid(grid.low, (x, y, z), CELL * grid.side)
    found = np.zeros((2, OUTPUTS, *cells.shape), np.float32)
    near = np.zeros((2, *cells.shape), np.float32)
    centers = cells.centers().numpy().reshape(*cells.shape, 3)
    # Smaller ones cover larger ones.
    for each in sorted(objects, key=lambda one: -float(np.prod(one.high - one.low + 0.1))):
        inside = np.zeros(cells.shape, np.bool_)
        inside.ravel()[cells.numbers(each.points)[0]] = True
        way = each.center.astype(np.float32) - centers
        distance = np.linalg.norm(way, axis=-1)
        row, counts = int(each.is_new), _counts(each)
        found[row, 1][_filled(inside)] = 1 if counts else -1
        here = np.exp(-0.5 * (np.maximum(distance - _AT_M, 0) / _NEAR_M) ** 2)
        mine = here > near[row]
        near[row][mine] = here[mine]
        found[row, 0][mine] = here[mine] if counts else -1.0 * (here[mine] > _IGNORED_FROM)
        found[row, 2:5, mine] = way[mine]
        found[row, 5:, mine] = np.log(np.maximum(each.high - each.low, _LEAST_M))
    return found


def _counts(thing: ChangedObject) -> bool:
    shown = thing.seen_sr >= _LEAST_SR and (thing.is_new or thing.num_points >= _LEAST_POINTS)
    return shown and thing.largest_side_m > CHANGES.least_side_m


def _filled(shell: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the voxels between those of a shell, along each of the three axes."""
    inside = np.ones_like(shell)
    for axis in range(3):
        before, after = (
            np.maximum.accumulate(shell, axis),
            np.flip(np.maximum.accumulate(np.flip(shell, axis), axis), axis),
        )
        inside &= before & after
    return inside


def fit(network: VoxelNetwork, paths: Sequence[Path], steps: int, seed: int) -> None:
    """Fit a network on rooms, whose crops are drawn by the seed."""
    rng = np.random.default_rng(seed)
    rooms = [_read(path) for path in paths]
    nn.Module.to(network, memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
    network.train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, _RATE, steps, pct_start=0.1)
    for step in range(1, steps + 1):
        batch = [_crop(rooms[int(rng.integers(len(rooms)))], rng) for _ in range(_BATCH)]
        features, wanted = (torch.from_numpy(np.stack(part)) for part in zip(*batch, strict=True))
        with torch.autocast("cpu", torch.bfloat16):
            said = network(features.to(memory_format=torch.channels_last_3d))
        loss = _loss(said.float(), wanted)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimizer.step()
        schedule.step()
        if step % 100 == 0:
            print(step, f"{loss.item():.3f}", flush=True)
    network.eval()


def mean_network(paths: Sequence[Path]) -> VoxelNetwork:
    """Return the network with the mean of some weights: that of the ends of several fits finds more than each (arXiv:1803.05407)."""
    states = [fitted_network(path).state_dict() for path in paths]
    network = fitted_network(paths[0])
    network.load_state_dict({name: sum(state[name] for state in states) / len(states) for name in states[0]})
    return network


def _unfitted() -> VoxelNetwork:
    torch.manual_seed(0)
    network = VoxelNetwork()
    for module in network.modules():
        if isinstance(module, nn.Conv3d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
    nn.init.normal_(network.last.weight, std=0.02)
    bias = torch.zeros(2, OUTPUTS)
    bias[:, :2] = torch.tensor((-4.0, -3.0))  # nearly no cell has a middle, or belongs to a change
    network.last.bias = nn.Parameter(bias.flatten())
    return network


def _loss(said: Tensor, wanted: Tensor) -> Tensor:
    """Return the focal loss of middles (as of CenterNet, arXiv:1904.07850), and those of what belongs to objects and of their boxes."""
    near, inside = wanted[:, :, 0], wanted[:, :, 1]
    at, counts = (near == 1).float(), near.clamp_min(0)
    logits = said[:, :, 0]
    there = logits.sigmoid()
    missed = at * (1 - there).square() * nn.functional.logsigmoid(logits)
    made_up = (near >= 0) * (1 - counts) ** 4 * there.square() * nn.functional.logsigmoid(-logits)
    middles = -(missed + made_up).sum() / at.sum().clamp_min(20)
    unsure = nn.functional.binary_cross_entropy_with_logits(said[:, :, 1], inside.clamp_min(0), reduction="none")
    off = nn.functional.smooth_l1_loss(said[:, :, 2:], wanted[:, :, 2:], reduction="none", beta=0.1).sum(2)
    boxes = (off * counts**2).sum() / (counts**2).sum().clamp_min(20)
    return middles + 10 * (unsure * (inside >= 0)).mean() + 0.3 * boxes


def _read(path: Path) -> Sample:
    with np.load(path) as stored:
        return stored["features"], stored["targets"]


def _crop(room: Sample, rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a part of a room, turned by quarters, mirrored, with its colours in another order."""
    features, wanted = room
    spare = [max(0, count - size) // CELL for count, size in zip(features.shape[1:], _CROP, strict=True)]
    first = [int(rng.integers(count + 1)) for count in spare]
    part = _padded(features, [CELL * start for start in first], _CROP)
    goal = _padded(wanted, first, [size // CELL for size in _CROP])
    for _ in range(int(rng.integers(4))):
        part, goal = np.rot90(part, 1, (-3, -2)), np.rot90(goal, 1, (-3, -2))[:, [0, 1, 3, 2, 4, 6, 5, 7]].copy()
        goal[:, 2] *= -1
    if rng.random() < 0.5:
        part, goal = part[..., ::-1, :, :], goal[..., ::-1, :, :].copy()
        goal[:, 2] *= -1
    part = part.copy()
    order = rng.permutation(3)
    for start in (COLOR_FEATURES.start, COLOR_FEATURES.start + 3):
        part[start : start + 3] = part[start : start + 3][order]
    return part, goal


def _padded(planes: NDArray[np.float16], first: Sequence[int], size: Sequence[int]) -> NDArray[np.float32]:
    """Return a part of planes (..., X, Y, Z), with zeros where they end."""
    x, y, z = (slice(start, start + count) for start, count in zip(first, size, strict=True))
    part = planes[..., x, y, z]
    missing = [(0, count - have) for have, count in zip(part.shape[-3:], size, strict=True)]
    return np.pad(part.astype(np.float32), [*[(0, 0)] * (part.ndim - 3), *missing])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
