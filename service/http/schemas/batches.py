"""Batches, the results of their images, and photos that people place by hand."""

from datetime import datetime
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from panoloc.core.survey.resection import LEAST_PAIRS, MOST_PAIRS
from panoloc.service.answer import Accuracy, ImageCamera, Localization, PoseAnswer, ResponseModel
from panoloc.service.http.schemas.maps import Name
from panoloc.service.http.schemas.operations import ProblemDocument
from panoloc.service.http.schemas.queries import (
    MAX_PRIOR_STD_DEG,
    MAX_PRIOR_STD_M,
    Camera,
    ExpectedPose,
    Hints,
    LocalizeOptions,
    RequestModel,
    Vector,
)

BatchStatus = Literal["queued", "running", "done"]
ItemStatus = Literal["waiting", "localized", "ambiguous", "not_localized", "failed"]
ROUGH_M, ROUGH_DEG = 0.5, 20.0
"""Standard deviations of a camera that somebody drags on a plan and turns."""
Pixel = Annotated[float, Field(ge=-1e6, le=1e6)]


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


class ClickedPair(RequestModel):
    """A point of the scan, and where the photo shows it."""

    pixel: Annotated[list[Pixel], Field(min_length=2, max_length=2)] = Field(
        description="Pixels to the right and down from the top left corner of the photo as it is seen (EXIF orientation applied), in its "
        "full size."
    )
    position_m: Vector = Field(description="The point in the map's own frame.")


def _is_a_choice(value: object) -> object:
    # Else each of both types would be refused by itself, under a name of its own.
    if isinstance(value, bool) or value in ("given", "refined"):
        return value
    raise ValueError('expected true, false, "given" or "refined"')


class HandPose(RequestModel):
    """The body of `POST /batches/{id}/images/{number}/pose`: a rough pose, or pairs of clicked points."""

    map_id: str | None = Field(
        None, max_length=80, description="Map of the pose; needed only where the batch has searched several."
    )
    pose: ExpectedPose | None = Field(None, description="A rough pose.")
    position_std_m: Annotated[float, Field(gt=0, le=MAX_PRIOR_STD_M)] = Field(
        ROUGH_M, description="Of `pose`: how far off it may be, as standard deviation of each coordinate."
    )
    orientation_std_deg: Annotated[float, Field(gt=0, le=MAX_PRIOR_STD_DEG)] = Field(
        ROUGH_DEG, description="Of `pose`: standard deviation of the rotation about each axis."
    )
    pairs: Annotated[list[ClickedPair], Field(min_length=LEAST_PAIRS, max_length=MOST_PAIRS)] | None = Field(
        None, description="Instead of `pose`: points clicked in photo and scan. Four or more show mistakes."
    )
    refine: bool = Field(
        True, description="Refine the pose on photo and scan; false: it stays as it is set, or as the pairs say."
    )
    confirm: Annotated[bool | Literal["given", "refined"], BeforeValidator(_is_a_choice)] = Field(
        False,
        description="Store the result: true, the pose that `better` names; or the given or the refined one. Otherwise nothing is stored.",
    )

    @model_validator(mode="after")
    def _is_one_of_both(self) -> Self:
        if (self.pose is None) == (self.pairs is None):
            got = "neither" if self.pose is None else "both"
            raise ValueError(f"expected either pose or pairs, got {got}; send one of them")
        return self


class PlacedPose(ResponseModel):
    """A pose, and what speaks for it."""

    pose: PoseAnswer
    camera: ImageCamera = Field(
        description="Camera of the photo at this pose: the refined pose may have another field of view than the photo states."
    )
    residuals_px: list[float] | None = Field(
        description="Of each pair: pixels between where the point was clicked and where this pose shows it; null without pairs."
    )
    rms_px: float | None
    agreement: float | None = Field(
        description="Correlation of the photo with the scan rendered at the pose, -1 to 1; null if unknown."
    )
    confidence: float = Field(
        ge=0,
        le=1,
        description="As in an answer; of pairs by their geometry, lowered where the engine doubts them; 0 if nothing measures it.",
    )
    accuracy: Accuracy | None
    warnings: list[str]


class HandPlacement(ResponseModel):
    """What comes of a pose or of pairs."""

    given: PlacedPose = Field(description="The pose as it was sent, or as the pairs say.")
    refined: PlacedPose | None = Field(
        description="Refined by the engine, which searches nowhere else; null without `refine`, and where the scan shows nothing."
    )
    better: Literal["given", "refined"] = Field(
        description="Which of both to take: `given` where the refined pose leaves the clicked points, or the scan hardly supports it."
    )
    moved_m: float | None = Field(description="From the given to the refined position.")
    moved_deg: float | None
    item: BatchItem = Field(description="The photo as the batch has it now; changed only by `confirm`.")
