"""OBJ models with vertex colours, or with materials and textures beside them."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.obj import read_materials
from tests.core.scan.mesh_files import assert_mixed, zip_of
from tests.core.scan.scan_files import read

FLOOR = """# four corners with colours
o floor
v 0 0 0 1 0 0
v 4 0 0 0 1 0
v 4 3 0 0 0 1
v 0 3 0 1 1 1
vn 0 0 1
usemtl whatever
f 1//1 2//1 3//1 4//1
"""


@pytest.mark.parametrize("name", ["floor.obj", "floor", "floor.txt"])
@pytest.mark.parametrize("scale", [1, 255])
def test_vertex_colours_of_a_lone_obj_are_mixed_over_its_faces(name: str, scale: int) -> None:
    text = FLOOR
    if scale != 1:
        lines = [line.split() for line in text.splitlines()]
        scaled = [[*w[:4], *(str(255 * int(v)) for v in w[4:])] if w[0] == "v" else w for w in lines]
        text = "\n".join(" ".join(words) for words in scaled)
    assert_mixed(read(name, text, max_points_used=3000))


def test_vertices_without_faces_are_points() -> None:
    text = "\n".join(line for line in FLOOR.splitlines() if not line.startswith("f"))
    cloud = read("floor.obj", text)
    np.testing.assert_array_equal(cloud.positions, [[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]])
    np.testing.assert_array_equal(cloud.colors[:2], [[255, 0, 0], [0, 255, 0]])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("f 1//1 2//1 3//1 4//1", "f 1//1 2//1 5//1", "refers to vertex 4, but there are 4, counted from 0"),
        ("f 1//1 2//1 3//1 4//1", "f 1//1 2//1 -5//1", "refers to vertex -1, but there are 4"),
        ("f 1//1 2//1 3//1 4//1", "f 1/7 2/7 3/7", "refers to texture coordinate 6, but there are 0"),
        ("f 1//1 2//1 3//1 4//1", "f 1//1 2//1", "expected three corners"),
        ("f 1//1 2//1 3//1 4//1", "f one two three", "is not understood"),
        ("f 1//1 2//1 3//1 4//1", "f 1//1 nan//1 3//1", "is not understood"),
        ("v 4 3 0 0 0 1", "v 4 3", "Line 5 of the OBJ file is not understood"),
        ("v 4 3 0 0 0 1", "v 4 3 x 0 0 1", "Line 5 of the OBJ file is not understood"),
    ],
)
def test_lines_that_are_not_understood_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(ScanDamagedError, match=said):
        read("floor.obj", FLOOR.replace(old, new))


def test_a_library_that_is_not_needed_does_not_have_to_be_there() -> None:
    assert len(read("floor.obj", f"mtllib room.mtl\n{FLOOR}")) > 1000


def test_an_obj_without_colours_is_told_what_to_send() -> None:
    bare = "\n".join(" ".join(line.split()[:4]) if line.startswith("v ") else line for line in FLOOR.splitlines())
    with pytest.raises(ScanContentError, match="no colour"):
        read("floor.obj", bare)
    with pytest.raises(ScanContentError, match=r"refers to the material file 'room\.mtl'.*one zip"):
        read("floor.obj", "mtllib room.mtl\n" + bare)
    with pytest.raises(ScanContentError, match="holds no vertices"):
        read("floor.obj", "# nothing\no room\n")


def test_options_of_a_texture_are_parted_from_its_name(tmp_path: Path) -> None:
    path = tmp_path / "room.mtl"
    path.write_text(
        "newmtl a\nKd 0.5 0.25 1\nnewmtl b\nmap_Kd -s 2 3 -o 0.25 -clamp on my wall.png\nKd 0 0 0\nnewmtl c\nmap_Kd 4 walls.jpg\n"
    )
    found = read_materials(path)
    np.testing.assert_array_equal(found["a"].diffuse, [0.5, 0.25, 1])
    assert (found["b"].texture, found["b"].scale, found["b"].offset) == ("my wall.png", (2.0, 3.0), (0.25, 0.0))
    assert found["b"].clamped
    np.testing.assert_array_equal(found["b"].diffuse, [1, 1, 1])
    assert found["c"].texture == "4 walls.jpg"
    path.write_text("newmtl a\nKd red\n")
    with pytest.raises(ScanDamagedError, match="Line 2 of the material file"):
        read_materials(path)


def test_a_texture_that_no_face_can_have_is_told_of() -> None:
    picture = io.BytesIO()
    Image.new("RGB", (4, 4), (90, 60, 30)).save(picture, "PNG")
    files = {
        "floor.obj": f"mtllib floor.mtl\n{FLOOR}".encode(),
        "floor.mtl": b"newmtl whatever\nKd 0.5 0.2 0.1\nmap_Kd wood.png\n",
        "wood.png": picture.getvalue(),
    }
    cloud = read("floor.zip", zip_of(files), max_points_used=3000)
    (note,) = [note for note in cloud.diagnostics if note.code == "texture_unused"]
    assert note.severity == "warning"
    assert "'whatever'" in note.message
    assert "2 of its 2 triangles have no texture coordinates" in note.message
