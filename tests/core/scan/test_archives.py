"""A zip holds a scan with its companions, or several scans in one frame; what would do harm is refused."""

import io
import socket
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError, ScanTooLargeError
from panoloc.core.options import ScanOptions
from panoloc.core.scan import unpacking
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.painted_box import PaintedBox
from tests.core.scan.mesh_files import glb_of, obj_files, walls_of, zip_of
from tests.core.scan.test_gltf_reading import assert_painted

ScanFile = Callable[[str, bytes | str], Path]
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


def las_of(cloud: PointCloud) -> bytes:
    file = laspy.create(point_format=2, file_version="1.2")
    file.header.scales = np.full(3, 0.001)
    file.x, file.y, file.z = cloud.positions.astype(np.float64).T
    file.red, file.green, file.blue = cloud.colors.astype(np.uint16).T * 257
    buffer = io.BytesIO()
    file.write(buffer, do_compress=True)
    return buffer.getvalue()


def table_of(cloud: PointCloud) -> bytes:
    rows = zip(cloud.positions.tolist(), cloud.colors.tolist(), strict=True)
    return "\n".join(" ".join(map(str, (*(f"{v:.3f}" for v in point), *color))) for point, color in rows).encode()


@pytest.mark.parametrize("name", ["room.zip", "room", "room.obj"])
def test_an_obj_with_its_materials_and_textures_is_sampled_with_their_pictures(
    scan_file: ScanFile, nothing_remains: Path, name: str
) -> None:
    files = {f"export/{name}": data for name, data in obj_files(BOX).items()}
    cloud = read_scan(
        scan_file(name, zip_of({**files, "__MACOSX/export/._room.obj": b"x", "readme.txt": b"hello"})), FEW
    )
    assert_painted(cloud, BOX)
    assert not list(nothing_remains.iterdir())


@pytest.mark.parametrize("per_corner", [True, False])
def test_a_ply_with_textures_beside_it_is_sampled_with_their_pictures(scan_file: ScanFile, per_corner: bool) -> None:
    cloud = read_scan(scan_file("room.zip", zip_of(textured_ply(per_corner))), FEW)
    assert_painted(cloud, BOX)


def textured_ply(per_corner: bool) -> dict[str, bytes]:
    walls, files = walls_of(BOX), {}
    rows, faces = [], []
    for number, wall in enumerate(walls):
        uv = wall.uv * [1, -1] + [0, 1]
        places = "" if not per_corner else "8 " + " ".join(f"{v:.8f}" for v in uv.ravel())
        rows += [" ".join(f"{v:.8f}" for v in (*c, *p)) for c, p in zip(wall.corners, uv, strict=True)]
        faces.append(f"4 {4 * number} {4 * number + 1} {4 * number + 2} {4 * number + 3} {places} {number}")
        buffer = io.BytesIO()
        from PIL import Image

        Image.fromarray(wall.picture).save(buffer, "PNG")
        files[f"wall{number}.png"] = buffer.getvalue()
    header = ["ply", "format ascii 1.0", *(f"comment TextureFile wall{n}.png" for n in range(6)), "element vertex 24"]
    header += [f"property float {name}" for name in ("x", "y", "z", "s", "t")]
    header += ["element face 6", "property list uchar int vertex_indices"]
    header += ["property list uchar float texcoord"] if per_corner else []
    return {"room.ply": "\n".join([*header, "property int texnumber", "end_header", *rows, *faces]).encode(), **files}


def test_scans_of_several_formats_become_one_map(
    cloud: PointCloud, scan_file: ScanFile, assert_same_points: Callable[..., None]
) -> None:
    """Each with colours in a range of its own: bytes, 16 bits, text."""
    thirds = [part(cloud, slice(start, start + 20)) for start in (0, 20, 40)]
    files = {"a.ply": encode_ply(thirds[0]), "b.laz": las_of(thirds[1]), "station 3.xyz": table_of(thirds[2])}
    read = read_scan(scan_file("scans.zip", zip_of(files)))
    assert_same_points(read, cloud, 1e-6)
    assert read.num_points_read == len(cloud)
    assert "scans_merged" in [note.code for note in read.diagnostics]


