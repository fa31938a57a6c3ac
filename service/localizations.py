"""Runs queries: chooses the maps, asks the pool, and keeps the answers for a while."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import structlog

from panoloc.core.errors import DeadlineExceededError
from panoloc.core.image.image_header import image_kind
from panoloc.core.remarks import Remark
from panoloc.service.answer import Document, Localization
from panoloc.service.cache import Cache
from panoloc.service.errors import (
    EXPECTED_ERRORS,
    CacheDownError,
    LocalizationNotFoundError,
    QueueFullError,
    ServiceError,
)
from panoloc.service.jobs import LocalizeJob, LocalizeOutcome, QueryImage, QueryOptions, WorkerPool, new_id, now
from panoloc.service.maps.changes import ChangeLog
from panoloc.service.maps.registry import MapRegistry
from panoloc.service.maps.selection import ChosenMaps, MapChoice
from panoloc.service.metrics import Metrics
from panoloc.service.problems import problem_document, problem_of
from panoloc.service.settings import Settings
from panoloc.service.storage import Storage

_log = structlog.get_logger(__name__)

# Of what is stored, not of what is sent: whether the images of an answer had poses of a tracked session, and who asked.
IS_TRACKED, _TENANT = "is_tracked", "tenant"
# The pool refuses at once; a query that still runs after this is accepted.
_ADMISSION_S = 0.05
# The pool keeps the deadline; this much later no answer will come.
_OVERDUE_S = 10.0


@dataclass(frozen=True)
class LocalizeRequest:
    """One query of a caller."""

    images: tuple[QueryImage, ...]
    maps: MapChoice
    options: QueryOptions
    request_id: str
    batch_id: str | None = None


@dataclass
class Localizations:
    """Used from one event loop."""

    settings: Settings
    registry: MapRegistry
    pool: WorkerPool
    cache: Cache
    storage: Storage
    metrics: Metrics
    changes: ChangeLog
    _under_way: dict[str, asyncio.Task[Localization]] = field(default_factory=dict, init=False)

    async def answer(self, query: LocalizeRequest) -> Localization:
        """Return the answer. Raises MapNotFoundError, MapNotReadyError, MapUnusableError and the errors of the pool."""
        await self.registry.find(query.maps.map_ids)
        chosen = query.maps.resolve(self.registry)
        # Without Redis the answer could not be kept, and a worker may compute for minutes.
        await self.cache.check()
        return await self._answer(query, chosen, new_id("loc"), is_waited_for=True)

    async def begin(self, query: LocalizeRequest, when_done: Callable[[], None] = lambda: None) -> Document:
        """Begin a query whose answer is fetched later, and return its state. Raises as `answer` does.

        when_done: called once the query has ended, if it has begun.
        """
        await self.registry.find(query.maps.map_ids)
        chosen = query.maps.resolve(self.registry)
        localization_id = new_id("loc")
        pending = {"id": localization_id, "status": "queued", "created_at": now(), "error": None}
        # By the time that anybody can ask for it, the query runs.
        running = {**pending, "status": "running", "due_unix_s": time.time() + query.options.timeout_s}
        running[_TENANT] = query.maps.tenant
        await self.cache.put_state(localization_id, running, extra_s=query.options.timeout_s)
        task = asyncio.create_task(self._answer_later(query, chosen, pending))
        self._under_way[localization_id] = task
        task.add_done_callback(lambda _: self._under_way.pop(localization_id, None))
        task.add_done_callback(lambda _: when_done())
        task.add_done_callback(lambda done: done.cancelled() or done.exception())
        await asyncio.wait({task}, timeout=_ADMISSION_S)
        if task.done() and not task.cancelled() and task.exception() is not None:
            task.result()
        return pending

    async def get(self, localization_id: str, tenant: str | None) -> Document:
        """Return an answer or its state; tenant: of the caller, None for one that sees all. Raises LocalizationNotFoundError, also for what
        another tenant asked for."""
        found = await self.stored(localization_id, tenant)
        found.pop(IS_TRACKED, None)
        return found

    async def stored(self, localization_id: str, tenant: str | None) -> Document:
        """Return the same, an answer with `IS_TRACKED`."""
        found = await self.cache.get_localization(localization_id)
        asked_by = None if found is None else found.pop(_TENANT, None)
        if found is None or (tenant is not None and asked_by != tenant):
            raise unknown(localization_id, self.settings.result_ttl_s)
        due_unix_s = found.pop("due_unix_s", None)
        if due_unix_s is not None and time.time() > due_unix_s + _OVERDUE_S:
            error = DeadlineExceededError("the service restarted before the answer was ready; localize again")
            return {**found, "status": "failed", "error": problem_document(error, found["id"])}
        return found

    async def forget(self, localization_id: str, tenant: str | None) -> None:
        """Cancel a query whose answer is fetched later, or delete an answer and its pictures. tenant, and what it raises: as of `get`."""
        await self.get(localization_id, tenant)
        task = self._under_way.pop(localization_id, None)
        if task is not None:
            task.cancel()
            await asyncio.wait({task})
        if not await self.cache.forget_localization(localization_id):
            raise unknown(localization_id, self.settings.result_ttl_s)

    async def picture(self, localization_id: str, name: str, tenant: str | None) -> bytes:
        """Return a PNG of an answer. tenant, and what it raises: as of `get`, also when the query did not ask for it."""
        await self.get(localization_id, tenant)
        data = await self.cache.get_picture(localization_id, name)
        if data is None:
            raise LocalizationNotFoundError(
                f"expected a picture that the query requested, but {localization_id} has no {name}; list it under "
                "`artifacts` in the query's options, or wait until the query is done"
            )
        return data

    async def stop(self, drain_s: float) -> None:
        """Wait up to `drain_s` for the queries whose answer is fetched later, then cancel them."""
        under_way = set(self._under_way.values())
        if under_way:
            await asyncio.wait(under_way, timeout=drain_s)
        for task in under_way:
            task.cancel()
        await asyncio.gather(*under_way, return_exceptions=True)

    async def _answer(
        self, query: LocalizeRequest, chosen: ChosenMaps, localization_id: str, is_waited_for: bool
    ) -> Localization:
        began = time.monotonic()
        try:
            outcome, chosen = await self._outcome(query, chosen, localization_id)
        except EXPECTED_ERRORS as error:
            if isinstance(error, QueueFullError):
                self.metrics.note_refusal(error.limit)
            self.metrics.note_localization(query.options.method, problem_of(error).slug, {})
            raise
        only = chosen.refs[0].id if len(chosen.refs) == 1 else None
        remarks = [*chosen.warnings, *self._doubts(outcome.answer.map_id or only)]
        answer = outcome.answer.as_waited_for(time.monotonic() - began, remarks)
        document = answer.model_dump(mode="json")
        stored = {**document, IS_TRACKED: query.images[0].session_from_camera is not None, _TENANT: query.maps.tenant}
        try:
            await self.cache.put_answer(localization_id, stored, outcome.pictures, [ref.id for ref in chosen.refs])
            await self._forget_deleted(chosen)
        except CacheDownError as error:
            if not is_waited_for:
                raise
            _log.warning("an answer cannot be stored", error=str(error))
            answer = answer.without_copies()
        await self._note_changes(document, outcome, query)
        if self.settings.keep_images:
            await self._keep(localization_id, query.images)
        self.metrics.note_localization(query.options.method, answer.status, answer.timings_s)
        return answer

    def _doubts(self, map_id: str | None) -> list[Remark]:
        """Return what an answer has to say of a map whose unit, heights or up axis are in doubt."""
        record = self.registry.get(map_id) if map_id is not None and self.registry.has(map_id) else None
        if record is None or record.serving is None:
            return []
        asked = [each["message"] for each in record.serving.diagnostics if each.get("question")]
        words = "{} is perhaps read wrongly, and so are its poses: {} Answer the question that the map asks."
        return [Remark("map_doubtful", words.format(record.id, message)) for message in asked]

    async def _outcome(
        self, query: LocalizeRequest, chosen: ChosenMaps, localization_id: str
    ) -> tuple[LocalizeOutcome, ChosenMaps]:
        timeout_s = query.options.timeout_s
        deadline_unix_s = time.time() + timeout_s
        while True:
            job = LocalizeJob(
                localization_id,
                query.request_id,
                query.images,
                chosen.refs,
                query.options,
                deadline_unix_s,
                self.registry.georeferences(chosen.refs),
                # Images of batches are stored anyway, until the batch is deleted.
                keep_photo=self.settings.keep_images or query.batch_id is not None,
            )
            try:
                async with asyncio.timeout(max(0.0, deadline_unix_s - time.time()) + _OVERDUE_S):
                    return await self.pool.localize(job), chosen
            except TimeoutError as error:
                raise DeadlineExceededError(
                    f"expected an answer within {timeout_s:g} s, got none; allow more time"
                ) from error
            except EXPECTED_ERRORS:
                # The revision may have been replaced since the query came.
                former, chosen = chosen, query.maps.resolve(self.registry)
                if chosen.refs == former.refs:
                    raise

    async def note_batch(self, answer: Document, key: str, camera: Document | None) -> None:
        """Have what changed found in an image, too, whose answer a batch took over; a failure is logged. See `ChangeLog.note_batch`."""
        try:
            await asyncio.to_thread(self.changes.note_batch, answer, key, camera)
            await self._forget_changes(answer["map_id"])
        except (ServiceError, OSError, ValueError) as error:
            _log.warning("changes are not looked for in an image of a batch", key=key, error=str(error))

    async def _note_changes(self, answer: Document, outcome: LocalizeOutcome, query: LocalizeRequest) -> None:
        """Store what an answer saw changed; a failure is logged and does not fail the answer."""
        try:
            images = [image.data for image in query.images]
            seen, photo = outcome.change_cells, outcome.change_photo
            await asyncio.to_thread(self.changes.note, answer, seen, images, photo, query.batch_id)
            await self._forget_changes(answer["map_id"])
        except (ServiceError, OSError) as error:
            _log.warning("change cells cannot be stored", error=str(error))

    async def _forget_changes(self, map_id: str | None) -> None:
        """Delete what is kept of a map that was deleted meanwhile."""
        if map_id is not None and not self.registry.has(map_id):
            await asyncio.to_thread(self.changes.forget, map_id)

    async def _forget_deleted(self, chosen: ChosenMaps) -> None:
        """Delete the stored answer when one of its maps was deleted meanwhile; its caller still gets it."""
        for ref in chosen.refs:
            if not self.registry.has(ref.id):
                await self.cache.forget_map(ref.id)

    async def _answer_later(self, query: LocalizeRequest, chosen: ChosenMaps, pending: Document) -> Localization:
        try:
            return await self._answer(query, chosen, pending["id"], is_waited_for=False)
        except Exception as error:
            if not isinstance(error, EXPECTED_ERRORS):
                _log.exception("a query failed unexpectedly")
            failed = {**pending, "status": "failed", "error": problem_document(error, query.request_id)}
            failed[_TENANT] = query.maps.tenant
            # Without Redis nobody can read the state either.
            with contextlib.suppress(ServiceError):
                await self.cache.put_state(pending["id"], failed)
            raise

    async def _keep(self, localization_id: str, images: Sequence[QueryImage]) -> None:
        for number, image in enumerate(images, 1):
            name = localization_id if len(images) == 1 else f"{localization_id}-{number:02}"
            kind = image_kind(image.data)
            await asyncio.to_thread(self.storage.put, f"panoramas/{name}.{kind}", image.data)


def unknown(localization_id: str, lifetime_s: int) -> LocalizationNotFoundError:
    """Return the error for an answer that there is not, or not any more."""
    return LocalizationNotFoundError(
        f"expected the id of a localization, got {localization_id[:80]!r}, which is unknown or older than {lifetime_s} s"
        " (PANOLOC_RESULT_TTL_S); localize again"
    )
