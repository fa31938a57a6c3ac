"""Whatever bytes come in as a scan of many parts, only errors of `core` come out."""

import contextlib
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoloc.core.errors import CoreError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import READERS
from panoloc.core.scan.reading import read_scan
from panoloc.core.scan.reading_context import ReadingContext
from tests.core.painted_box import PaintedBox
from tests.core.scan.mesh_files import colored_quad, glb, glb_of, obj_files, zip_of
from tests.core.scan.ptx_files import station_text
from tests.core.scan.splat_files import splat_ply

CLOUD = PaintedBox(size_m=(2.0, 2.0, 2.0)).scan(40)
HALF = PointCloud(CLOUD.positions[:20], CLOUD.colors[:20])
OBJ = obj_files(PaintedBox())["room.obj"]
# Read without their box, where an error of another kind would only be called a crash.
APART = {"gltf": (glb(*colored_quad()), glb_of(PaintedBox())), "obj": (OBJ.replace(b"mtllib", b"#"),)}
HERE = {
    "ptx": station_text(CLOUD.positions.astype(np.float64), CLOUD.colors, np.eye(3), np.ones(3)).encode(),
    "splats": splat_ply(CLOUD, np.full(40, 0.9)),
    "zip": zip_of({"a.ply": encode_ply(HALF), "b/c.xyz": b"0 0 0 1 2 3\n1 1 1 4 5 6\n"}),
}
changes = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8)
FEW = ScanOptions(max_points=100_000, max_points_used=500)


def changed(data: bytes, edits: list[tuple[float, int]], reach: int) -> bytes:
    """Overwrite bytes at shares of the first or, with a negative reach, the last bytes."""
    damaged = bytearray(data)
    size = min(abs(reach), len(data))
    first = 0 if reach > 0 else len(data) - size
    for place, value in edits:
        damaged[first + int(place * size)] = value
    return bytes(damaged)


reaches = st.sampled_from((40, 400, 4000, 10**6, -200, -1000))


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(HERE)), changes, reaches)
def test_a_damaged_scan_is_refused_or_still_a_scan(kind: str, edits: list[tuple[float, int]], reach: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan"
        path.write_bytes(changed(HERE[kind], edits, reach))
        with contextlib.suppress(CoreError):
            read_scan(path, FEW)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.sampled_from(sorted(HERE)), st.floats(0, 1, exclude_max=True))
def test_a_scan_cut_short_is_refused_or_still_a_scan(kind: str, share: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan"
        path.write_bytes(HERE[kind][: int(share * len(HERE[kind]))])
        with contextlib.suppress(CoreError):
            read_scan(path, FEW)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.sampled_from(sorted(APART)), st.integers(0, 1), changes, reaches)
def test_a_damaged_mesh_is_refused_or_still_a_mesh(
    kind: str, number: int, edits: list[tuple[float, int]], reach: int
) -> None:
    files = APART[kind]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan"
        path.write_bytes(changed(files[number % len(files)], edits, reach))
        context = ReadingContext(path, FEW, path.stat().st_size)
        with contextlib.suppress(ScanError):
            for _ in READERS[kind](context):
                pass
