"""One batch: the request, as it is stored; and the result of each image.

In storage: `batches/{id}/batch.json`, written once, last of all that an upload brings; `images/00000` and so on;
`results/00000.json` as each image is done. All but images contain their own digest, see
`panoloc.service.storage.sealed_json`.
"""

from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass

from panoloc.core.camera.camera import CameraDescription
from panoloc.service.jobs import QueryOptions, Result


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class BatchRecord:
    """The request. Times are RFC 3339 in UTC.

    map_ids, tag: as in `panoloc.service.maps.selection.MapChoice`. camera: of all images; None: each says so itself.
    names: of the images, each once, in their order. ignored: files of an archive that are no images by their names.
    tenant: see `panoloc.service.keys.caller.Caller`.
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


BATCH = TypeAdapter(BatchRecord)
RESULT: TypeAdapter[Result] = TypeAdapter(Result)


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
