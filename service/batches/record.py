"""One batch: what was asked, as it is stored; and the result of each image.

In storage: `batches/{id}/batch.json`, written once, last of all that an upload brings; `images/00000` and so on; `results/00000.json` as
each image is done. A record bears its own digest, and so does a result.
"""

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from typing import Any, Self, cast

from core.camera.camera import CameraDescription
from core.errors import OptionsError
from core.options import Hints, SessionOptions
from service.errors import StoredFileDamagedError
from service.jobs import QueryOptions

Result = dict[str, Any]
"""`status` of the query or "failed", and either `answer` (the body of `POST /localize`) or `error` (a problem document)."""

_FORMAT = 1


@dataclass(frozen=True)
class BatchRecord:
    """What was asked. Times are RFC 3339 in UTC.

    map_ids, tag: as in `service.maps.selection.MapChoice`. camera: of all images; None: each says so itself. names: of the images, each
    once, in their order. ignored: files of an archive that are no images by their names. tenant: see
    `service.keys.caller.Caller`.
    """

    id: str
    created_at: str
    map_ids: tuple[str, ...]
    tag: str | None
    options: QueryOptions
    camera: CameraDescription | None
    names: tuple[str, ...]
    ignored: tuple[str, ...] = ()
    tenant: str | None = None

    def to_json(self) -> bytes:
        """Return the record as stored."""
        record = dataclasses.asdict(self)
        if self.tenant is None:
            del record["tenant"]  # versions of before it read what does not need it
        return json.dumps({"format": _FORMAT, "sha256": _digest(record), "record": record}).encode()

    @classmethod
    def from_json(cls, data: bytes, key: str) -> Self:
        """Read what `to_json` wrote; key: for the message of StoredFileDamagedError."""
        try:
            document = json.loads(data)
            record = document["record"]
            if document["sha256"] != _digest(record):
                raise ValueError("its digest differs")
            camera = record.pop("camera")
            return cls(
                options=_options(record.pop("options")),
                camera=None if camera is None else CameraDescription(**_with_tuples(camera)),
                **_with_tuples(record),
            )
        except (ValueError, KeyError, TypeError, AttributeError, OptionsError) as error:
            raise StoredFileDamagedError(
                f"{key}: expected a batch as the service wrote it, but {error}; restore the file from a backup"
            ) from error


def result_to_json(result: Result) -> bytes:
    """Return a result as stored."""
    return json.dumps({"sha256": _digest(result), "result": result}, allow_nan=False).encode()


def result_from_json(data: bytes, key: str) -> Result:
    """Read what `result_to_json` wrote; key: for the message of StoredFileDamagedError."""
    try:
        document = json.loads(data)
        if "sha256" not in document and "status" in document:
            return cast(Result, document)  # of before results had digests
        if document["sha256"] != _digest(document["result"]):
            raise ValueError("its digest differs")
        return cast(Result, document["result"])
    except (ValueError, KeyError, TypeError) as error:
        raise StoredFileDamagedError(f"{key}: expected a result as the service wrote it, but {error}") from error


def folder_of(batch_id: str) -> str:
    """Return the prefix below which everything of a batch is stored."""
    return f"batches/{batch_id}"


def record_key(batch_id: str) -> str:
    """Return the key of the record."""
    return f"batches/{batch_id}/batch.json"


def image_key(batch_id: str, number: int) -> str:
    """Return the key of an image; number: from 0."""
    return f"batches/{batch_id}/images/{number:05}"


def results_prefix(batch_id: str) -> str:
    """Return the prefix of all results."""
    return f"batches/{batch_id}/results"


def result_key(batch_id: str, number: int) -> str:
    """Return the key of the result of an image."""
    return f"{results_prefix(batch_id)}/{number:05}.json"


def _options(stored: dict[str, Any]) -> QueryOptions:
    session, hints = SessionOptions(**stored.pop("session")), stored.pop("hints")
    given = None if hints is None else Hints(**_with_tuples(hints))
    return QueryOptions(session=session, hints=given, **_with_tuples(stored))


def _with_tuples(stored: dict[str, Any]) -> dict[str, Any]:
    return {name: _as_tuple(value) for name, value in stored.items()}


def _as_tuple(value: Any) -> Any:
    return tuple(_as_tuple(each) for each in value) if isinstance(value, list) else value


def _digest(record: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()
