"""A reader that crashes, hangs or takes too much fails its scan with a message, and nothing else."""

import platform
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.sandbox import SandboxLimits
from panoloc.core.scan.reading_context import RawChunk, ReadingContext
from panoloc.core.scan.sandbox.reading import read_in_sandbox

ROOT = Path(__file__).parents[4]


def read(name: str, tmp_path: Path, limits: SandboxLimits | None = None) -> tuple[list[RawChunk], ReadingContext]:
    path = tmp_path / "scan"
    path.write_bytes(b"scan")
    context = ReadingContext(path, ScanOptions(), 4)
    return list(read_in_sandbox(f"tests.core.scan.sandbox.misbehaving_readers:{name}", context, limits)), context


@pytest.mark.slow
def test_points_notes_and_coordinate_system_come_out_as_they_went_in(tmp_path: Path) -> None:
    chunks, context = read("well_behaved", tmp_path)
    positions = np.concatenate([chunk.positions for chunk in chunks])
    np.testing.assert_array_equal(positions, np.arange(7_500_000.0).reshape(-1, 3))
    assert {chunk.colors.dtype for chunk in chunks} == {np.dtype(np.uint16)}
    assert all((chunk.colors == 7).all() for chunk in chunks)
    assert [(note.code, note.severity) for note in context.diagnostics] == [("few_points", "warning")]
    assert context.coordinate_system == "EPSG:25832"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "limits", "error", "said"),
    [
        ("refusing", SandboxLimits(), ScanDamagedError, "^line 7 is odd$"),
        ("crashing", SandboxLimits(), ScanDamagedError, r"its reader failed \(SIGSEGV\)"),
        ("exiting", SandboxLimits(), ScanDamagedError, r"its reader failed \(exit code 3\)"),
        ("greedy", SandboxLimits(), ScanContentError, "more than 6 GiB, the memory limit"),
        ("endless", SandboxLimits(cpu_s=1), ScanContentError, "takes longer than 1 s"),
        ("silent", SandboxLimits(silence_s=1.0), ScanContentError, "takes longer than 1 s"),
        ("nesting", SandboxLimits(), ScanDamagedError, "nested too deeply"),
        ("writing", SandboxLimits(), ScanDamagedError, "its reader failed"),
        ("babbling", SandboxLimits(), ScanDamagedError, "wrote no message"),
    ],
)
def test_what_goes_wrong_in_a_reader_becomes_the_error_of_its_scan(
    tmp_path: Path, name: str, limits: SandboxLimits, error: type[ScanError], said: str
) -> None:
    with pytest.raises(error, match=said):
        read(name, tmp_path, limits)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "aarch64"), reason="the filter is of these processors")
@pytest.mark.parametrize("name", ["connecting", "executing", "killing"])
def test_a_reader_reaches_neither_network_nor_programs_nor_processes(tmp_path: Path, name: str) -> None:
    with pytest.raises(ScanDamagedError, match="PermissionError"):
        read(name, tmp_path)


def test_a_reader_knows_no_secrets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for secret in ("RAY_AUTH_TOKEN", "PANOLOC_API_KEYS", "SOME_TOKEN"):
        monkeypatch.setenv(secret, "secret")
    with pytest.raises(ScanDamagedError, match=r"^\[\]$"):
        read("telling_secrets", tmp_path)


def running_with(path: Path) -> list[str]:
    """Return the command lines of sandboxed readers of a file."""
    listed = subprocess.run(["ps", "-ww", "-eo", "args"], capture_output=True, text=True, check=True).stdout
    return [line for line in listed.splitlines() if str(path) in line and "panoloc.core.scan.sandbox.child" in line]


def test_a_reader_ends_when_nobody_listens_any_more(tmp_path: Path) -> None:
    path = tmp_path / "scan"
    path.write_bytes(b"scan")
    chunks = read_in_sandbox(
        "tests.core.scan.sandbox.misbehaving_readers:endless", ReadingContext(path, ScanOptions(), 4)
    )
    next(chunks)
    assert running_with(path)
    chunks.close()  # type: ignore[attr-defined]  # a generator
    assert not running_with(path)


def test_a_reader_ends_with_the_process_that_it_reads_for(tmp_path: Path) -> None:
    path = tmp_path / "scan"
    path.write_bytes(b"scan")
    program = (
        "import sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path; from panoloc.core.options import ScanOptions\n"
        "from panoloc.core.scan.sandbox.reading import read_in_sandbox\n"
        "from panoloc.core.scan.reading_context import ReadingContext\n"
        "context = ReadingContext(Path(sys.argv[1]), ScanOptions(), 4)\n"
        "for chunk in read_in_sandbox('tests.core.scan.sandbox.misbehaving_readers:endless', context): print('begun', flush=True)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", program, str(path), str(ROOT)], stdout=subprocess.PIPE, cwd=ROOT)
    assert parent.stdout is not None
    with parent.stdout:
        assert parent.stdout.readline() == b"begun\n"
    assert running_with(path)
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 10
    while running_with(path) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not running_with(path)
