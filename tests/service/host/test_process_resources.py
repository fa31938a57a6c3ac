import os
import subprocess
import sys
from pathlib import Path

import pytest

from panoloc.lab.process_memory import proportional_bytes
from panoloc.service.host.process_resources import (
    SPINNING,
    bound_spinning,
    num_sockets,
    num_usable_cpus,
    return_freed_memory,
)

ROOT = Path(__file__).parents[3]


def test_threads_spin_as_the_user_says_and_not_for_long_where_nobody_does(monkeypatch: pytest.MonkeyPatch) -> None:
    for given, expected in (({}, SPINNING), ({"GOMP_SPINCOUNT": "7"}, {"GOMP_SPINCOUNT": "7"})):
        with monkeypatch.context() as patch:
            patch.setattr(os, "environ", dict(given))
            bound_spinning()
            assert os.environ == expected


@pytest.fixture
def eight_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the affinity mask of this process name eight processors, whatever the machine has."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 64)


@pytest.mark.usefixtures("eight_processors")
@pytest.mark.parametrize(
    ("limit", "expected"),
    [
        ("400000 100000", 4),
        ("150000 100000", 2),  # rounded up: half a processor is better used than left
        ("150000 50000", 3),
        ("1000 100000", 1),
        ("0 100000", 1),
        ("1600000 100000", 8),  # no more than the mask allows
        ("max 100000", 8),
        ("", 8),
        (None, 8),  # no container
    ],
)
def test_a_container_quota_bounds_the_processors(tmp_path: Path, limit: str | None, expected: int) -> None:
    file = tmp_path / "cpu.max"
    if limit is not None:
        file.write_text(limit)
    assert num_usable_cpus(file) == expected


@pytest.mark.parametrize(("count", "expected"), [(6, 6), (None, 1)])
def test_where_no_mask_is_known_the_machine_s_processors_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int | None, expected: int
) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: count)
    assert num_usable_cpus(tmp_path / "absent") == expected


def test_processors_of_one_package_are_one_socket(tmp_path: Path) -> None:
    for cpu, package in enumerate(["0", "0", "1", "1"]):
        topology = tmp_path / f"cpu{cpu}" / "topology"
        topology.mkdir(parents=True)
        (topology / "physical_package_id").write_text(package + "\n")
    assert num_sockets(tmp_path) == 2
    assert num_sockets(tmp_path / "absent") == 1


def test_what_was_freed_below_something_that_stays_goes_back_to_the_system() -> None:
    # Blocks small enough to come from the heap; the last one, at its top, keeps it from shrinking by itself.
    blocks = [bytearray(b"x" * 50_000) for _ in range(2000)]
    last = blocks[-1]
    blocks.clear()
    before = proportional_bytes(os.getpid())
    return_freed_memory()
    assert before - proportional_bytes(os.getpid()) > 50_000_000
    assert len(last) == 50_000


def test_what_was_freed_is_kept_until_it_is_asked_back() -> None:
    script = (
        "import os; from panoloc.service.host.process_resources import keep_freed_memory, return_freed_memory\n"
        "from panoloc.lab.process_memory import proportional_bytes as size\n"
        "keep_freed_memory()\n"
        "block = bytearray(b'x' * 20_000_000); del block\n"  # would be mapped on its own, and unmapped
        "kept = size(os.getpid()); return_freed_memory(); print(kept - size(os.getpid()))"
    )
    done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert int(done.stdout) > 15_000_000


LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of processes are Linux's")


def in_a_limited_process(work: str) -> "subprocess.CompletedProcess[str]":
    program = f"from panoloc.service.host.process_resources import limit_process\nlimit_process(64 << 20, 1)\n{work}"
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False)


@LINUX
def test_a_process_of_limited_memory_gets_so_much_and_no_more() -> None:
    done = in_a_limited_process("bytearray(32 << 20)\nprint('some')\nbytearray(128 << 20)")
    assert done.stdout == "some\n"
    assert "MemoryError" in done.stderr


@LINUX
@pytest.mark.slow
def test_a_process_that_computes_for_ever_is_ended() -> None:
    assert in_a_limited_process("while True: pass").returncode < 0
