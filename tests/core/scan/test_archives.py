"""A zip holds a scan with its companions, or several scans in one frame; what would do harm is refused."""

import io
import socket
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanFormatError, ScanTooLargeError
from panoloc.core.options import ScanOptions
from panoloc.core.scan import unpacking
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.image.picture_files import encoded
from tests.core.painted_box import PaintedBox
from tests.core.scan.mesh_files import assert_painted, glb_of, obj_files, walls_of, zip_of
from tests.core.scan.scan_files import CLOUD, assert_same_points, codes_of, las_of, put, read, table_of

FEW = ScanOptions(max_points_used=20_000)
BOX = PaintedBox(seed=3)


@pytest.fixture(autouse=True)
def nothing_remains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let archives be unpacked into a folder of the test; every test leaves it empty."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def part(cloud: PointCloud, chosen: slice) -> PointCloud:
    return PointCloud(cloud.positions[chosen], cloud.colors[chosen])


@pytest.mark.parametrize("name", ["room.zip", "room", "room.obj"])
def test_an_obj_with_its_materials_and_textures_is_sampled_with_their_pictures(
    nothing_remains: Path, name: str
) -> None:
    files = {f"export/{name}": data for name, data in obj_files(BOX).items()}
    cloud = read(
        name, zip_of({**files, "__MACOSX/export/._room.obj": b"x", "readme.txt": b"hello"}), max_points_used=20_000
    )
    assert_painted(cloud, BOX)
    assert not list(nothing_remains.iterdir())


@pytest.mark.parametrize("per_corner", [True, False])
def test_a_ply_with_textures_beside_it_is_sampled_with_their_pictures(per_corner: bool) -> None:
    cloud = read("room.zip", zip_of(textured_ply(per_corner)), max_points_used=20_000)
    assert_painted(cloud, BOX)


def textured_ply(per_corner: bool) -> dict[str, bytes]:
    walls, files = walls_of(BOX), {}
    rows, faces = [], []
    for number, wall in enumerate(walls):
        uv = wall.uv * [1, -1] + [0, 1]
        places = "" if not per_corner else "8 " + " ".join(f"{v:.8f}" for v in uv.ravel())
        rows += [" ".join(f"{v:.8f}" for v in (*c, *p)) for c, p in zip(wall.corners, uv, strict=True)]
        faces.append(f"4 {4 * number} {4 * number + 1} {4 * number + 2} {4 * number + 3} {places} {number}")
        files[f"wall{number}.png"] = encoded(wall.picture)
    header = ["ply", "format ascii 1.0", *(f"comment TextureFile wall{n}.png" for n in range(6)), "element vertex 24"]
    header += [f"property float {name}" for name in ("x", "y", "z", "s", "t")]
    header += ["element face 6", "property list uchar int vertex_indices"]
    header += ["property list uchar float texcoord"] if per_corner else []
    return {"room.ply": "\n".join([*header, "property int texnumber", "end_header", *rows, *faces]).encode(), **files}


def test_scans_of_several_formats_become_one_map() -> None:
    """Each with colours in a range of its own: bytes, 16 bits, text."""
    thirds = [part(CLOUD, slice(start, start + 20)) for start in (0, 20, 40)]
    files = {"a.ply": encode_ply(thirds[0]), "b.laz": las_of(thirds[1]), "station 3.xyz": table_of(thirds[2]).encode()}
    found = read("scans.zip", zip_of(files))
    assert_same_points(found, CLOUD, 1e-6)
    assert found.num_points_read == len(CLOUD)
    assert "scans_merged" in codes_of(found)


def test_options_are_applied_once() -> None:
    files = {"a.ply": encode_ply(part(CLOUD, slice(0, 30))), "b.ply": encode_ply(part(CLOUD, slice(30, 60)))}
    options: dict[str, Any] = {"unit": "cm", "up_axis": "y"}
    merged, alone = (
        read("s.zip", zip_of(files), **options),
        read("s.ply", encode_ply(CLOUD), **options),
    )
    np.testing.assert_allclose(merged.positions, alone.positions, atol=1e-6)
    assert codes_of(merged).count("unit_converted") == 2


def test_points_are_counted_over_all_scans() -> None:
    files = {"a.ply": encode_ply(CLOUD), "b.ply": encode_ply(CLOUD)}
    with pytest.raises(ScanTooLargeError, match="at most 100 points, got 120"):
        read("s.zip", zip_of(files), max_points=100)


def test_errors_begin_with_the_file_that_they_are_about() -> None:
    files = {"good.ply": encode_ply(CLOUD), "sub/bad.ply": encode_ply(CLOUD)[:-9]}
    with pytest.raises(ScanDamagedError, match=r"^sub/bad\.ply: expected 60 points"):
        read("s.zip", zip_of(files))
    missing = {name: data for name, data in obj_files(BOX).items() if "wall 4" not in name}
    with pytest.raises(
        ScanContentError, match=r"^room\.obj: .*texture 'textures\\\\wall 4\.png', but the zip holds no such file"
    ):
        read("s.zip", zip_of(missing))
    broken = {**obj_files(BOX), "textures/wall 2.png": b"\x89PNG\r\n\x1a\n" + bytes(50)}
    with pytest.raises(ScanDamagedError, match=r"texture textures\\wall 2\.png cannot be read"):
        read("s.zip", zip_of(broken))


@pytest.mark.parametrize("name", ["../../secret.png", "/etc/passwd", "C:\\secret.png", "..\\..\\..\\etc\\passwd"])
def test_a_scan_that_refers_to_files_outside_gets_none(name: str) -> None:
    files = obj_files(BOX)
    files["room.mtl"] = files["room.mtl"].replace(b"textures\\wall 0.png", name.encode())
    with pytest.raises(ScanContentError, match="the zip holds no such file"):
        read("s.zip", zip_of(files))


