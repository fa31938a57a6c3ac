"""Painted boxes with their maps, and answers to queries in them; maps are built once, whichever tests ask for them."""

import hashlib
import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from panoloc.core.camera.rig import Panorama, Photo, Rig
from panoloc.core.geometry.pose import Pose
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import IndexOptions
from panoloc.core.results import Localization
from tests.core.painted_box import PaintedBox, rotation_of

BOX = PaintedBox(seed=3)
OTHER_BOX = PaintedBox(seed=44, size_m=(4.2, 4.6, 2.5))
LABELLED = PaintedBox(seed=1, palette=((0, 0, 0), (255, 0, 0), (0, 128, 255), (90, 90, 90), (20, 200, 60)))
AS_LABELS = IndexOptions(color_kind="labels", spacing_m=0.8)
_PLAIN = IndexOptions()
# A seventh of the starts, which is enough to find what is asked for in a box.
COARSE = IndexOptions(spacing_m=1.0)
# A camera that is nearly level, off the middle of the box.
POSE = Pose(rotation_of(130.0, 8.0, -5.0), np.array([1.7, 2.4, 1.5]))

# It looks the same after half a turn.
SYMMETRIC = PaintedBox(seed=3, symmetric=True)


def seen_from_the_other_side(pose: Pose) -> Pose:
    """Return the pose that sees the same as this one from the other side of the symmetric box."""
    half_turn, middle = rotation_of(180.0), np.array([*SYMMETRIC.size_m[:2], 0.0]) / 2
    return Pose(half_turn @ pose.rotation, half_turn @ (pose.position - middle) + middle)


TWIN = seen_from_the_other_side(POSE)


@cache
def map_of(box: PaintedBox, options: IndexOptions = _PLAIN) -> MapIndex:
    """Return the map of a box, with which no test may tamper; processes that share the tests have it from the first that builds it."""
    folder = os.environ.get("MAPS_OF_TESTS")
    if folder is None:
        return build_map_index(box.scan(), options)
    file = Path(folder, hashlib.sha256(repr((box, options)).encode()).hexdigest())
    if not file.exists():
        unfinished = file.with_suffix(f".{os.getpid()}")
        torch.save(build_map_index(box.scan(), options), unfinished)
        unfinished.rename(file)
    index: MapIndex = torch.load(file, weights_only=False)
    return index


def tensors_of(pose: Pose) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the rotation (1, 3, 3) and the position (1, 3) of a pose."""
    return torch.from_numpy(pose.rotation).float()[None], torch.from_numpy(pose.position).float()[None]


@cache
def localizer() -> Localizer:
    return Localizer(device="cpu")


@cache
def panorama() -> Panorama:
    """Return the panorama of BOX from POSE."""
    return BOX.panorama(POSE)


def rig_of(query: Panorama | Photo | Rig) -> Rig:
    """Return the rig of a query, of one image or of several."""
    if isinstance(query, Panorama):
        return Rig.of_panorama(query)
    return Rig.of_photo(query) if isinstance(query, Photo) else query


def localized(query: Panorama | Photo | Rig, *maps: PaintedBox | MapIndex, **options: Any) -> Localization:
    """Return the answer to a query in maps, of boxes with few starts, or in that of BOX."""
    indexes = [map_of(each, COARSE) if isinstance(each, PaintedBox) else each for each in maps or (BOX,)]
    return localizer().localize(rig_of(query), indexes, **options)


@cache
def answer() -> Localization:
    """Return the answer to the panorama of BOX."""
    return localized(panorama())
