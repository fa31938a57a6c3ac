"""Queries as the search has them, and where its candidates are."""

from collections.abc import Sequence
from functools import cache

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.query.map_query import MapQuery, prepare_queries
from panoloc.core.search.position_sweep import Candidates
from tests.core.built_maps import BOX, POSE, map_of, panorama, rig_of
from tests.core.image.painted_photos import OF_TWO, SIDEWAYS, photo_of, rig_pose

CONFIG = LocalizerConfig()
TWO_PHOTOS = OF_TWO
RIGS = {
    "panorama": (rig_of(panorama()), POSE),
    "one photo": (Rig.of_photo(photo_of(SIDEWAYS)), POSE),
    "two photos": (TWO_PHOTOS, rig_pose(TWO_PHOTOS)),
}


def query_of(
    rig: Rig, hints: Hints | None = None, index: MapIndex | None = None, config: LocalizerConfig = CONFIG
) -> MapQuery:
    """Return a query of one map, that of BOX where none is given."""
    (query,) = prepare_queries(rig, [index or map_of(BOX)], hints, config)
    return query


@cache
def query(name: str) -> MapQuery:
    """Return the query of one of the rigs in the map of BOX."""
    return query_of(RIGS[name][0])


def poses_of(found: Candidates, index: MapIndex) -> list[Pose]:
    """Return the poses of candidates, best first."""
    positions = found.positions.double().numpy() + index.origin_offset
    return [Pose(*each) for each in zip(found.rotations.double().numpy(), positions, strict=True)]


def rank_of(pose: Pose, poses: Sequence[Pose]) -> int | None:
    """Return the place of the first of some poses that is near another."""
    return next((rank for rank, each in enumerate(poses) if pose_error(each, pose).within(0.6, 15.0)), None)
