"""`python -m panoloc.lab.evaluation.fit_changes FOLDER`: fit the network that tells what came and went (`panoloc.core.changes.network`).

Makes procedural rooms with known changes, keeps what is said of their voxels in FOLDER, and fits for the minutes that are allowed. Half an
hour on two processors. Seeds from 10,000 are for this alone; `python -m tests.campaign changes` measures on others.

The weights in the package come from an earlier form of this script, which made rooms while it fitted (198 at first, 231 in the end), took
3,300 steps, drew other noise of poses, and filled objects with scipy's `binary_fill_holes`; docs/evaluation.md compares both.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from panoloc.core.changes.evidence import photo_evidence
from panoloc.core.changes.network import WEIGHTS, VoxelNetwork, write_weights
from panoloc.core.changes.voxels import COLOR_FEATURES, VoxelGrid, voxel_features
from panoloc.core.geometry.pose import Pose
from panoloc.core.render.render_cloud import make_render_cloud, point_spacing
from panoloc.lab.rooms.capture.changed_objects import ChangedObject
from panoloc.lab.rooms.capture.shooting import rotation_of
from panoloc.lab.rooms.changed_rooms import make_changed_room

_FIRST_SEED = 10_000
_CROP = (40, 40, 32)
_BATCH = 3
_RATE = 3e-3
_POSE_NOISE = 0.01, 0.15  # metres and degrees, as poses are found
_LEAST_SR, _LEAST_POINTS = 0.002, 40  # of what counts; what is hidden counts neither way
_IGNORED = 2

Sample = tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]


def main(arguments: Sequence[str]) -> int:
    """Make the rooms that are missing, fit, and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rooms", type=int, default=300)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument(
        "--weights", type=Path, default=WEIGHTS, help="where to write them; those of the package by default"
    )
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    for seed in range(_FIRST_SEED, _FIRST_SEED + given.rooms):
        path = given.folder / f"{seed}.npz"
        if not path.exists():
            features, labels, ways = described_room(seed)
            np.savez(path, f=features.astype(np.float16), l=labels, o=ways.astype(np.float16))
    write_weights(fitted(sorted(given.folder.glob("*.npz")), given.minutes), given.weights)
    return 0


def described_room(seed: int) -> Sample:
    """Return features (C, X, Y, Z), labels (2, X, Y, Z) and ways to the middle (2, 3, X, Y, Z) of a room: of what went, and what came."""
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
    low, high = (np.quantile(room.cloud.positions, q, axis=0) for q in (0.0005, 0.9995))
    grid = VoxelGrid.around(low - 0.15, high + 0.15)
    features = voxel_features(grid, room.cloud.positions, colors.numpy(), seen).numpy()
    return (features, *_labels(grid, room.objects))


def _labels(grid: VoxelGrid, objects: Sequence[ChangedObject]) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return which voxels belong to what went and came, and the way from each to the middle; smaller things cover larger ones."""
    labels, ways = np.zeros((2, *grid.shape), np.uint8), np.zeros((2, 3, *grid.shape), np.float32)
    centers = grid.centers().numpy().reshape(*grid.shape, 3)
    for each in sorted(objects, key=lambda one: -float(np.prod(one.high - one.low + 0.1))):
        inside = np.zeros(grid.shape, np.bool_)
        inside.ravel()[grid.numbers(each.points)[0]] = True
        inside = _filled(inside)
        row, shown = int(each.is_new), each.seen_sr >= _LEAST_SR and (each.is_new or each.num_points >= _LEAST_POINTS)
        labels[row][inside] = 1 if shown else _IGNORED
        ways[row][:, inside] = (each.center - centers[inside]).T
    return labels, ways


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


def fitted(paths: Sequence[Path], minutes: float) -> VoxelNetwork:
    """Return the network fitted on rooms."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    rooms = [_read(path) for path in paths]
    network = VoxelNetwork()
    nn.Module.to(network, memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
    for module in network.modules():
        if isinstance(module, nn.Conv3d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
    nn.init.normal_(network.last.weight, std=0.02)
    bias = torch.zeros(len(network.last.weight))
    bias[[0, 4]] = -3.0  # logits: nearly no voxel belongs to a change
    network.last.bias = nn.Parameter(bias)
    optimizer = torch.optim.AdamW(network.parameters(), lr=_RATE, weight_decay=1e-4)
    began, share, step = time.monotonic(), 0.0, 0
    while share < 1:
        share = (time.monotonic() - began) / (60 * minutes)
        for group in optimizer.param_groups:
            group["lr"] = _RATE * min(1, (step + 1) / 100) * (0.01 + 0.5 + 0.5 * np.cos(np.pi * min(1.0, share)))
        batch = [_crop(rooms[int(rng.integers(len(rooms)))], rng) for _ in range(_BATCH)]
        features, labels, ways = (torch.from_numpy(np.stack(part)) for part in zip(*batch, strict=True))
        with torch.autocast("cpu", torch.bfloat16):
            said = network(features.to(memory_format=torch.channels_last_3d))
        loss = _loss(said.float(), labels, ways)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        step += 1
        if step % 250 == 0:
            print(step, f"{loss.item():.3f}", flush=True)
    network.eval()
    return network


def _loss(said: Tensor, labels: Tensor, ways: Tensor) -> Tensor:
    counts, inside = (labels != _IGNORED).float(), labels == 1
    unsure = nn.functional.binary_cross_entropy_with_logits(said[:, :, 0], inside.float(), reduction="none")
    off = nn.functional.smooth_l1_loss(said[:, :, 1:], ways, reduction="none", beta=0.1).sum(2)
    return 20 * (unsure * counts).sum() / counts.sum() + (off * inside).sum() / inside.sum().clamp_min(50)


def _read(path: Path) -> Sample:
    with np.load(path) as stored:
        return stored["f"], stored["l"], stored["o"]


def _crop(room: Sample, rng: np.random.Generator) -> Sample:
    """Return a part of a room, turned by quarters, mirrored, with its colours in another order."""
    features, labels, ways = room
    shape = labels.shape[1:]
    first = [int(rng.integers(0, max(1, count - size + 1))) for count, size in zip(shape, _CROP, strict=True)]
    part = tuple(slice(start, start + size) for start, size in zip(first, _CROP, strict=True))
    missing = [(0, max(0, size - count)) for count, size in zip(shape, _CROP, strict=True)]
    features = np.pad(features[(slice(None), *part)].astype(np.float32), [(0, 0), *missing])
    labels = np.pad(labels[(slice(None), *part)], [(0, 0), *missing])
    ways = np.pad(ways[(slice(None), slice(None), *part)].astype(np.float32), [(0, 0), (0, 0), *missing])
    for _ in range(int(rng.integers(4))):
        features, labels = np.rot90(features, 1, (-3, -2)), np.rot90(labels, 1, (-3, -2))
        ways = np.rot90(ways, 1, (-3, -2))
        ways = np.stack((-ways[:, 1], ways[:, 0], ways[:, 2]), axis=1)
    if rng.random() < 0.5:
        features, labels = features[..., ::-1, :, :], labels[..., ::-1, :, :]
        ways = ways[..., ::-1, :, :] * np.array((-1, 1, 1), np.float32)[:, None, None, None]
    features = features.copy()
    order = rng.permutation(3)
    first_color = COLOR_FEATURES.start
    for start in (first_color, first_color + 3):
        features[start : start + 3] = features[start : start + 3][order]
    return features, labels.copy(), ways.copy()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
