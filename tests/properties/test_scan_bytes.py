"""Whatever bytes come in as a scan: a cloud or an error of `core` comes out, never anything else and never a hang."""

import contextlib
import struct
from collections.abc import Callable
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoloc.core.errors import CoreError, ScanDamagedError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import READERS
from panoloc.core.scan.reading_context import ReadingContext
from tests.core.painted_box import PaintedBox
from tests.core.scan.mesh_files import colored_quad, glb, glb_of, obj_files, zip_of
from tests.core.scan.scan_files import las_of, pcd_of, read, splat_ply, station_text, table_of

RNG = np.random.default_rng(11)
CLOUD = PointCloud(
    np.round(RNG.random((40, 3)) * 5, 3).astype(np.float32), RNG.integers(0, 256, (40, 3), dtype=np.uint8)
)


def ply_with_lists() -> bytes:
    text = "ply\nformat binary_big_endian 1.0\nelement face 6\nproperty list uchar int vertex_indices\n"
    text += "element vertex 40\nproperty list ushort short echo\nproperty double x\nproperty double y\n"
    text += "property double z\nproperty float red\nproperty float green\nproperty float blue\nend_header\n"
    data = b"".join(struct.pack(f">B{size}i", size, *range(size)) for size in (3, 4, 3, 5, 3, 4))
    for number, (position, color) in enumerate(zip(CLOUD.positions, CLOUD.colors / 255, strict=True)):
        size = number % 3
        data += struct.pack(f">H{size}h3d3f", size, *range(size), *position, *color)
    return text.encode() + data


def ply_ascii() -> bytes:
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    properties += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    return f"ply\nformat ascii 1.0\nelement vertex 40\n{properties}end_header\n{table_of(CLOUD)}\n".encode()


def e57() -> bytes:
    pye57 = pytest.importorskip("pye57")
    names = ("cartesianX", "cartesianY", "cartesianZ", "colorRed", "colorGreen", "colorBlue")
    columns = [*CLOUD.positions.T.astype(float), *CLOUD.colors.T]
    with TemporaryDirectory() as folder:
        file = pye57.E57(f"{folder}/scan.e57", mode="w")
        file.write_scan_raw(dict(zip(names, columns, strict=True)))
        file.close()
        return Path(folder, "scan.e57").read_bytes()


MAKERS: dict[str, Callable[[], bytes]] = {
    "binary.ply": lambda: encode_ply(CLOUD),
    "ascii.ply": ply_ascii,
    "lists.ply": ply_with_lists,
    "splats.ply": lambda: splat_ply(CLOUD, np.full(40, 0.9)),
    "binary.pcd": lambda: pcd_of(CLOUD),
    "compressed.pcd": lambda: pcd_of(CLOUD, "binary_compressed"),
    "scan.xyz": lambda: table_of(CLOUD).encode(),
    "scan.pts": lambda: b"40\n" + table_of(CLOUD).encode(),
    "scan.ptx": lambda: station_text(CLOUD.positions.astype(np.float64), CLOUD.colors, np.eye(3), np.ones(3)).encode(),
    "scans.zip": lambda: zip_of({"a.ply": encode_ply(CLOUD), "b/c.xyz": b"0 0 0 1 2 3\n1 1 1 4 5 6\n"}),
    "old.laz": lambda: las_of(CLOUD, 3),
    "layered.laz": lambda: las_of(CLOUD, 7),
    "scan.e57": e57,
}
STARTS = {"scan.ply": b"ply\n", "scan.pcd": b"# .PCD v0.7\n", "scan.xyz": b"", "scan": b""}
# Each reading of these starts a process, so that they get fewer examples.
IN_A_BOX = ("old.laz", "layered.laz", "scan.e57")
BEFORE_A_BOX = sorted({*MAKERS} - {*IN_A_BOX})
# Read without their box, where an error of another kind would only be called a crash.
MESHES: dict[str, Callable[[], bytes]] = {
    "plain.glb": lambda: glb(*colored_quad()),
    "painted.glb": lambda: glb_of(PaintedBox()),
    "painted.obj": lambda: obj_files(PaintedBox())["room.obj"].replace(b"mtllib", b"#"),
}
changes = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8)
reaches = st.sampled_from((40, 400, 4000, 10**6, -200, -1000))


def changed(data: bytes, edits: list[tuple[float, int]], reach: int) -> bytes:
    """Overwrite bytes at shares of the first or, with a negative reach, the last bytes."""
    damaged = bytearray(data)
    size = min(abs(reach), len(data))
    first = 0 if reach > 0 else len(data) - size
    for place, value in edits:
        damaged[first + int(place * size)] = value
    return bytes(damaged)


