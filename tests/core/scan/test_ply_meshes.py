"""Meshes become points on their surface."""

import struct

import numpy as np
import pytest

from panoloc.core.errors import ScanDamagedError
from tests.core.scan.scan_files import codes_of, read

CORNERS = [(0, 0, 0), (4, 0, 0), (4, 3, 0), (0, 3, 0)]
VERTEX = "element vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
RGB = "property uchar red\nproperty uchar green\nproperty uchar blue\n"


def floor(encoding: str, faces: list[list[int]], left: int = 0, right: int = 200) -> bytes:
    """A 4 x 3 m floor whose red grows from `left` at x = 0 to `right` at x = 4."""
    colors = [(right if x else left, 10, 20) for x, _, _ in CORNERS]
    text = f"ply\nformat {encoding} 1.0\nelement face {len(faces)}\nproperty list uchar int vertex_indices\n"
    start = (text + VERTEX.format(4) + RGB + "end_header\n").encode()
    if encoding == "ascii":
        lines = [" ".join(map(str, [len(face), *face])) for face in faces]
        lines += [" ".join(map(str, [*corner, *color])) for corner, color in zip(CORNERS, colors, strict=True)]
        return start + "\n".join(lines).encode()
    order = "<" if "little" in encoding else ">"
    data = b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)
    return (
        start
        + data
        + b"".join(struct.pack(order + "3f3B", *corner, *color) for corner, color in zip(CORNERS, colors, strict=True))
    )


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("faces", [[[0, 1, 2], [0, 2, 3]], [[0, 1, 2, 3]]])
def test_a_sparse_mesh_is_sampled_evenly_with_mixed_colours(encoding: str, faces: list[list[int]]) -> None:
    cloud = read("mesh.ply", floor(encoding, faces), max_points_used=3000)
    assert [note.code for note in cloud.diagnostics if note.code.startswith("mesh")] == ["mesh_sampled"]
    assert 2500 < len(cloud) <= 3000
    low, high = cloud.bounds
    np.testing.assert_allclose([*low, *high], [0, 0, 0, 4, 3, 0], atol=0.1)
    np.testing.assert_allclose(cloud.colors[:, 0], cloud.positions[:, 0] * 50, atol=1.5)
    per_square_metre, _, _ = np.histogram2d(cloud.positions[:, 0], cloud.positions[:, 1], bins=(4, 3))
    assert per_square_metre.min() > 0.85 * per_square_metre.max()


def test_labels_are_not_mixed_while_sampling() -> None:
    cloud = read(
        "mesh.ply",
        floor("ascii", [[0, 1, 2], [0, 2, 3]], left=40, right=200),
        max_points_used=2000,
        color_kind="labels",
    )
    assert set(cloud.colors[:, 0].tolist()) == {40, 200}
    assert (cloud.colors[cloud.positions[:, 0] < 1, 0] == 40).all()
    assert (cloud.colors[cloud.positions[:, 0] > 3, 0] == 200).all()


def test_face_colours_serve_where_vertices_have_none() -> None:
    elements = VERTEX.format(4) + "element face 2\nproperty list uchar int vertex_index\n" + RGB
    body = "".join(" ".join(map(str, corner)) + "\n" for corner in CORNERS) + "3 0 1 2 255 0 0\n3 0 2 3 0 0 255\n"
    cloud = read("mesh.ply", f"ply\nformat ascii 1.0\n{elements}end_header\n{body}", max_points_used=1000)
    is_lower = cloud.positions[:, 1] / 3 < cloud.positions[:, 0] / 4 - 0.05
    assert (cloud.colors[is_lower] == [255, 0, 0]).all()
    assert 0.3 < is_lower.mean() < 0.7


def test_dense_vertices_are_used_as_they_are() -> None:
    steps = np.arange(20) * 0.01
    grid = np.stack(np.meshgrid(steps, steps, [0.0]), axis=-1).reshape(-1, 3)
    rows = [f"{x:.3f} {y:.3f} {z:.3f} 9 8 {number % 250}" for number, (x, y, z) in enumerate(grid)]
    faces = [f"3 {number} {number + 1} {number + 20}" for number in range(379)]
    elements = VERTEX.format(400) + RGB + f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    text = f"ply\nformat ascii 1.0\n{elements}end_header\n" + "\n".join(rows + faces)
    cloud = read("mesh.ply", text)
    assert "mesh_vertices_used" in codes_of(cloud)
    np.testing.assert_allclose(cloud.positions, grid, atol=1e-6)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("corner", [4, -1])
def test_a_face_that_refers_to_no_vertex_is_damaged(encoding: str, corner: int) -> None:
    with pytest.raises(ScanDamagedError, match=r"refers to vertex (4|-1), but there are 4"):
        read("mesh.ply", floor(encoding, [[0, 1, corner]]))


@pytest.mark.parametrize("face", ["3 0 1 2 3", "3 0 1", "-1 0 1 2", "2.5 0 1"])
def test_an_ascii_face_that_does_not_fit_its_length_is_damaged(face: str) -> None:
    text = floor("ascii", [[0, 1, 2], [0, 2, 3]]).decode().replace("3 0 2 3", face)
    with pytest.raises(ScanDamagedError, match=r"Line 14 does not fit the lists"):
        read("mesh.ply", text)