def patched(data: bytes, changes: dict[int, bytes]) -> bytes:
    changed = bytearray(data)
    for place, value in changes.items():
        changed[place : place + len(value)] = value
    return bytes(changed)


def with_link() -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        info = zipfile.ZipInfo("scan.ply")
        info.external_attr = 0o120777 << 16
        archive.writestr(info, "/etc/passwd")
    return buffer.getvalue()


PLY = encode_ply(CLOUD)
GOOD = zip_of({"a.ply": PLY})
TWO = zip_of({"a.xyz": b"0 0 0 1 2 3\n" * 50, "b.xyz": b"0 0 0 1 2 3\n" * 50})
ENTRY = GOOD.rfind(b"PK\x01\x02")
"""Where the directory of GOOD begins: sizes, flags and offsets stand there and in the headers of the files."""
DAMAGED = {
    **{
        f"the name {name!r}": (zip_of({name: PLY}), "a path outside the archive")
        for name in ("../evil.ply", "..\\evil.ply", "/tmp/evil.ply", "C:\\evil.ply")
    },
    "a link": (with_link(), "is a link"),
    "more than announced": (patched(GOOD, dict.fromkeys((22, ENTRY + 24), bytes([24, 0, 0, 0]))), "cannot be unpacked"),
    "shared bytes": (patched(TWO, {TWO.rfind(b"PK\x01\x02") + 42: bytes(4)}), "shares its bytes"),
    "a name too long for the disk": (zip_of({f"{'a' * 300}.ply": b"ply"}), "too long for the disk"),
    "cut": (GOOD[: len(GOOD) // 2], "cannot be unpacked"),
    "no archive": (b"PK\x03\x04" + bytes(100), "cannot be unpacked"),
    "a name twice": (zip_of({"a.ply": PLY, "A.PLY": PLY}), "twice"),
}
WITHOUT_SCANS = {
    "encrypted": (patched(GOOD, dict.fromkeys((6, ENTRY + 8), b"\x01")), "is encrypted"),
    "empty": (zip_of({}), "holds no scan.*It holds nothing"),
    "no scan": (zip_of({"a.jpg": b"x", "read me.txt": b"hello"}), r"holds no scan.*a\.jpg, read me\.txt"),
    "an archive in it": (zip_of({"inner.zip": GOOD}), "holds another zip, 'inner.zip'"),
    "another method": (zip_of({"a.ply": PLY}, zipfile.ZIP_LZMA), "packed by method 14"),
}


@pytest.mark.parametrize("kind", [*DAMAGED, *WITHOUT_SCANS])
def test_what_would_do_harm_or_holds_no_scan_is_refused_and_nothing_remains(
    tmp_path: Path, nothing_remains: Path, kind: str
) -> None:
    data, said = {**DAMAGED, **WITHOUT_SCANS}[kind]
    with pytest.raises(ScanDamagedError if kind in DAMAGED else ScanContentError, match=said):
        read_scan(put(tmp_path, "s.zip", data))
    assert not list(nothing_remains.iterdir())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.zip", "temporary"]


def test_a_file_that_is_named_like_a_scan_and_is_none_is_named() -> None:
    with pytest.raises(ScanFormatError, match=r"^a\.ply: expected a scan"):
        read("s.zip", zip_of({"a.ply": b"\x00what", "b.ply": PLY}))


def test_more_files_than_a_scan_has_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "MAX_MEMBERS", 3)
    with pytest.raises(ScanContentError, match="holds 4 files; expected at most 3"):
        read("s.zip", zip_of({f"{n}.txt": b"" for n in range(4)}))


def test_a_bomb_is_refused_before_it_is_unpacked(nothing_remains: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unpacking, "_UNSUSPICIOUS_BYTES", 1 << 20)
    with pytest.raises(ScanContentError, match="would take 20,000,000 bytes unpacked"):
        read("s.zip", zip_of({"scan.xyz": b"0" * 20_000_000}))
    monkeypatch.setattr(unpacking, "_SPARE_BYTES", 1 << 60)
    with pytest.raises(ScanContentError, match="there is room for 0"):
        read("s.zip", zip_of({"scan.xyz": b"0 0 0 1 2 3\n1 1 1 4 5 6\n"}))
    assert not list(nothing_remains.iterdir())


def test_what_a_killed_process_left_is_removed(nothing_remains: Path) -> None:
    remains = nothing_remains / f"panoloc-zip-{socket.gethostname()}-999999999-abc"
    remains.mkdir()
    (remains / "scan.ply").write_bytes(b"x")
    read("s.zip", zip_of({"a.ply": encode_ply(CLOUD)}))
    assert not list(nothing_remains.iterdir())


def test_a_mesh_beside_a_table_is_read_apart() -> None:
    table = BOX.scan(5000)
    cloud = read(
        "s.zip", zip_of({"walls.glb": glb_of(BOX), "more.xyz": table_of(table).encode()}), max_points_used=20_000
    )
    assert_painted(cloud, BOX, worst=9.0)


def test_an_archive_is_unpacked_where_the_caller_has_room(nothing_remains: Path, tmp_path: Path) -> None:
    roomy = tmp_path / "roomy"
    roomy.mkdir()
    seen: set[int] = set()

    def look(_: float) -> None:
        seen.add(len(list(roomy.iterdir())))
        assert not list(nothing_remains.iterdir())

    read_scan(put(tmp_path, "s.zip", zip_of({"a.ply": encode_ply(CLOUD)})), FEW, look, lambda: roomy)
    assert max(seen) == 1
    assert not list(roomy.iterdir())
