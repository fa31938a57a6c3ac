"""A painted box as a file of every kind: registered, a panorama of it is found where it was taken."""

from collections.abc import Callable

import numpy as np
import pytest

from panoloc.core.camera.rig import Rig
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.options import IndexOptions
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.built_maps import BOX, POSE, panorama
from tests.core.found_pose import assert_found
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.scan.mesh_files import glb_of, obj_files, zip_of
from tests.core.scan.scan_files import read, splat_ply, station_text


def ptx_of(box: PaintedBox) -> bytes:
    cloud = box.scan(24_000)
    poses = (
        (rotation_of(70.0, 3.0, -2.0), np.array([1.0, 2.0, 1.6])),
        (rotation_of(-140.0), np.array([3.5, 1.5, 1.4])),
    )
    halves = zip(np.split(cloud.positions.astype(np.float64), 2), np.split(cloud.colors, 2), poses, strict=True)
    return "".join(station_text(points, colors, *pose) for points, colors, pose in halves).encode()


def splats_of(box: PaintedBox) -> bytes:
    cloud = box.scan(40_000)
    haze = np.random.default_rng(1).uniform(0, 1, len(cloud)) < 0.2
    return splat_ply(cloud, np.where(haze, 0.1, 0.97))


def two_scans_of(box: PaintedBox) -> bytes:
    """Return the scans of two halves of the box."""
    cloud = box.scan(24_000)
    is_near = cloud.positions[:, 0] < 2.5
    halves = (PointCloud(cloud.positions[chosen], cloud.colors[chosen]) for chosen in (is_near, ~is_near))
    return zip_of({f"half {number}.ply": encode_ply(half) for number, half in enumerate(halves)})


KINDS: dict[str, Callable[[PaintedBox], bytes]] = {
    "room.ptx": ptx_of,
    "room.glb": glb_of,
    "room.obj.zip": lambda box: zip_of(obj_files(box)),
    "splats.ply": splats_of,
    "scans.zip": two_scans_of,
}


@pytest.mark.slow
@pytest.mark.unwatched
@pytest.mark.parametrize("name", KINDS)
def test_a_panorama_is_found_within_five_centimetres(localizer: Localizer, name: str) -> None:
    index = build_map_index(read(name, KINDS[name](BOX)), IndexOptions(spacing_m=1.2))
    found = localizer.localize(Rig.of_panorama(panorama()), [index])
    assert_found(found, POSE, 0.05, 1.0)
    assert found.status == "localized"
