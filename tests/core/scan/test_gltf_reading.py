"""glTF models become points on their surface, with the colours of their textures, z up."""

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanTooLargeError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading import read_scan
from tests.core.image.picture_files import encoded
from tests.core.painted_box import PaintedBox
from tests.core.scan.mesh_files import assert_mixed, assert_painted, colored_quad, glb, glb_of
from tests.core.scan.scan_files import codes_of, put, read

FEW = ScanOptions(max_points_used=20_000)


def test_textured_walls_of_a_glb_are_sampled_with_their_pictures_and_z_is_up() -> None:
    box = PaintedBox(seed=3)
    cloud = read("room.glb", glb_of(box), max_points_used=20_000)
    assert_painted(cloud, box)
    assert codes_of(cloud) == ["axes_converted", "mesh_sampled", "thinned"]


def test_saying_that_y_is_up_changes_nothing_of_a_gltf() -> None:
    found = [read("quad.glb", glb(*colored_quad()), up_axis=axis, max_points_used=1000) for axis in ("y", "z")]
    np.testing.assert_array_equal(found[0].positions, found[1].positions)


@pytest.mark.parametrize("name", ["room.gltf", "room", "room.json"])
def test_json_with_its_buffer_inside_is_read_like_a_glb(tmp_path: Path, name: str) -> None:
    document, binary = colored_quad()
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    path = put(tmp_path, name, json.dumps({"asset": {"version": "2.0"}, **document}))
    whole = read("quad.glb", glb(*colored_quad()), max_points_used=20_000)
    np.testing.assert_array_equal(read_scan(path, FEW).positions, whole.positions)


def test_vertex_colours_are_mixed_over_the_floor() -> None:
    cloud = read("quad.glb", glb(*colored_quad()), max_points_used=3000)
    assert_mixed(cloud)


@pytest.mark.parametrize(
    ("mode", "corners", "area"), [(4, [0, 1, 2], 6.0), (5, [0, 1, 3, 2], 12.0), (6, [0, 1, 2, 3], 12.0)]
)
def test_strips_and_fans_are_triangles(mode: int, corners: list[int], area: float) -> None:
    document, binary = colored_quad()
    document["meshes"][0]["primitives"][0]["mode"] = mode
    document["accessors"][2]["count"] = len(corners)
    binary = binary[:64] + np.array([*corners, 0, 0, 0][:6], "<u2").tobytes()
    cloud = read("quad.glb", glb(document, binary))
    assert cloud.num_points_read == pytest.approx(area / 0.01**2, abs=2)


def test_points_of_a_gltf_are_taken_as_they_are() -> None:
    document, binary = colored_quad()
    document["meshes"][0]["primitives"][0] = {"attributes": {"POSITION": 0, "COLOR_0": 1}, "mode": 0}
    cloud = read("points.glb", glb(document, binary))
    np.testing.assert_allclose(cloud.positions, [[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]])
    np.testing.assert_array_equal(cloud.colors[:3], [[255, 0, 0], [0, 255, 0], [0, 0, 255]])


def test_transparent_parts_of_a_texture_are_no_surface() -> None:
    cloud = read("quad.glb", glb(*textured_quad("MASK")))
    assert cloud.positions[:, 0].min() > 1.9
    assert read("quad.glb", glb(*textured_quad("OPAQUE"))).positions[:, 0].min() < 0.1


def textured_quad(alpha_mode: str) -> tuple[dict[str, Any], bytes]:
    """A floor whose left half, by texture, is clear and whose right half is red above (small y) and blue below."""
    pixels = np.zeros((8, 8, 4), np.uint8)
    pixels[:4, :, 0], pixels[4:, :, 2], pixels[:, 4:, 3] = 255, 255, 255
    document, binary = colored_quad()
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], "<f4").tobytes()
    picture = encoded(pixels)
    document["meshes"][0]["primitives"][0] = {
        "attributes": {"POSITION": 0, "TEXCOORD_0": 3},
        "indices": 2,
        "material": 0,
    }
    document["accessors"].append({"bufferView": 3, "componentType": 5126, "count": 4, "type": "VEC2"})
    document["bufferViews"] += [
        {"buffer": 0, "byteOffset": 76, "byteLength": len(uv)},
        {"buffer": 0, "byteOffset": 76 + len(uv), "byteLength": len(picture)},
    ]
    document["buffers"] = [{"byteLength": 76 + len(uv) + len(picture)}]
    document["images"] = [{"bufferView": 4, "mimeType": "image/png"}]
    document["textures"] = [{"source": 0, "sampler": 0}]
    document["samplers"] = [{"wrapS": 33071, "wrapT": 33071}]
    document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "alphaMode": alpha_mode}]
    return document, binary + uv + picture


