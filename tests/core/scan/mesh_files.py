"""Painted boxes as textured meshes, as phones and programs of photogrammetry write them."""

import io
import json
import struct
import zipfile
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.scan.point_cloud import PointCloud
from tests.core.image.picture_files import encoded
from tests.core.painted_box import PaintedBox

Array = NDArray[np.float64]
QUAD = np.array([[0, 1, 2], [0, 2, 3]])


@dataclass(frozen=True)
class Wall:
    """One side of a box. corners: (4, 3), z up. uv: (4, 2), u to the right, v down, as glTF counts. picture: its texture."""

    corners: Array
    uv: Array
    picture: NDArray[np.uint8]


def walls_of(box: PaintedBox) -> list[Wall]:
    """Return the six walls, painted as `PaintedBox.color_at` says."""
    size, walls = np.array(box.size_m), []
    for face, picture in enumerate(box._pictures):
        across = [axis for axis in range(3) if axis != face % 3]
        shares = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
        corners = np.zeros((4, 3))
        corners[:, across] = shares * size[across]
        corners[:, face % 3] = 0 if face < 3 else size[face % 3]
        texels = (shares * (len(picture) - 1) + 0.5) / len(picture)  # row by the first axis, column by the second
        walls.append(Wall(corners, texels[:, ::-1], picture))
    return walls


def assert_mixed(cloud: PointCloud) -> None:
    """The points lie on a floor of 4 x 3 m; colours are mixed between corners that are red, green and blue."""
    low, high = cloud.bounds
    np.testing.assert_allclose([*low, *high], [0, 0, 0, 4, 3, 0], atol=0.1)
    x, y = cloud.positions[:, 0] / 4, cloud.positions[:, 1] / 3
    lower = y < x  # the triangle of the three corners
    np.testing.assert_allclose(cloud.colors[lower, 0], 255 * (1 - x[lower]), atol=8)
    np.testing.assert_allclose(cloud.colors[lower, 2], 255 * y[lower], atol=8)


def assert_painted(cloud: PointCloud, box: PaintedBox, worst: float = 6.0) -> None:
    """The points lie on the walls, evenly, and have their colours but for what lies between two pixels."""
    size = np.array(box.size_m)
    positions = cloud.positions.astype(np.float64) + cloud.origin_offset
    gaps = np.minimum(np.abs(positions), np.abs(positions - size))
    assert gaps.min(axis=1).max() < 0.03
    away = np.sort(gaps, axis=1)[:, 1] > 0.1  # a voxel at an edge holds points of two walls
    off = np.abs(cloud.colors.astype(float) - box.color_at(positions))[away]
    assert off.mean() < worst, off.mean()
    per_wall = [
        np.count_nonzero(np.abs(positions[:, face % 3] - (face // 3) * size[face % 3]) < 1e-3) for face in range(6)
    ]
    areas = [size.prod() / size[face % 3] for face in range(6)]
    np.testing.assert_allclose(np.array(per_wall) / np.sum(per_wall), np.array(areas) / np.sum(areas), rtol=0.1)


def y_up(points: Array) -> Array:
    """Return points of a z-up frame as glTF has them."""
    return points[:, [0, 2, 1]] * [1, 1, -1]


def glb_of(box: PaintedBox) -> bytes:
    """Return a GLB by trimesh: each wall a node of its own that is turned and moved."""
    import trimesh  # which takes half a second, in every process that only collects these tests

    scene = trimesh.Scene()
    for number, wall in enumerate(walls_of(box)):
        placed = trimesh.transformations.rotation_matrix(0.4 * number, [1, 2, 3], [0.3, number, 1])
        local = trimesh.transform_points(y_up(wall.corners), np.linalg.inv(placed))
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(wall.picture))
        uv = wall.uv * [1, -1] + [0, 1]  # trimesh counts v from the lower edge
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        scene.add_geometry(trimesh.Trimesh(local, QUAD, visual=visual, process=False), transform=placed)
    return bytes(scene.export(file_type="glb"))


def obj_files(box: PaintedBox) -> dict[str, bytes]:
    """Return an OBJ with its materials and textures, z up: quads, numbers that count back, and a name with a space."""
    lines, materials, files = ["# made by hand", "mtllib room.mtl"], [], {}
    for number, wall in enumerate(walls_of(box)):
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in wall.corners]
        lines += [f"vt {u:.9g} {1 - v:.9g}" for u, v in wall.uv]
        lines += [f"usemtl wall {number}", "s off"]
        first = 4 * number + 1
        quad = range(first, first + 4) if number % 2 else range(-4, 0)
        lines.append("f " + " ".join(f"{corner}/{corner}" for corner in quad))
        materials += [f"newmtl wall {number}", "Kd 0 0 0", f"map_Kd -s 1 1 1 textures\\wall {number}.png"]
        files[f"textures/wall {number}.png"] = encoded(wall.picture)
    return {"room.obj": "\n".join(lines).encode(), "room.mtl": "\n".join(materials).encode(), **files}


def zip_of(files: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def glb(document: dict[str, Any], binary: bytes = b"") -> bytes:
    """Return a GLB with a JSON and a binary chunk."""
    text = json.dumps({"asset": {"version": "2.0"}, **document}).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def colored_quad(**changes: Any) -> tuple[dict[str, Any], bytes]:
    """Return the document and bytes of a floor of 4 x 3 m, y up, with a colour at each corner; `changes` replace parts of it."""
    positions = np.array([[0, 0, 0], [4, 0, 0], [4, 0, -3], [0, 0, -3]], "<f4")
    colors = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 255]], "u1")
    corners = np.array([0, 1, 2, 0, 2, 3], "<u2")
    binary = positions.tobytes() + colors.tobytes() + corners.tobytes()
    document: dict[str, Any] = {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5121, "count": 4, "type": "VEC4", "normalized": True},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 16},
            {"buffer": 0, "byteOffset": 64, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 76}],
    }
    return {**document, **changes}, binary
