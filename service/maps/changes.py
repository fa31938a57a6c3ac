"""Changes that answers saw since a map's scan, kept for a lifetime, so that it shows where several of them agree.

In storage: `changes/{map}/{time}-{answer}-{images}.json`, beside the maps and not in them: an answer that comes in
while its map is being deleted leaves nothing in the folder of that map. {images} is a digest: the same images sent
again are no second witness. A small photo, where one may be kept, lies in `change-photos/{batch}/`, and goes with its
answer or its batch. A batch that took the answer over has the photo itself.
"""

import base64
import hashlib
import json
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Any

import numpy as np

from panoloc.service.answer import Document
from panoloc.service.errors import InvalidOptionsError, StorageError
from panoloc.service.jobs import ChangePhoto, MapRef
from panoloc.service.storage import Storage

MOST_ANSWERS = 200
"""Of a map; older ones make room."""

_LIFETIME_S = 30 * 24 * 3600  # for which an answer counts
_NO_BATCH = "queries"  # of photos that belong to none
Cell = tuple[int, int, int]


@dataclass(frozen=True)
class Period:
    """The answers from `since` to `until`, which have a time zone; None: from the first that still counts, to the last."""

    since: datetime | None = None
    until: datetime | None = None

    @classmethod
    def between(cls, since: str | None, until: str | None) -> "Period":
        """Return the period between two times (RFC 3339), or days (UTC), which count whole. Raises InvalidOptionsError."""
        period = cls(_time_of("since", since, time.min), _time_of("until", until, time.max))
        if period.since is not None and period.until is not None and period.since > period.until:
            raise InvalidOptionsError.of(
                "since", f"expected a time before until, got {since} after {until}; exchange them, or leave one out"
            )
        return period

    def has(self, moment: datetime) -> bool:
        """Tell whether a time lies in the period."""
        return (self.since is None or moment >= self.since) and (self.until is None or moment <= self.until)