@pytest.mark.parametrize(
    ("transform", "red_where"),
    [
        ({}, "y < 1.5"),
        ({"offset": [0, 0.5]}, "never"),
        ({"scale": [1, 0.5]}, "always"),
        # Counter-clockwise by a quarter, v down: (u, v) becomes (v, -u), moved back by 1.
        ({"rotation": np.pi / 2, "offset": [0, 1]}, "x > 2"),
    ],
)
def test_texture_transforms_are_applied(transform: dict[str, Any], red_where: str) -> None:
    document, binary = textured_quad("OPAQUE")
    info = document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    info["extensions"] = {"KHR_texture_transform": transform}
    cloud = read("quad.glb", glb(document, binary), max_points_used=2000)
    x, y, _ = cloud.positions.T
    expected = {"y < 1.5": y < 1.5, "never": y < 0, "always": y > -1, "x > 2": x > 2}[red_where]
    is_inside = (np.abs(y - 1.5) > 0.3) & (np.abs(x - 2) > 0.4) & (y < 2.9)
    np.testing.assert_array_equal((cloud.colors[:, 0] > 128)[is_inside], expected[is_inside])


def test_a_mesh_without_any_colour_is_refused() -> None:
    document, binary = colored_quad()
    del document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    with pytest.raises(ScanContentError, match="no colour"):
        read("quad.glb", glb(document, binary))


BROKEN: dict[str, tuple[dict[str, Any], str]] = {
    "a node below itself": ({"nodes": [{"mesh": 0, "children": [0]}]}, "its own descendant; expected a tree"),
    "nodes in a ring": (
        {"nodes": [{"children": [1]}, {"children": [2]}, {"children": [1], "mesh": 0}]},
        "its own descendant; expected a tree",
    ),
    "a node that is not there": ({"scenes": [{"nodes": [7]}]}, "contradicts itself"),
    "a negative reference": ({"nodes": [{"mesh": -1}]}, "refers to entry -1"),
    "a mesh that is no list": ({"meshes": {"primitives": 1}}, "contradicts itself"),
    "an accessor of more than there is": (
        {"accessors": [{"bufferView": 0, "componentType": 5126, "count": 10**15, "type": "VEC3"}] * 3},
        "contradicts itself",
    ),
    "a view beyond its buffer": (
        {"bufferViews": [{"buffer": 0, "byteOffset": 60, "byteLength": 48}] * 3},
        "places 48 bytes at byte 60 of a buffer that has 76",
    ),
    "a buffer that is only referred to": ({"buffers": [{"byteLength": 76, "uri": "room.bin"}]}, "one zip"),
    "a buffer on the network": ({"buffers": [{"byteLength": 76, "uri": "https://a.b/c"}]}, "readers fetch nothing"),
    "Draco": ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "Draco compression"),
    "an unknown extension": ({"extensionsRequired": ["ACME_cubes"]}, "ACME_cubes"),
    "a pose that is not finite": ({"nodes": [{"mesh": 0, "scale": [1e308, 1e308, float("inf")]}]}, "not finite"),
    "no surface": ({"meshes": [{"primitives": []}]}, "no surface"),
}


@pytest.mark.filterwarnings("ignore:invalid value")  # of what is not finite
@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_gltf_is_refused_with_the_reason(kind: str) -> None:
    changes, said = BROKEN[kind]
    with pytest.raises((ScanDamagedError, ScanContentError), match=said):
        read("quad.glb", glb(*colored_quad(**changes)))


def test_a_glb_cut_anywhere_is_refused_with_the_reason() -> None:
    whole = glb(*colored_quad())
    for length in (5, 12, 30, len(whole) // 2, len(whole) - 4):
        with pytest.raises(ScanDamagedError, match=r"truncated|no description"):
            read("quad.glb", whole[:length])


@pytest.mark.parametrize("corner", [4, 60_000])
def test_a_triangle_that_refers_to_no_vertex_is_damaged(corner: int) -> None:
    document, binary = colored_quad()
    binary = binary[:64] + np.array([0, 1, corner, 0, 2, 3], "<u2").tobytes()
    with pytest.raises(ScanDamagedError, match=rf"refers to vertex {corner}, but there are 4"):
        read("quad.glb", glb(document, binary))


def test_a_million_instances_are_too_many_triangles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from panoloc.core.scan.gltf import reader
    from panoloc.core.scan.reading_context import ReadingContext

    monkeypatch.setattr(reader, "MAX_TRIANGLES", 100)
    nodes = [{"mesh": 0} for _ in range(200)]
    path = put(tmp_path, "quad.glb", glb(*colored_quad(nodes=nodes, scenes=[{"nodes": list(range(200))}])))
    with pytest.raises(ScanTooLargeError, match="more than 100 triangles, instances included"):
        list(reader.read_gltf(ReadingContext(path, ScanOptions(), path.stat().st_size)))
