"""An untrusted scan is read in the sandbox, whatever its format."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from panoloc.core.errors import ScanDamagedError
from panoloc.core.options import ScanOptions
from panoloc.core.scan import reading
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from panoloc.core.scan.reading_context import RawChunk, ReadingContext
from panoloc.core.scan.sandbox.limits import SandboxLimits
from tests.core.scan.mesh_files import zip_of

UNTRUSTED = ScanOptions(from_strangers=True)


@pytest.fixture
def room() -> PointCloud:
    rng = np.random.default_rng(7)
    positions = np.round(rng.random((60, 3)) * [4, 3, 2.5], 3).astype(np.float32)
    colors = rng.integers(0, 256, (60, 3), dtype=np.uint8)
    colors[:2] = [[0, 0, 0], [255, 255, 255]]
    return PointCloud(positions, colors)


def write_text(path: Path, room: PointCloud) -> None:
    rows = zip(room.positions.tolist(), room.colors.tolist(), strict=True)
    path.write_text("".join(" ".join(map(str, [*position, *color])) + "\n" for position, color in rows))


def write_pcd(path: Path, room: PointCloud) -> None:
    colors = room.colors.astype(np.uint32)
    packed = colors[:, 0] << 16 | colors[:, 1] << 8 | colors[:, 2]
    count = len(room.positions)
    header = "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
    rows = (
        " ".join(map(str, [*position, color]))
        for position, color in zip(room.positions.tolist(), packed.tolist(), strict=True)
    )
    path.write_text(f"{header}WIDTH {count}\nHEIGHT 1\nPOINTS {count}\nDATA ascii\n" + "\n".join(rows) + "\n")


def write_ply(path: Path, room: PointCloud) -> None:
    path.write_bytes(encode_ply(room))


def write_zip(path: Path, room: PointCloud) -> None:
    text = path.with_suffix(".xyz")
    write_text(text, room)
    path.write_bytes(zip_of({"room.xyz": text.read_bytes()}))


def parse_nothing(context: ReadingContext) -> NoReturn:
    raise AssertionError(f"{context.path} was parsed in the process that asked for it")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("room.ply", write_ply),
        ("room.pcd", write_pcd),
        ("room.xyz", write_text),
        ("room.zip", write_zip),
    ],
)
def test_the_sandbox_gives_the_same_points_and_the_caller_parses_nothing(
    tmp_path: Path,
    room: PointCloud,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    write: Callable[[Path, PointCloud], None],
) -> None:
    write(tmp_path / name, room)
    trusted = read_scan(tmp_path / name)
    monkeypatch.setattr(reading, "READERS", dict.fromkeys(reading.READERS, parse_nothing))
    with pytest.raises(AssertionError):
        read_scan(tmp_path / name)
    read = read_scan(tmp_path / name, UNTRUSTED)
    np.testing.assert_array_equal(read.positions, trusted.positions)
    np.testing.assert_array_equal(read.colors, trusted.colors)
    assert read.diagnostics == trusted.diagnostics


def test_a_damaged_one_is_refused_in_the_words_of_its_reader(tmp_path: Path, room: PointCloud) -> None:
    path = tmp_path / "room.ply"
    path.write_bytes(encode_ply(room)[:-100])
    with pytest.raises(ScanDamagedError) as trusted:
        read_scan(path)
    with pytest.raises(ScanDamagedError) as found:
        read_scan(path, UNTRUSTED)
    assert str(found.value) == str(trusted.value)


def test_the_time_of_a_reader_grows_with_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[SandboxLimits] = []

    def read_nothing(name: str, context: ReadingContext, limits: SandboxLimits) -> Iterator[RawChunk]:
        given.append(limits)
        return iter(())

    monkeypatch.setattr(reading, "read_in_sandbox", read_nothing)
    for size_bytes in (10**6, 4 * 10**9):
        reading.iter_chunks("text", ReadingContext(tmp_path / "table.xyz", UNTRUSTED, size_bytes))
    assert [limits.cpu_s for limits in given] == [902, 8900]
    assert SandboxLimits().cpu_s == 900
