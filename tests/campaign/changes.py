"""Rooms of which 60 % of furniture, rugs and pictures changed, in three panoramas each: what is found of it, where, and what is made up."""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.evidence import photo_evidence
from panoloc.core.changes.finding import Change, DatedPhoto, find_changes
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions, project
from panoloc.core.render.render_cloud import make_render_cloud, point_spacing
from panoloc.lab.rooms.capture.change_truth import ChangedObject
from panoloc.lab.rooms.capture.shooting import rotation_of
from panoloc.lab.rooms.changed_rooms import ChangedRoom, make_changed_room
from tests.campaign.outcome import Outcome

FIRST_SEED = 7200
"""Of rooms that nothing was fitted to, nor chosen on: those that were begin at 5,000, 6,000, 7,000, 7,100 and 10,000."""

_NEAR_M, _LARGE_M = 0.3, 0.3
_SEEN_SR, _SCANNED = (
    0.004,
    50,
)  # least solid angle in the photo that shows most of an object, and points on one that went
_NOISE_M, _NOISE_DEG = 0.006, 0.1  # of found poses, each axis
_TARGET, _TARGET_AUC = 0.85, 0.95


@dataclass
class Measured:
    """Counts over rooms. placed: places that objects came to or went from, found and true; a moved object has one of each."""

    expected: int = 0
    found: int = 0
    said: int = 0
    right: int = 0
    hidden: int = 0  # large, and not seen well enough to be expected
    moved: int = 0
    moved_found: int = 0

    @property
    def recall(self) -> float:
        """Return the share of what changed that was found."""
        return self.found / max(1, self.expected)

    @property
    def precision(self) -> float:
        """Return the share of what was found that did change."""
        return self.right / max(1, self.said)


def changes(num_rooms: int, first_seed: int = FIRST_SEED) -> Outcome:
    """Measure rooms. Recall and precision of what is stated, or an area, below what is promised is a fault."""
    outcome, began, counts, sure = Outcome("changes"), time.monotonic(), Measured(), Measured()
    errors_m, areas = list[float](), list[float]()
    for seed in range(first_seed, first_seed + num_rooms):
        room = make_changed_room(seed)
        found = find_changes(room.cloud, photos_of(room, seed))
        errors_m += compare(found, room.objects, counts)
        compare([each for each in found if each.certainty >= CHANGES.sure], room.objects, sure)
        areas.append(pixel_area(room))
        print(f"room {seed}: so far recall {counts.recall:.3f}, precision {counts.precision:.3f}", file=sys.stderr)
    outcome.cases, outcome.seconds = num_rooms, time.monotonic() - began
    outcome.figures = {
        "recall": f"{counts.recall:.3f} of {counts.expected}",
        "precision": f"{counts.precision:.3f} of {counts.said}",
        "sure: recall, precision": f"{sure.recall:.3f}, {sure.precision:.3f} of {sure.said}",
        "centre off": f"{float(np.mean(errors_m or [np.nan])):.2f} m",
        "moved as moved": f"{counts.moved_found} of {counts.moved}",
        "pixel AUC": f"{np.mean(areas):.3f} ({min(areas):.3f} to {max(areas):.3f})",
        "hidden": str(counts.hidden),
    }
    figures = (
        ("recall", sure.recall, _TARGET),
        ("precision", sure.precision, _TARGET),
        ("AUC", min(areas), _TARGET_AUC),
    )
    outcome.faults = [
        f"{name}: expected {least:.2f}, got {value:.3f}" for name, value, least in figures if value < least
    ]
    return outcome


def photos_of(room: ChangedRoom, seed: int) -> list[DatedPhoto]:
    """Return the panoramas of a room with poses as they are found: with the noise of a median answer."""
    rng = np.random.default_rng((seed, 43))
    photos = []
    for panorama, pose in zip(room.panoramas, room.poses, strict=True):
        turn = rotation_of(rng.normal(0, np.radians(_NOISE_DEG), 3))
        noisy = Pose(turn @ pose.rotation, pose.position + rng.normal(0, _NOISE_M, 3))
        photos.append(DatedPhoto(panorama, noisy, datetime.now(UTC)))
    return photos


def compare(found: Sequence[Change], truth: Sequence[ChangedObject], counts: Measured) -> list[float]:
    """Add one room to the counts, and return how far centres are off, metres."""
    said = [(change.kind == "went", change.center, change) for change in found if change.kind != "moved"]
    for change in found:
        if change.from_center is not None:
            said += [(False, change.center, change), (True, change.from_center, change)]
    near = sorted(
        (float(np.linalg.norm(center - each.center)), i, j)
        for i, (has_gone, center, _) in enumerate(said)
        for j, each in enumerate(truth)
        if has_gone is not each.is_new
    )
    of_said, of_truth, errors_m = dict[int, int](), dict[int, int](), list[float]()
    for distance, i, j in near:
        if distance < _NEAR_M and i not in of_said and j not in of_truth:
            of_said[i], of_truth[j] = j, i
            errors_m.append(distance)
    large = [j for j, each in enumerate(truth) if each.largest_side_m > _LARGE_M]
    shown = [j for j in large if truth[j].seen_sr >= _SEEN_SR and (truth[j].is_new or truth[j].num_points >= _SCANNED)]
    counts.hidden += len(large) - len(shown)
    counts.expected += len(shown)
    counts.found += sum(j in of_truth for j in shown)
    counts.said += len(said)
    counts.right += len(of_said)
    again = [j for j in shown if truth[j].moved and truth[j].is_new]
    counts.moved += len(again)
    counts.moved_found += sum(j in of_truth and said[of_truth[j]][2].kind == "moved" for j in again)
    return errors_m


def pixel_area(room: ChangedRoom) -> float:
    """Return the area under the curve of true over false positives: of changed against other pixels, over all photos of a room."""
    points, colors = (np.ascontiguousarray(each) for each in (room.cloud.positions, room.cloud.colors))
    cloud = make_render_cloud(_tensor(points), _tensor(colors).float() / 255, point_spacing(_tensor(points)))
    scores, labels = [], []
    for panorama, pose, changed in zip(room.panoramas, room.poses, room.changed_pixels, strict=True):
        seen = photo_evidence(cloud, panorama, pose)
        rows = len(seen.changed)
        u, v = project(pixel_directions(rows, 2 * rows) @ _tensor(pose.rotation).float(), *changed.shape)
        is_changed = changed[
            v.long().clamp(0, len(changed) - 1).numpy(), u.long().clamp(0, changed.shape[1] - 1).numpy()
        ]
        known = seen.known.numpy()
        scores.append(seen.changed.numpy()[known])
        labels.append(is_changed[known])
    return area_under_curve(np.concatenate(scores), np.concatenate(labels))


def area_under_curve(scores: NDArray[np.float32], labels: NDArray[np.bool_]) -> float:
    """Return how probable it is that a positive (N,) has a larger score (N,) than a negative one; equal scores count half."""
    _, inverse, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2)[inverse]
    positives = int(labels.sum())
    negatives = len(labels) - positives
    return float((ranks[labels].sum() - positives * (positives + 1) / 2) / max(1, positives * negatives))


def _tensor(values: NDArray[np.generic]) -> torch.Tensor:
    return torch.from_numpy(values)
