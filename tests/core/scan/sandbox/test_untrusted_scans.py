"""An untrusted scan is read in the sandbox, whatever its format, and one of some formats always is."""

from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from panoloc.core.errors import ScanDamagedError
from panoloc.core.options import ScanOptions
from panoloc.core.sandbox import SandboxLimits
from panoloc.core.scan import reading
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.reading_context import RawChunk, ReadingContext
from tests.core.scan.mesh_files import colored_quad, glb, zip_of
from tests.core.scan.scan_files import CLOUD, las_of, pcd_of, read, table_of

FILES = {
    "room.ply": encode_ply(CLOUD),
    "room.pcd": pcd_of(encoding="ascii"),
    "room.xyz": table_of().encode(),
    "room.zip": zip_of({"room.xyz": table_of().encode()}),
}


def parse_nothing(context: ReadingContext) -> NoReturn:
    raise AssertionError(f"{context.path} was parsed in the process that asked for it")


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_the_sandbox_gives_the_same_points_and_the_caller_parses_nothing(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    trusted = read(name, FILES[name])
    monkeypatch.setattr(reading, "READERS", dict.fromkeys(reading.READERS, parse_nothing))
    with pytest.raises(AssertionError):
        read(name, FILES[name])
    found = read(name, FILES[name], from_strangers=True)
    np.testing.assert_array_equal(found.positions, trusted.positions)
    np.testing.assert_array_equal(found.colors, trusted.colors)
    assert found.diagnostics == trusted.diagnostics


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("room.glb", glb(*colored_quad())),
        ("room.obj", b"v 0 0 0 1 0 0\nv 3 0 0 1 0 0\nv 0 3 0 1 0 0\nf 1 2 3\n"),
        ("room.laz", las_of(CLOUD, 7)),
    ],
)
def test_formats_of_native_parsers_and_of_many_parts_are_read_there_also_from_friends(
    monkeypatch: pytest.MonkeyPatch, name: str, data: bytes
) -> None:
    monkeypatch.setattr(reading, "READERS", dict.fromkeys(reading.READERS, parse_nothing))
    assert len(read(name, data)) > 0


def test_a_damaged_one_is_refused_in_the_words_of_its_reader() -> None:
    said = []
    for from_strangers in (False, True):
        with pytest.raises(ScanDamagedError) as found:
            read("room.ply", encode_ply(CLOUD)[:-100], from_strangers=from_strangers)
        said.append(str(found.value))
    assert said[0] == said[1]


def test_the_time_of_a_reader_grows_with_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[SandboxLimits] = []

    def read_nothing(name: str, context: ReadingContext, limits: SandboxLimits) -> Iterator[RawChunk]:
        given.append(limits)
        return iter(())

    monkeypatch.setattr(reading, "read_in_sandbox", read_nothing)
    for size_bytes in (10**6, 4 * 10**9):
        reading.iter_chunks(
            "text", ReadingContext(tmp_path / "table.xyz", ScanOptions(from_strangers=True), size_bytes)
        )
    assert [limits.cpu_s for limits in given] == [902, 8900]
    assert SandboxLimits().cpu_s == 900
