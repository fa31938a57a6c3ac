"""The application with a fake pool and a real Redis, and what tests often do with it."""

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, AbstractContextManager, asynccontextmanager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import httpx
from fastapi import FastAPI

from panoloc.service.app import create_app
from panoloc.service.cache import WorkerCache
from panoloc.service.http.server import DrainingServer, server_config
from panoloc.service.settings import Settings
from panoloc.service.storage import Storage, open_storage
from tests.core.image.picture_files import png
from tests.service.http.fake_pool import FakePool, ply_of

SCAN = ply_of([(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)])


@dataclass
class RunningService:
    """client speaks to `app` without a network."""

    app: FastAPI
    client: httpx.AsyncClient
    pool: FakePool
    storage: Storage
    data_dir: Path

    def by(self, key: str) -> "RunningService":
        """Return the same service for a caller with this key or token."""
        headers = {"Authorization": f"Bearer {key}"}
        transport = httpx.ASGITransport(self.app)
        client = httpx.AsyncClient(transport=transport, base_url=self.client.base_url, headers=headers)
        return replace(self, client=client)

    async def status(self, method: str, path: str, **request: Any) -> int:
        """Return the status of the answer to a request."""
        return (await self.client.request(method, path, **request)).status_code

    async def json(self, path: str, **query: Any) -> Any:
        """Return the JSON behind a path."""
        return (await self.client.get(path, params=query)).json()

    async def pages(self, path: str) -> list[dict[str, Any]]:
        """Return all items of a list, read in pages of two."""
        items, query = list[dict[str, Any]](), {"limit": "2"}
        while "cursor" not in query or query["cursor"] is not None:
            page = await self.json(path, **query)
            assert len(page["items"]) <= 2
            items, query["cursor"] = items + page["items"], page["next_cursor"]
        return items

    async def upload(self, scan: bytes = SCAN, name: str = "office.ply", options: str | None = None) -> httpx.Response:
        """POST a scan."""
        data = {} if options is None else {"options": options}
        return await self.client.post("/maps", files={"file": (name, scan)}, data=data)

    async def ready_map(self, options: str | None = None) -> str:
        """Return the id of a map that is ready."""
        reply = await self.upload(options=options)
        assert reply.status_code == 202, reply.text
        map_id = str(reply.json()["id"])
        assert (await self.settled(map_id))["status"] == "ready"
        return map_id

    async def replace_scan(self, map_id: str, name: str = "new.ply", **data: str) -> httpx.Response:
        """PUT a new scan of a map."""
        return await self.client.put(f"/maps/{map_id}/scan", files={"file": (name, SCAN)}, data=data)

    async def post_batch(self, map_id: str, *names: str, **data: Any) -> httpx.Response:
        """POST a batch of panoramas of these names."""
        files = [("image", (name, png_of(8, 4))) for name in names]
        return await self.client.post("/batches", files=files, data={"map_id": map_id, **data})

    async def done(self, batch_id: str) -> dict[str, Any]:
        """Return a batch once it is done."""
        return await self.eventually(f"/batches/{batch_id}", lambda body: body["status"] == "done")

    async def placed(self, *names: str, map_id: str | None = None) -> tuple[str, str]:
        """Return the ids of a map, a new one if none is given, and of a batch whose images were localized in it."""
        map_id = map_id or await self.ready_map()
        batch_id = (await self.post_batch(map_id, *names)).json()["id"]
        await self.done(batch_id)
        return map_id, batch_id

    async def settled(self, map_id: str) -> dict[str, Any]:
        """Return a map once it is ready or failed."""
        return await self.eventually(f"/maps/{map_id}", lambda body: body["status"] in ("ready", "failed"))

    async def eventually(self, path: str, holds: Any) -> dict[str, Any]:
        """Return the JSON behind a path once it is as wanted."""
        body: dict[str, Any] = {}
        for number in range(30):  # twelve seconds; to ask takes a third of the first pause, of what is waited for
            body = (await self.client.get(path)).json()
            if holds(body):
                return body
            await asyncio.sleep(0.01 * 1.2**number)
        raise AssertionError(f"not within twelve seconds: {body}")

    async def held_query(self, map_id: str, **request: Any) -> asyncio.Task[httpx.Response]:
        """Return a query that a worker holds until `pool.localize_gate` opens."""
        self.pool.localize_gate.clear()
        self.pool.asked.clear()
        asking = asyncio.create_task(self.localize(map_id, **request))
        await self.pool.asked.wait()
        return asking

    async def localize(self, map_id: str | None, image: bytes | None = None, **request: Any) -> httpx.Response:
        """POST a panorama; `options`, `headers`, `tag` and more `files` as they are given."""
        data: dict[str, Any] = {} if map_id is None else {"map_id": map_id}
        data |= {name: request.pop(name) for name in ("options", "tag") if name in request}
        files = {"image": ("photo.png", png_of(8, 4) if image is None else image), **request.pop("files", {})}
        return await self.client.post("/localize", data=data, files=files, **request)


Serve = Callable[..., AbstractAsyncContextManager[RunningService]]
Listen = Callable[..., AbstractContextManager[str]]


@asynccontextmanager
async def running_service(data_dir: Path, redis_url: str, **changes: Any) -> AsyncIterator[RunningService]:
    """Run an application in this event loop; changes: settings, or is_held=True: no query is answered before the gate of the pool opens."""
    is_held = changes.pop("is_held", False)
    settings = Settings(**{"data_dir": data_dir, "redis_url": redis_url, "drain_s": 0.2, **changes})
    storage = open_storage(settings.storage_url, settings.bucket_access)
    pool = FakePool(WorkerCache(redis_url, index_lifetime_s=60))
    if is_held:
        pool.localize_gate.clear()
    app = create_app(settings, pool, storage)
    transport = httpx.ASGITransport(app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://localhost") as client,
    ):
        yield RunningService(app, client, pool, storage, data_dir)
    pool.worker_cache.close()


@contextmanager
def listening(folder: Path, redis_url: str, **changes: Any) -> Iterator[str]:
    """Serve the application on a port of its own, in a thread, and yield its URL."""
    with listening_server(folder, redis_url, **changes) as (url, _):
        yield url


@contextmanager
def listening_server(folder: Path, redis_url: str, **changes: Any) -> Iterator[tuple[str, DrainingServer]]:
    """Serve the application as `listening` does; yield its URL and its server."""
    pool = FakePool(WorkerCache(redis_url, index_lifetime_s=60))
    app = create_app(Settings(**{"data_dir": folder, "redis_url": redis_url, "drain_s": 0.1, **changes}), pool)
    server = DrainingServer(server_config(app, port=0), cast(Any, pool), drain_s=0.0)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield f"http://127.0.0.1:{port}", server
    server.should_exit = True
    thread.join()


def png_of(width: int, height: int) -> bytes:
    """Return a PNG whose header says this size; its one row of pixels is not decoded by the HTTP process."""
    return png(width, height, 8, 2, b"\0" * 25)
