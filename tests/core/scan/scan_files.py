"""A small coloured cloud, files of it in every format, written by hand or by foreign libraries, and how they are read."""

import io
import struct
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import laspy
import numpy as np
from numpy.typing import NDArray

from panoloc.core.options import ScanOptions
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan

Array = NDArray[np.float64]
NUM_POINTS = 60


def _cloud() -> PointCloud:
    rng = np.random.default_rng(7)
    positions = np.round(rng.random((NUM_POINTS, 3)) * [4, 3, 2.5], 3).astype(np.float32)
    colors = rng.integers(0, 256, (NUM_POINTS, 3), dtype=np.uint8)
    colors[:2] = [[0, 0, 0], [255, 255, 255]]
    return PointCloud(positions, colors, num_points_read=NUM_POINTS)


CLOUD = _cloud()
"""Points of a 4 x 3 x 2.5 m room whose coordinates survive three decimals, with colours of the whole range."""


def put(folder: Path, name: str, content: bytes | str) -> Path:
    """Write a file and return its path."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def read(name: str, content: bytes | str, **options: Any) -> PointCloud:
    """Return what is read of a file with this name and content. options: of `ScanOptions`."""
    with TemporaryDirectory() as folder:
        return read_scan(put(Path(folder), name, content), ScanOptions(**options))


def codes_of(cloud: PointCloud) -> list[str]:
    """Return the codes of the diagnostics."""
    return [note.code for note in cloud.diagnostics]


def assert_same_points(actual: PointCloud, expected: PointCloud = CLOUD, atol_m: float = 1e-6) -> None:
    """Compare positions (with their offset) and colours point by point."""
    np.testing.assert_allclose(
        actual.positions + actual.origin_offset, expected.positions + expected.origin_offset, rtol=0, atol=atol_m
    )
    np.testing.assert_array_equal(actual.colors, expected.colors)


def table_of(
    cloud: PointCloud = CLOUD, separator: str = " ", scale: float | None = None, between: str = "", after: str = ""
) -> str:
    """Return a line per point: its position with three decimals, `between`, its colour times `scale`, `after`."""
    colors = cloud.colors.tolist() if scale is None else (cloud.colors * scale).tolist()
    lines = []
    for position, color in zip(cloud.positions.tolist(), colors, strict=True):
        values = [f"{value:.3f}" for value in position] + between.split() + [str(value) for value in color]
        lines.append(separator.join(values + after.split()))
    return "\n".join(lines) + "\n"


def las_of(
    cloud: PointCloud = CLOUD,
    point_format: int = 2,
    color_scale: int = 257,
    compressed: bool = True,
    vlrs: tuple[Any, ...] = (),
    minor: int | None = None,
) -> bytes:
    """Return a LAS or LAZ file. color_scale: of 8-bit colours in their 16-bit fields; 0 leaves the fields as they are."""
    minor = minor or (4 if point_format >= 6 else 2)
    header = laspy.LasHeader(point_format=point_format, version=f"1.{minor}")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(cloud.origin_offset)
    las = laspy.LasData(header)
    las.x, las.y, las.z = (cloud.positions.astype(np.float64) + cloud.origin_offset).T
    if color_scale:
        las.red, las.green, las.blue = cloud.colors.T.astype(np.uint16) * color_scale
    las.header.vlrs.extend(vlrs)
    buffer = io.BytesIO()
    las.write(buffer, do_compress=compressed)
    return buffer.getvalue()


def pcd_header(num_points: int, fields: str, sizes: str, types: str, encoding: str, counts: str = "") -> bytes:
    """Return the header of a PCD file. counts: of values per field, by default one."""
    counts = counts or " ".join("1" for _ in fields.split())
    return (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\n"
        f"COUNT {counts}\nWIDTH {num_points}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {num_points}\nDATA {encoding}\n"
    ).encode()


def pcd_body(columns: list[NDArray[Any]], encoding: str) -> bytes:
    """Return the points of a PCD file from its fields; LZF of literals alone where they are compressed."""
    if encoding == "ascii":
        rows = zip(*[column.tolist() for column in columns], strict=True)
        return "\n".join(" ".join(repr(value) for value in row) for row in rows).encode()
    if encoding == "binary":
        rows_array = np.empty(len(columns[0]), [(str(number), c.dtype) for number, c in enumerate(columns)])
        for number, column in enumerate(columns):
            rows_array[str(number)] = column
        return rows_array.tobytes()
    data = b"".join(column.tobytes() for column in columns)
    pieces = (data[start : start + 32] for start in range(0, len(data), 32))
    packed = b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)
    return struct.pack("<II", len(packed), len(data)) + packed


def packed_colors(cloud: PointCloud = CLOUD, alpha: int = 0) -> NDArray[np.uint32]:
    """Return the colours as PCD packs them."""
    red, green, blue = cloud.colors.T.astype(np.uint32)
    packed: NDArray[np.uint32] = np.uint32(alpha << 24) | (red << 16) | (green << 8) | blue
    return packed


def axes_of(cloud: PointCloud = CLOUD, dtype: str = "<f4") -> list[NDArray[Any]]:
    """Return x, y and z as columns of their own."""
    return [np.ascontiguousarray(cloud.positions[:, axis], dtype) for axis in range(3)]


def pcd_of(cloud: PointCloud = CLOUD, encoding: str = "binary") -> bytes:
    """Return a PCD file with packed colours."""
    start = pcd_header(len(cloud), "x y z rgb", "4 4 4 4", "F F F U", encoding)
    return start + pcd_body([*axes_of(cloud), packed_colors(cloud)], encoding)


def station_text(
    points: Array, colors: NDArray[np.uint8] | None, rotation: Array, translation: Array, num_rows: int = 1
) -> str:
    """Return a station of a PTX file at a pose (x_file = R x + t) that sees `points` (N, 3) of the file's frame.

    N is a multiple of `num_rows`. colors: (N, 3), or None. A point that is NaN is a cell without a return.
    """
    local = (points - translation) @ rotation
    rows: list[list[Any]] = [[len(points) // num_rows], [num_rows], translation.tolist(), *rotation.T.tolist()]
    rows += [[*axis, 0] for axis in rotation.T.tolist()] + [[*translation.tolist(), 1]]
    for number, point in enumerate(local.tolist()):
        is_missing = point[0] != point[0]
        color = [] if colors is None else [0, 0, 0] if is_missing else colors[number].tolist()
        rows.append(["0", "0", "0", "0.5", *color] if is_missing else [*point, 0.25, *color])
    return "".join(" ".join(f"{v:.9f}" if isinstance(v, float) else str(v) for v in row) + "\n" for row in rows)


def splat_ply(cloud: PointCloud, opacities: Array) -> bytes:
    """Return a Gaussian splat of 1 cm at every point, as 3D Gaussian Splatting's own code writes them.

    opacities: (N,) 0..1. The harmonics of degree 1 see nothing.
    """
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{n}" for n in range(9))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.zeros((len(cloud), len(names)), "<f4")
    table[:, :3] = cloud.positions
    table[:, 6:9] = (cloud.colors / 255 - 0.5) * 2 * np.sqrt(np.pi)
    table[:, 18] = np.log(opacities / (1 - opacities))
    table[:, 19:22] = np.log(0.01)
    table[:, 22] = 1
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}"]
    header += [f"property float {name}" for name in names]
    return ("\n".join([*header, "end_header"]) + "\n").encode() + table.tobytes()
