"""How the service ends, asked and unasked, and that it begins again where it was. Embedded Redis."""

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.integration.running_service import RunningService, eventually, is_running
from tests.integration.small_room import OPTIONS, small_room

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def data_dir() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        yield Path(folder) / "data"


@pytest.fixture
def foreign_folder(tmp_path: Path) -> Path:
    """Return a folder with packages of the same names as the service's own."""
    for name in ("core", "service", "lab", "numpy", "panoloc"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('a package of somebody else')")
    return tmp_path


def test_it_lives_before_the_algorithm_is_loaded_and_finishes_what_runs_when_asked_to_end(
    data_dir: Path, foreign_folder: Path
) -> None:
    service = RunningService(data_dir, None, foreign_folder, drain_s="240")
    try:
        assert eventually(lambda: service.status("/health/live") == 200, 90)
        libraries = Path(f"/proc/{service.process.pid}/maps").read_text()
        # Processor time: what the clock says depends on who else works on this machine.
        lived_after_s = processor_time_s(service.process.pid)
        assert service.status("/health/ready") == 503
        service.wait_until_ready()
        map_id = service.register(small_room().scan, OPTIONS)
        family, worker = service.family(), service.worker_pid()
        # Else all may be answered, and the service gone, before anybody looks.
        os.kill(worker, signal.SIGSTOP)
        with ThreadPoolExecutor(4) as clients:
            requests = [clients.submit(service.localize, small_room().panorama, map_id) for _ in range(4)]
            service.wait_until_taken(requests)
            service.process.send_signal(signal.SIGTERM)
            assert eventually(lambda: service.status("/health/ready") == 503, 90)
            turned_away = service.localize(small_room().panorama, map_id)
            os.kill(worker, signal.SIGCONT)
            assert [request.result().status_code for request in requests] == [200] * 4
        assert turned_away.status_code == 503
        assert int(turned_away.headers["Retry-After"]) >= 1
        assert service.process.wait(120) == 0
    finally:
        service.kill()
    assert eventually(lambda: not any(is_running(pid) for pid in family), 90)
    assert "torch" not in libraries
    # Processors differ, and so does what others leave of them.
    assert lived_after_s < 3 * time_of_frameworks_s()


def time_of_frameworks_s() -> float:
    """Return the processor time in which Python loads what the service stands on."""
    before = os.times()
    modules = "fastapi, httpx, prometheus_client, pydantic_settings, redis.asyncio, structlog, uvicorn"
    subprocess.run([sys.executable, "-c", f"import {modules}"], check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def processor_time_s(pid: int) -> float:
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def test_killed_it_leaves_no_process_behind_and_the_next_one_knows_its_maps(data_dir: Path) -> None:
    service = RunningService(data_dir)
    try:
        service.wait_until_ready()
        (known,) = service.http.get("/maps").json()["items"]
        assert service.localize(small_room().panorama, known["id"]).status_code == 200
        family = service.family()
    finally:
        service.kill()
    assert len(family) >= 3  # with its worker and its Redis
    assert eventually(lambda: not any(is_running(pid) for pid in family), 90), [
        Path(f"/proc/{pid}/cmdline").read_text() for pid in family if is_running(pid)
    ]
