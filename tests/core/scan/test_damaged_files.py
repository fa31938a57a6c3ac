"""Whatever happens to a file on its way: a cloud or a CoreError, never anything else and never a hang."""

import struct
from collections.abc import Callable
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoloc.core.errors import CoreError, ScanDamagedError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan

OPTIONS = ScanOptions(max_points_used=500)
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


def rows() -> str:
    return "\n".join(
        " ".join(map(str, [*position, *color]))
        for position, color in zip(CLOUD.positions.tolist(), CLOUD.colors.tolist(), strict=True)
    )


def ply_ascii() -> bytes:
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    properties += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    return f"ply\nformat ascii 1.0\nelement vertex 40\n{properties}end_header\n{rows()}\n".encode()


def pcd(encoding: str) -> bytes:
    records = np.empty(40, [("p", "<f4", 3), ("c", "<u4")])
    records["p"], records["c"] = CLOUD.positions, CLOUD.colors @ np.array([65536, 256, 1])
    data = records.tobytes()
    if encoding == "binary_compressed":
        columns = np.ascontiguousarray(CLOUD.positions.T).tobytes() + records["c"].tobytes()
        packed = b"".join(b"\x1f" + columns[start : start + 32] for start in range(0, len(columns), 32))
        data = struct.pack("<II", len(packed), len(columns)) + packed
    return (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 40\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 40\nDATA {encoding}\n"
    ).encode() + data


def las(name: str, point_format: int) -> bytes:
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales = np.full(3, 0.001)
    points = laspy.LasData(header)
    points.x, points.y, points.z = CLOUD.positions.T
    points.red, points.green, points.blue = CLOUD.colors.T.astype(np.uint16) * 257
    with TemporaryDirectory() as folder:
        points.write(Path(folder) / name)
        return (Path(folder) / name).read_bytes()


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
    "binary.pcd": lambda: pcd("binary"),
    "compressed.pcd": lambda: pcd("binary_compressed"),
    "scan.xyz": lambda: rows().encode(),
    "scan.pts": lambda: b"40\n" + rows().encode(),
    "old.laz": lambda: las("scan.laz", 3),
    "layered.laz": lambda: las("scan.laz", 7),
    "scan.e57": e57,
}
CUT_IS_ALWAYS_SEEN = [name for name in MAKERS if name != "scan.xyz"]


@pytest.fixture(scope="module")
def intact() -> dict[str, bytes]:
    return {name: make() for name, make in MAKERS.items()}


@pytest.mark.parametrize("name", MAKERS)
def test_the_files_are_good_before_they_are_damaged(intact: dict[str, bytes], tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(intact[name])
    assert len(read_scan(path)) >= 40


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(name=st.sampled_from(CUT_IS_ALWAYS_SEEN), share=st.floats(0, 0.97))
def test_a_cut_file_is_never_read_as_a_whole_one(intact: dict[str, bytes], name: str, share: float) -> None:
    data = intact[name]
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(CoreError):
            read_scan(path, OPTIONS)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(
    name=st.sampled_from(sorted(MAKERS)),
    changes=st.lists(
        st.tuples(st.one_of(st.floats(0, 0.05), st.floats(0, 1)), st.integers(0, 255)), min_size=1, max_size=6
    ),
)
def test_changed_bytes_give_a_cloud_or_a_core_error(
    intact: dict[str, bytes], name: str, changes: list[tuple[float, int]]
) -> None:
    data = bytearray(intact[name])
    for share, value in changes:
        data[min(int(share * len(data)), len(data) - 1)] = value
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(data)
        try:
            cloud = read_scan(path, OPTIONS)
        except CoreError as error:
            message = str(error)
        else:
            message = (
                "" if len(cloud) > OPTIONS.max_points_used or not np.isfinite(cloud.positions).all() else "a cloud"
            )
    assert len(message) > 5


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=300), name=st.sampled_from(["scan.ply", "scan.pcd", "scan.laz", "scan.xyz", "scan"]))
def test_random_bytes_are_refused(data: bytes, name: str) -> None:
    starts = {"scan.ply": b"ply\n", "scan.pcd": b"# .PCD v0.7\n", "scan.laz": b"LASF"}
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(starts.get(name, b"") + b"\x00" + data)
        with pytest.raises(CoreError):
            read_scan(path)


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
    with TemporaryDirectory() as folder:
        path = Path(folder, "scan.ply")
        path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + table.tobytes())
        cloud = read_scan(path)
        np.testing.assert_array_equal(cloud.positions, CLOUD.positions)
        np.testing.assert_array_equal(cloud.colors, CLOUD.colors)
        path.write_bytes(path.read_bytes()[:-1])
        with pytest.raises(ScanDamagedError):
            read_scan(path)
