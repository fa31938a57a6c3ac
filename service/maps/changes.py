"""Changes that answers saw since a map's scan, kept for a lifetime, so that it shows where several of them agree.

In storage: `changes/{map}/{time}-{answer}-{images}.json`, beside the maps and not in them: an answer that comes in
while its map is being deleted leaves nothing in the folder of that map. {images} is a digest: the same images sent
again are no second witness.
"""

import asyncio
import base64
import hashlib
import json
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from panoloc.service.answer import Document, in_map_axes
from panoloc.service.errors import StorageError
from panoloc.service.jobs import MapRef
from panoloc.service.storage import Storage

MOST_ANSWERS = 200
"""Of a map; older ones make room."""

_LIFETIME_S = 30 * 24 * 3600  # for which an answer counts
Cell = tuple[int, int, int]


class ChangeLog:
    """Used from one event loop; the files are read and written in threads."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    async def note(self, answer: Document, cells: dict[str, Any] | None, images: Sequence[bytes]) -> None:
        """Keep what an answer to images saw, in place of an earlier answer to the same ones.

        cells: see `panoloc.service.worker.answers.change_cells`; None: nothing.
        """
        if cells is not None and answer["map_id"] is not None:
            await asyncio.to_thread(self._note, answer, cells, images)

    async def document(self, ref: MapRef, origin_offset: list[float]) -> Document:
        """Return the body of `GET /maps/{id}/changes` for the revision that answers queries."""
        return await asyncio.to_thread(self._document, ref, origin_offset)

    async def forget(self, map_id: str) -> None:
        """Delete everything about a map."""
        await asyncio.to_thread(self._storage.delete_all, _folder_of(map_id))

    def _note(self, answer: Document, cells: dict[str, Any], images: Sequence[bytes]) -> None:
        now = datetime.now(UTC)
        kept = {
            "revision": answer["map_revision"],
            "cells": cells,
            "answer": {
                "id": answer["id"],
                "created_at": now.isoformat(timespec="seconds").replace("+00:00", "Z"),
                "position_m": _position_of(answer["pose"]),
                "confidence": answer["confidence"],
                **answer["change"],
            },
        }
        folder, same_images = _folder_of(answer["map_id"]), f"-{_digest_of(images)}.json"
        name = f"{_time_stamp(now)}-{answer['id']}{same_images}"
        self._storage.replace(f"{folder}/{name}", json.dumps(kept).encode())
        names = self._storage.names(folder)
        again = [each for each in names if each.endswith(same_images) and each != name]
        others = [each for each in names if each not in again]
        oldest = _oldest()
        for each in (*again, *(each for each in others if each < oldest or each in others[:-MOST_ANSWERS])):
            self._storage.delete(f"{folder}/{each}")

    def _document(self, ref: MapRef, origin_offset: list[float]) -> Document:
        seen: Counter[Cell] = Counter()
        changed: Counter[Cell] = Counter()
        last: dict[Cell, str] = {}
        answers, cell_m = [], 0.0
        for kept in self._kept(ref):
            cell_m = kept["cells"]["cell_m"]
            answers.append(kept["answer"])
            seen.update(_unpacked(kept["cells"]["seen"]))
            found = _unpacked(kept["cells"]["changed"])
            changed.update(found)
            last |= dict.fromkeys(found, kept["answer"]["created_at"])
        return {
            "map_id": ref.id,
            "revision": ref.revision,
            "lifetime_s": _LIFETIME_S,
            "cell_m": cell_m or None,
            "answers": answers[::-1],
            "cells": [
                {
                    "center_m": [
                        round((place + 0.5) * cell_m + offset, 3)
                        for place, offset in zip(cell, origin_offset, strict=True)
                    ],
                    "num_changed": count,
                    "num_seen": seen[cell],
                    "last_changed_at": last[cell],
                }
                for cell, count in changed.most_common()
            ],
        }

    def _kept(self, ref: MapRef) -> Iterator[dict[str, Any]]:
        """Yield what is kept of a revision and counts, oldest first."""
        folder, oldest = _folder_of(ref.id), _oldest()
        for name in self._storage.names(folder):
            if name < oldest:
                continue
            try:
                kept = json.loads(self._storage.read(f"{folder}/{name}"))
            except (StorageError, ValueError):  # just deleted by another answer, or damaged: the others are enough
                continue
            if kept["revision"] == ref.revision:
                yield kept


def _position_of(pose: Document) -> list[float]:
    """Return the position of a photo in the map's own axes, whatever axes the answer has."""
    return list(in_map_axes(list(pose["map_from_camera"]["position_m"].values()), pose["frame"]))


def _folder_of(map_id: str) -> str:
    return f"changes/{map_id}"


def _digest_of(images: Sequence[bytes]) -> str:
    """Return a digest of images in their order."""
    return hashlib.sha256(b"".join(hashlib.sha256(image).digest() for image in images)).hexdigest()[:16]


def _oldest() -> str:
    """Return what the names of answers that still count are not below."""
    return _time_stamp(datetime.now(UTC) - timedelta(seconds=_LIFETIME_S))


def _time_stamp(time: datetime) -> str:
    return time.strftime("%Y%m%dT%H%M%S%f")


def _unpacked(packed: str) -> list[Cell]:
    cells = np.frombuffer(zlib.decompress(base64.b64decode(packed)), "<i2").reshape(-1, 3)
    return [(x, y, z) for x, y, z in cells.tolist()]