def test_options_are_applied_once(cloud: PointCloud, scan_file: ScanFile) -> None:
    files = {"a.ply": encode_ply(part(cloud, slice(0, 30))), "b.ply": encode_ply(part(cloud, slice(30, 60)))}
    options = ScanOptions(unit="cm", up_axis="y")
    merged, alone = (
        read_scan(scan_file("s.zip", zip_of(files)), options),
        read_scan(scan_file("s.ply", encode_ply(cloud)), options),
    )
    np.testing.assert_allclose(merged.positions, alone.positions, atol=1e-6)
    assert [note.code for note in merged.diagnostics].count("unit_converted") == 2


def test_points_are_counted_over_all_scans(cloud: PointCloud, scan_file: ScanFile) -> None:
    files = {"a.ply": encode_ply(cloud), "b.ply": encode_ply(cloud)}
    with pytest.raises(ScanTooLargeError, match="at most 100 points, got 120"):
        read_scan(scan_file("s.zip", zip_of(files)), ScanOptions(max_points=100))


@pytest.mark.slow
def test_errors_begin_with_the_file_that_they_are_about(cloud: PointCloud, scan_file: ScanFile) -> None:
    files = {"good.ply": encode_ply(cloud), "sub/bad.ply": encode_ply(cloud)[:-9]}
    with pytest.raises(ScanDamagedError, match=r"^sub/bad\.ply: expected 60 points"):
        read_scan(scan_file("s.zip", zip_of(files)))
    missing = {name: data for name, data in obj_files(BOX).items() if "wall 4" not in name}
    with pytest.raises(
        ScanContentError, match=r"^room\.obj: .*texture 'textures\\\\wall 4\.png', but the zip holds no such file"
    ):
        read_scan(scan_file("s.zip", zip_of(missing)))
    broken = {**obj_files(BOX), "textures/wall 2.png": b"\x89PNG\r\n\x1a\n" + bytes(50)}
    with pytest.raises(ScanDamagedError, match=r"texture textures\\wall 2\.png cannot be read"):
        read_scan(scan_file("s.zip", zip_of(broken)))


@pytest.mark.parametrize("name", ["../../secret.png", "/etc/passwd", "C:\\secret.png", "..\\..\\..\\etc\\passwd"])
def test_a_scan_that_refers_to_files_outside_gets_none(scan_file: ScanFile, name: str) -> None:
    files = obj_files(BOX)
    files["room.mtl"] = files["room.mtl"].replace(b"textures\\wall 0.png", name.encode())
    with pytest.raises(ScanContentError, match="the zip holds no such file"):
        read_scan(scan_file("s.zip", zip_of(files)))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("../evil.ply", "a path outside the archive"),
        ("..\\evil.ply", "a path outside the archive"),
        ("/tmp/evil.ply", "a path outside the archive"),
        ("C:\\evil.ply", "a path outside the archive"),
    ],
)
def test_names_that_lead_out_of_the_archive_are_refused(
    cloud: PointCloud, scan_file: ScanFile, tmp_path: Path, name: str, said: str
) -> None:
    with pytest.raises(ScanDamagedError, match=said):
        read_scan(scan_file("s.zip", zip_of({name: encode_ply(cloud)})))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.zip", "temporary"]


def test_links_are_refused(scan_file: ScanFile) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        info = zipfile.ZipInfo("scan.ply")
        info.external_attr = 0o120777 << 16
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(ScanDamagedError, match="is a link"):
        read_scan(scan_file("s.zip", buffer.getvalue()))


def test_a_bomb_is_refused_before_it_is_unpacked(
    scan_file: ScanFile, nothing_remains: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacking, "_UNSUSPICIOUS_BYTES", 1 << 20)
    with pytest.raises(ScanContentError, match="would take 20,000,000 bytes unpacked"):
        read_scan(scan_file("s.zip", zip_of({"scan.xyz": b"0" * 20_000_000})))
    monkeypatch.setattr(unpacking, "_SPARE_BYTES", 1 << 60)
    with pytest.raises(ScanContentError, match="there is room for 0"):
        read_scan(scan_file("s.zip", zip_of({"scan.xyz": b"0 0 0 1 2 3\n1 1 1 4 5 6\n"})))
    assert not list(nothing_remains.iterdir())


def test_a_file_that_unpacks_to_more_than_it_announces_is_damaged(scan_file: ScanFile) -> None:
    data = bytearray(zip_of({"scan.xyz": b"0 0 0 1 2 3\n" * 1000}))
    for place in (22, data.rfind(b"PK\x01\x02") + 24):  # the size in the local header and in the directory
        data[place : place + 4] = struct.pack("<I", 24)
    with pytest.raises(ScanDamagedError, match="cannot be unpacked"):
        read_scan(scan_file("s.zip", bytes(data)))


