"""Photos described as the search has them, and where its candidates are."""

import torch

from panoloc.core.camera.rig import Session
from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.map.map_index import MapIndex
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.map_search import MapCandidates

CONFIG = LocalizerConfig()


def prepared(session: Session, rows: int = 256) -> PreparedPhotos:
    return PreparedPhotos(session, rows, None, torch.device("cpu"), CONFIG)


def described(session: Session, rows: int = 256) -> DescribedPhotos:
    return prepared(session, rows).described()


def poses_of(found: MapCandidates, index: MapIndex) -> list[Pose]:
    """Return the poses of candidates, best first: each at its start."""
    rotations = found.rotations[found.candidates.rotations].double().numpy()
    positions = index.starts[found.candidates.starts].double().numpy() + index.origin_offset
    return [Pose(*each) for each in zip(rotations, positions, strict=True)]


def rank_of(pose: Pose, found: MapCandidates, index: MapIndex) -> int | None:
    """Return the place of the first candidate that is near a pose."""
    near = (rank for rank, each in enumerate(poses_of(found, index)) if pose_error(each, pose).within(0.6, 15.0))
    return next(near, None)
