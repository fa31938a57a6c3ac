"""Batches and the results of their images."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from panoloc.service.answer import Localization, ResponseModel
from panoloc.service.http.schemas.maps import Name
from panoloc.service.http.schemas.operations import ProblemDocument
from panoloc.service.http.schemas.queries import Camera, Hints, LocalizeOptions, RequestModel

BatchStatus = Literal["queued", "running", "done"]
ItemStatus = Literal["waiting", "localized", "ambiguous", "not_localized", "failed"]


class BatchHints(Hints):
    """Hints for each image of a batch."""

    prior: None = Field(None, description="Not in a batch: each image was taken elsewhere.")


class BatchOptions(LocalizeOptions):
    """The part `options` of `POST /batches`: as for `POST /localize`, but without pictures and sessions.

    Also the name of the batch, and answers that its images already have.
    """

    cameras: Annotated[list[Camera], Field(min_length=1, max_length=1)] | None = Field(
        None,
        description="Camera of all images, one entry. Without it, the camera comes from the metadata of each image.",
    )
    hints: BatchHints | None = None
    session: None = Field(
        None, description="Not in a batch: each image is a separate query; send sessions to `POST /localize`."
    )
    name: Name | None = Field(
        None, description="For people; default: the name of the archive or of the images' folder, else the time."
    )
    answers: list[str | None] | None = Field(
        None,
        description="Ids of answers to `POST /localize` that the parts `image` already have, in their order; null where "
        "there is none. Answers that the service still has are kept; the other images are localized.",
    )
    artifacts: list[Any] = Field(
        default_factory=list, max_length=0, description="Not in a batch: a batch stores no pictures."
    )


class BatchPatch(RequestModel):
    """The body of `PATCH /batches/{id}`."""

    name: Name


class BatchCounts(ResponseModel):
    """Number of images by status."""

    waiting: int
    localized: int
    ambiguous: int
    not_localized: int
    failed: int


class BatchItem(ResponseModel):
    """One image."""

    number: int = Field(ge=0, description="Its place in the upload.")
    name: str
    status: ItemStatus
    answer: Localization | None = Field(
        description="As from `POST /localize`; null while the image waits, or if it failed."
    )
    error: ProblemDocument | None


class BatchOverview(ResponseModel):
    """A batch in a list."""

    id: str
    name: str
    status: BatchStatus
    created_at: datetime
    map_ids: list[str]
    tag: str | None
    num_images: int
    progress: float = Field(ge=0, le=1)


class BatchPage(ResponseModel):
    """A page of the caller's batches."""

    items: list[BatchOverview]
    next_cursor: str | None = Field(description="Send it as `cursor` for the next page; null on the last one.")


class Batch(BatchOverview):
    """Images that are localized one by one; a batch survives restarts of the service."""

    counts: BatchCounts
    ignored: list[str] = Field(description="Files of the archive whose names are not those of images; at most 100.")
    items: list[BatchItem] = Field(
        description="A page of the images, in their order; empty in the answer to `POST /batches`."
    )
    next_cursor: str | None = Field(description="Send it as `cursor` for the next page; null on the last one.")