@pytest.fixture(scope="module")
def intact() -> dict[str, bytes]:
    return {name: make() for name, make in (MAKERS | MESHES).items()}


@pytest.mark.parametrize("name", MAKERS)
def test_the_files_are_good_before_they_are_damaged(intact: dict[str, bytes], name: str) -> None:
    assert len(read(name, intact[name])) >= 40


@pytest.mark.slow
@pytest.mark.parametrize(("names", "count"), [(IN_A_BOX, 6), (BEFORE_A_BOX, 60)], ids=["in a box", "before"])
def test_a_cut_file_is_never_read_as_a_whole_one(intact: dict[str, bytes], names: list[str], count: int) -> None:
    @settings(max_examples=count)
    @given(name=st.sampled_from([name for name in names if name != "scan.xyz"]), share=st.floats(0, 0.97))
    def check(name: str, share: float) -> None:
        with pytest.raises(CoreError):
            read(name, intact[name][: int(share * len(intact[name]))], max_points_used=500)

    check()


@pytest.mark.slow
@pytest.mark.parametrize(("names", "count"), [(IN_A_BOX, 12), (BEFORE_A_BOX, 150)], ids=["in a box", "before"])
def test_changed_bytes_give_a_cloud_or_a_core_error(intact: dict[str, bytes], names: list[str], count: int) -> None:
    @settings(max_examples=count)
    @given(name=st.sampled_from(names), edits=changes, reach=reaches)
    def check(name: str, edits: list[tuple[float, int]], reach: int) -> None:
        assert len(said_of(name, changed(intact[name], edits, reach))) > 5

    check()


def said_of(name: str, data: bytes) -> str:
    """Return what is said of a damaged file, nothing of a cloud that is none."""
    try:
        cloud = read(name, data, max_points_used=500)
    except CoreError as error:
        return str(error)
    return "a whole cloud" if 0 < len(cloud) <= 500 and np.isfinite(cloud.positions).all() else ""


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(name=st.sampled_from(sorted(MESHES)), edits=changes, reach=reaches)
def test_a_damaged_mesh_is_refused_or_still_a_mesh(
    intact: dict[str, bytes], name: str, edits: list[tuple[float, int]], reach: int
) -> None:
    kind = "gltf" if name.endswith("glb") else "obj"
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(changed(intact[name], edits, reach))
        context = ReadingContext(path, ScanOptions(max_points=100_000, max_points_used=500), path.stat().st_size)
        with contextlib.suppress(ScanError):
            for _ in READERS[kind](context):
                pass


@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [*((name, 12) for name in STARTS), ("scan.laz", 6)])
def test_random_bytes_are_refused(name: str, count: int) -> None:
    @settings(max_examples=count)
    @given(data=st.binary(max_size=300))
    def check(data: bytes) -> None:
        with pytest.raises(CoreError):
            read(name, STARTS.get(name, b"LASF") + b"\x00" + data)

    check()


PROPERTY_TYPES = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double"]
CODES = dict(zip(PROPERTY_TYPES, ["i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"], strict=True))


@settings(max_examples=60, deadline=None)
@given(
    extras=st.lists(st.sampled_from(PROPERTY_TYPES), max_size=6),
    coordinate=st.sampled_from(["float", "double"]),
    color=st.sampled_from(["uchar", "float", "double", "int"]),
    order=st.randoms(use_true_random=False),
    big_endian=st.booleans(),
)
def test_any_order_of_any_properties_reads_back(
    extras: list[str], coordinate: str, color: str, order: Random, big_endian: bool
) -> None:
    properties = [(axis, coordinate) for axis in "xyz"] + [(name, color) for name in ("red", "green", "blue")]
    properties += [(f"extra_{number}", kind) for number, kind in enumerate(extras)]
    order.shuffle(properties)
    sign = ">" if big_endian else "<"
    table = np.zeros(40, [(name, sign + CODES[kind]) for name, kind in properties])
    for axis, (position, channel) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        table[position], table[channel] = CLOUD.positions[:, axis], CLOUD.colors[:, axis]
    encoding = "binary_big_endian" if big_endian else "binary_little_endian"
    lines = [
        f"ply\nformat {encoding} 1.0\nelement vertex 40",
        *(f"property {kind} {name}" for name, kind in properties),
    ]
    data = "\n".join([*lines, "end_header\n"]).encode() + table.tobytes()
    cloud = read("scan.ply", data)
    np.testing.assert_array_equal(cloud.positions, CLOUD.positions)
    np.testing.assert_array_equal(cloud.colors, CLOUD.colors)
    with pytest.raises(ScanDamagedError):
        read("scan.ply", data[:-1])