def test_files_that_share_their_bytes_are_refused(scan_file: ScanFile) -> None:
    data = zip_of({"a.xyz": b"0 0 0 1 2 3\n" * 50, "b.xyz": b"0 0 0 1 2 3\n" * 50})
    second = data.rfind(b"PK\x01\x02")
    overlapping = bytearray(data)
    overlapping[second + 42 : second + 46] = bytes(4)  # where its header lies: where that of the first does
    with pytest.raises(ScanDamagedError, match="shares its bytes"):
        read_scan(scan_file("s.zip", bytes(overlapping)))


def test_archives_that_are_none_hold_no_scan_or_too_much_are_told_so(
    cloud: PointCloud, scan_file: ScanFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = zip_of({"a.ply": encode_ply(cloud)})
    cases = {
        good[: len(good) // 2]: "cannot be unpacked",
        b"PK\x03\x04" + bytes(100): "cannot be unpacked",
        zip_of({}): "holds no scan.*It holds nothing",
        zip_of({"a.jpg": b"x", "read me.txt": b"hello"}): r"holds no scan.*a\.jpg, read me\.txt",
        zip_of({"inner.zip": good}): "holds another zip, 'inner.zip'",
        zip_of({"a.ply": b"what", "b.ply": encode_ply(cloud)}): r"^a\.ply: expected a scan",
        zip_of({"a.ply": encode_ply(cloud), "A.PLY": encode_ply(cloud)}): "twice",
        zip_of({"a.ply": encode_ply(cloud)}, zipfile.ZIP_LZMA): "packed by method 14",
    }
    for data, said in cases.items():
        with pytest.raises(ScanError, match=said):
            read_scan(scan_file("s.zip", data))
    monkeypatch.setattr(unpacking, "MAX_MEMBERS", 3)
    with pytest.raises(ScanContentError, match="holds 4 files; expected at most 3"):
        read_scan(scan_file("s.zip", zip_of({f"{n}.txt": b"" for n in range(4)})))


def test_encrypted_files_are_told_so(cloud: PointCloud, scan_file: ScanFile) -> None:
    data = bytearray(zip_of({"a.ply": encode_ply(cloud)}))
    for place in (6, data.rfind(b"PK\x01\x02") + 8):
        data[place] |= 1
    with pytest.raises(ScanContentError, match="is encrypted"):
        read_scan(scan_file("s.zip", bytes(data)))


def test_what_a_killed_process_left_is_removed(cloud: PointCloud, scan_file: ScanFile, nothing_remains: Path) -> None:
    remains = nothing_remains / f"panoloc-zip-{socket.gethostname()}-999999999-abc"
    remains.mkdir()
    (remains / "scan.ply").write_bytes(b"x")
    read_scan(scan_file("s.zip", zip_of({"a.ply": encode_ply(cloud)})))
    assert not list(nothing_remains.iterdir())


def test_a_mesh_beside_a_table_is_read_apart(scan_file: ScanFile) -> None:
    table = BOX.scan(5000)
    cloud = read_scan(scan_file("s.zip", zip_of({"walls.glb": glb_of(BOX), "more.xyz": table_of(table)})), FEW)
    assert_painted(cloud, BOX, worst=9.0)


def test_a_name_longer_than_the_disk_takes_is_said(scan_file: ScanFile) -> None:
    with pytest.raises(ScanDamagedError, match="too long for the disk"):
        read_scan(scan_file("scans.zip", zip_of({f"{'a' * 300}.ply": b"ply"})))


def test_an_archive_is_unpacked_where_the_caller_has_room(
    cloud: PointCloud, scan_file: ScanFile, nothing_remains: Path, tmp_path: Path
) -> None:
    roomy = tmp_path / "roomy"
    roomy.mkdir()
    seen: set[int] = set()

    def look(_: float) -> None:
        seen.add(len(list(roomy.iterdir())))
        assert not list(nothing_remains.iterdir())

    read_scan(scan_file("s.zip", zip_of({"a.ply": encode_ply(cloud)})), FEW, look, lambda: roomy)
    assert max(seen) == 1
    assert not list(roomy.iterdir())
