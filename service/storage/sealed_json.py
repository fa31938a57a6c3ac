"""Records as JSON with a digest of their own, because they are replaced in one step."""

import hashlib
import json
from typing import Any, TypeVar

from pydantic import TypeAdapter

from panoloc.core.errors import OptionsError
from panoloc.service.errors import StoredFileDamagedError

Record = TypeVar("Record")


def seal(kind: TypeAdapter[Record], record: Record) -> bytes:
    """Return a record as stored."""
    document = kind.dump_python(record, mode="json")
    return json.dumps({"sha256": _digest(document), "record": document}, allow_nan=False).encode()


def unseal(kind: TypeAdapter[Record], data: bytes, key: str) -> Record:
    """Return what `seal` was given; key: for the message of StoredFileDamagedError."""
    try:
        sealed = json.loads(data)
        if sealed["sha256"] != _digest(sealed["record"]):
            raise ValueError("its digest differs")
        return kind.validate_python(sealed["record"])
    except (ValueError, KeyError, TypeError, OptionsError) as error:
        raise StoredFileDamagedError(
            f"{key}: expected an unchanged record of the service, but {error}; restore the file from a backup"
        ) from error


def _digest(document: Any) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
