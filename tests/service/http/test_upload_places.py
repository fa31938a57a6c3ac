"""Uploads at the same time, exports that take too long or that nobody waits for, and what the metrics say of limits."""

import asyncio
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from panoloc.service.errors import ExportFailedError
from panoloc.service.host.child_processes import run_module
from panoloc.service.host.written_files import written_file
from panoloc.service.limits import capacity
from panoloc.service.storage import FolderStorage
from tests.service.http.running_service import RunningService, Serve

pytestmark = pytest.mark.anyio


async def held_body(may_go_on: asyncio.Event, has_begun: asyncio.Event) -> AsyncIterator[bytes]:
    yield b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.ply"\r\n\r\nply\n'
    has_begun.set()
    await may_go_on.wait()
    yield b"\r\n--x--\r\n"


async def upload(running: RunningService, may_go_on: asyncio.Event, has_begun: asyncio.Event) -> httpx.Response:
    headers = {"Content-Type": "multipart/form-data; boundary=x"}
    return await running.client.post("/maps", content=held_body(may_go_on, has_begun), headers=headers)


@pytest.mark.parametrize(("limit", "whose"), [("_UPLOADS", "of all callers"), ("_UPLOADS_OF_CALLER", "of one caller")])
async def test_one_upload_too_many_is_refused_until_another_is_done(
    serve: Serve, monkeypatch: pytest.MonkeyPatch, limit: str, whose: str
) -> None:
    monkeypatch.setattr(capacity, limit, 1)
    async with serve() as running:
        may_go_on, has_begun = asyncio.Event(), asyncio.Event()
        first = asyncio.create_task(upload(running, may_go_on, has_begun))
        await has_begun.wait()
        assert "panoloc_uploads 1.0" in (await running.client.get("/metrics")).text
        refused = await running.upload()
        assert (refused.status_code, refused.json()["type"]) == (503, "/problems/too-many-uploads")
        assert f"at most 1 uploads of scans and batches {whose}" in refused.json()["detail"]
        assert int(refused.headers["retry-after"]) >= 1
        may_go_on.set()
        assert (await first).status_code < 500
        assert (await running.upload()).status_code == 202
        metrics = (await running.client.get("/metrics")).text
        assert 'panoloc_refusals_total{limit="uploads"} 1.0' in metrics
        assert "panoloc_uploads 0.0" in metrics


@pytest.fixture
def endless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let every module that is run wait for ever; return the file that says that it has begun."""
    begun = tmp_path / "begun"
    (tmp_path / "endless.py").write_text(
        f"import os, time\nopen({str(begun)!r}, 'w').write(str(os.getpid()))\ntime.sleep(1000)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return begun


async def pid_of(begun: Path) -> int:
    while not (begun.exists() and begun.read_text()):
        await asyncio.sleep(0.01)
    return int(begun.read_text())


@pytest.mark.slow
async def test_an_export_that_takes_too_long_is_killed(
    endless: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.service.host.written_files.LONGEST_S", 3.0)
    task = asyncio.create_task(written_file(FolderStorage(tmp_path), "endless", {}))
    pid = await pid_of(endless)
    with pytest.raises(ExportFailedError, match="expected a file within 3 s"):
        await task
    assert not Path(f"/proc/{pid}").exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
async def test_an_export_that_nobody_waits_for_is_killed(endless: Path) -> None:
    task = asyncio.create_task(run_module("endless"))
    pid = await pid_of(endless)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert not Path(f"/proc/{pid}").exists()