class ChangeLog:
    """Blocking; of any thread."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    def note(
        self,
        answer: Document,
        cells: dict[str, Any] | None,
        images: Sequence[bytes],
        photo: ChangePhoto | None = None,
        batch_id: str | None = None,
    ) -> None:
        """Keep what an answer to images saw, in place of an earlier answer to the same ones.

        cells: see `panoloc.service.worker.answers.change_cells`; None: nothing. photo: what may be kept of the images.
        """
        if cells is None or answer["map_id"] is None:
            return
        now = datetime.now(UTC)
        kept = {
            "revision": answer["map_revision"],
            "cells": cells,
            "photo": photo and self._keep(photo, f"{batch_id or _NO_BATCH}/{answer['id']}.webp"),
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
            self._delete(f"{folder}/{each}")

    def note_batch(self, answer: Document, key: str, camera: Document | None) -> None:
        """Remember that a batch has the image of an answer, under a key in storage.

        camera: of the batch; None: the image says so itself.
        """
        cameras = [image["camera"]["model"] for image in answer["images"]]
        # A distortion is not in the answer.
        is_known = camera is not None or not cameras[0].startswith("opencv")
        if answer["status"] != "localized" or len(cameras) > 1 or not is_known:
            return
        folder = _folder_of(answer["map_id"])
        for name in self._storage.names(folder):
            if f"-{answer['id']}-" not in name:
                continue
            kept = json.loads(self._storage.read(f"{folder}/{name}"))
            if kept["photo"] and _is_own(kept["photo"]):
                continue
            motion = answer["pose"]["map_from_camera"]
            kept["photo"] = {
                "key": key,
                "position_m": [motion["position_m"][axis] for axis in "xyz"],
                "quaternion_xyzw": [motion["quaternion"][axis] for axis in "xyzw"],
                "frame": answer["pose"]["frame"],
                "found_camera": answer["images"][0]["camera"],
                "camera": camera,
            }
            self._storage.replace(f"{folder}/{name}", json.dumps(kept).encode())

    def photos(self, ref: MapRef, period: Period) -> list[Document]:
        """Return what is kept of the photos of a revision, oldest first: `key` in storage, `position_m`, `quaternion_xyzw`, `time`."""
        kept = [each for each in self._kept(ref, period) if each.get("photo")]
        folders = {each["photo"]["key"].rpartition("/")[0] for each in kept}
        there = {f"{folder}/{name}" for folder in folders for name in self._storage.names(folder)}
        # Those of a batch that was deleted are gone.
        found = [{**each["photo"], "time": each["answer"]["created_at"]} for each in kept]
        return [photo for photo in found if photo["key"] in there]

    def forget(self, map_id: str) -> None:
        """Delete everything about a map."""
        folder = _folder_of(map_id)
        for name in self._storage.names(folder):
            self._delete(f"{folder}/{name}")
        self._storage.delete_all(folder)

    def forget_batch(self, batch_id: str) -> None:
        """Delete what is kept of the photos of a batch; the cells that they saw changed stay."""
        self._storage.delete_all(f"change-photos/{batch_id}")

    def _keep(self, photo: ChangePhoto, name: str) -> Document:
        """Store a photo, and return what is said of it."""
        key = f"change-photos/{name}"
        self._storage.replace(key, photo.webp)
        return {"key": key, "position_m": photo.position_m, "quaternion_xyzw": photo.quaternion_xyzw}

    def _delete(self, key: str) -> None:
        """Delete what is kept of an answer, its photo first."""
        try:
            photo = json.loads(self._storage.read(key)).get("photo")
        except (StorageError, ValueError):
            photo = None
        if photo and _is_own(photo):
            self._storage.delete(photo["key"])
        self._storage.delete(key)

    def document(self, ref: MapRef, origin_offset: list[float], period: Period) -> Document:
        """Return the body of `GET /maps/{id}/changes`, but for its objects, for the revision that answers queries."""
        seen: Counter[Cell] = Counter()
        changed: Counter[Cell] = Counter()
        last: dict[Cell, str] = {}
        answers, cell_m = [], 0.0
        for kept in self._kept(ref, period):
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

    def _kept(self, ref: MapRef, period: Period) -> Iterator[dict[str, Any]]:
        """Yield what is kept of a revision and counts in a period, oldest first."""
        folder, oldest = _folder_of(ref.id), _oldest()
        for name in self._storage.names(folder):
            if name < oldest:
                continue
            try:
                kept = json.loads(self._storage.read(f"{folder}/{name}"))
            except (StorageError, ValueError):  # just deleted by another answer, or damaged: the others are enough
                continue
            if kept["revision"] == ref.revision and period.has(datetime.fromisoformat(kept["answer"]["created_at"])):
                yield kept


def _is_own(photo: Document) -> bool:
    """Tell whether a photo is a small one of this log, not an image of a batch."""
    return bool(photo["key"].startswith("change-photos/"))


def _position_of(pose: Document) -> list[float]:
    """Return the position of a photo in the map's own axes, z up: webxr has (x, z, −y) of the map, unity (x, z, y)."""
    first, second, third = pose["map_from_camera"]["position_m"].values()
    in_map = {"webxr": [first, -third, second], "unity": [first, third, second]}
    return in_map.get(pose["frame"], [first, second, third])


def _folder_of(map_id: str) -> str:
    return f"changes/{map_id}"


def _digest_of(images: Sequence[bytes]) -> str:
    """Return a digest of images in their order."""
    return hashlib.sha256(b"".join(hashlib.sha256(image).digest() for image in images)).hexdigest()[:16]


def _oldest() -> str:
    """Return what the names of answers that still count are not below."""
    return _time_stamp(datetime.now(UTC) - timedelta(seconds=_LIFETIME_S))


def _time_stamp(moment: datetime) -> str:
    return moment.strftime("%Y%m%dT%H%M%S%f")


def _unpacked(packed: str) -> list[Cell]:
    cells = np.frombuffer(zlib.decompress(base64.b64decode(packed)), "<i2").reshape(-1, 3)
    return [(x, y, z) for x, y, z in cells.tolist()]


def _time_of(field: str, text: str | None, of_day: time) -> datetime | None:
    """Return a time; of_day: for a date alone."""
    if text is None:
        return None
    with suppress(ValueError):
        return datetime.combine(date.fromisoformat(text), of_day, UTC)
    with suppress(ValueError):
        if (found := datetime.fromisoformat(text)).tzinfo is not None:
            return found
    raise InvalidOptionsError.of(
        field,
        "expected a date such as 2026-11-21, or a time with its zone such as 2026-11-21T12:00:00Z (in a URL, a + is "
        f"%2B), got {text[:40]!r}",
    )
