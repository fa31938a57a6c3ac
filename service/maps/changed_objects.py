"""Objects that came, went or moved since the scan, found in the photos that answers keep, and reports of them.

Both are made by processes of their own, on request: they take seconds, and open photos of strangers. What was found
lately stays in memory: the same photos show the same objects.
"""

import asyncio
import io
import json
import zipfile
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from panoloc.core.options import ReportFormat
from panoloc.service.answer import Document
from panoloc.service.errors import StoredFileMissingError
from panoloc.service.host.written_files import written_file
from panoloc.service.jobs import MapRef, new_id
from panoloc.service.maps.record import key_of
from panoloc.service.storage import Storage

MOST_PHOTOS = 60
"""The newest; older ones make room."""

_EMPTY_ZIP = b"PK\x05\x06" + bytes(18)
_REMEMBERED = 16
_STEP_M = 0.5  # an object stands on a floor even if its lowest part was not seen


@dataclass(frozen=True)
class FoundObjects:
    """objects: as in the HTTP contract. archive: a zip with a JPEG of each."""

    objects: list[Document]
    archive: bytes

    def picture(self, object_id: str) -> bytes | None:
        """Return the photo and the scan of an object, side by side; None for one that there is not, or no longer."""
        with zipfile.ZipFile(io.BytesIO(self.archive)) as opened:
            name = f"{object_id}.jpg"
            return opened.read(name) if name in opened.namelist() else None


class ChangedObjects:
    """Used from one event loop. turns: held while a process runs."""

    def __init__(self, storage: Storage, turns: asyncio.Semaphore) -> None:
        self._storage, self._turns = storage, turns
        self._found: OrderedDict[tuple[str, ...], FoundObjects] = OrderedDict()
        self._one_at_a_time = asyncio.Lock()

    async def find(self, ref: MapRef, photos: Sequence[Document], stats: Mapping[str, Any]) -> FoundObjects:
        """Return what photos, as `ChangeLog.photos` returns them, show. Raises ExportFailedError and StorageError.

        stats: of the map, with its `floors`.
        """
        newest = list(photos)[-MOST_PHOTOS:]
        name = (ref.id, str(ref.revision), *(photo["key"] for photo in newest))
        async with self._one_at_a_time:
            if name not in self._found:
                self._found[name] = await self._searched(ref, newest, stats) if newest else FoundObjects([], _EMPTY_ZIP)
            self._found.move_to_end(name)
            while len(self._found) > _REMEMBERED:
                self._found.popitem(last=False)
            return self._found[name]

    def forget(self) -> None:
        """Forget what is remembered: with photos that are deleted go the pictures made of them."""
        self._found.clear()

    async def report(self, ref: MapRef, found: FoundObjects, about: Document, wanted: ReportFormat) -> bytes:
        """Return a report of what was found, its objects with their places on Earth (`ChangeReport`). about: title, num_photos,
        period and made_at. Raises ExportFailedError and StorageError."""
        with ExitStack() as stack:
            points = await asyncio.to_thread(self._copy, key_of(ref, "points.ply"), stack)
            folder = await asyncio.to_thread(self._storage.spool_folder)
            archive = folder / new_id("found")
            stack.callback(archive.unlink, missing_ok=True)
            await asyncio.to_thread(archive.write_bytes, found.archive)
            document = {**about, "points": points, "found": str(archive), "objects": found.objects}
            return await self._written("panoloc.core.changes.reports", document, wanted)

    async def _searched(self, ref: MapRef, photos: Sequence[Document], stats: Mapping[str, Any]) -> FoundObjects:
        with ExitStack() as stack:
            question = await asyncio.to_thread(self._question, ref, photos, stack)
            archive = await self._written("panoloc.core.changes", question)
        with zipfile.ZipFile(io.BytesIO(archive)) as opened:
            objects: list[Document] = json.loads(opened.read("objects.json"))
        return FoundObjects([{**each, "floor": floor_of(each, stats)} for each in objects], archive)

    def _question(self, ref: MapRef, photos: Sequence[Document], stack: ExitStack) -> Document:
        asked = []
        for photo in photos:
            try:
                asked.append({**photo, "image": self._copy(photo["key"], stack)})
            except StoredFileMissingError:  # its batch was deleted
                continue
        return {"points": self._copy(key_of(ref, "points.ply"), stack), "photos": asked}

    def _copy(self, key: str, stack: ExitStack) -> str:
        return str(stack.enter_context(self._storage.local_copy(key)))

    async def _written(self, module: str, document: Document, *options: str) -> bytes:
        async with self._turns:
            with await written_file(self._storage, module, document, *options) as file:
                return await asyncio.to_thread(file.read)


def floor_of(placed: Mapping[str, Any], stats: Mapping[str, Any]) -> int | None:
    """Return on which of the floors of a map an object stands, 0 the lowest; None where none is known."""
    levels = [floor["level_m"] for floor in stats.get("floors") or ()]
    bottom = placed["center_m"][2] - placed["size_m"][2] / 2 + _STEP_M
    return max(0, sum(level <= bottom for level in levels) - 1) if levels else None
