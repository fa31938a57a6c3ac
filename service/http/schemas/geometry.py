"""Numbers and boxes that several models share; metres."""

from typing import Annotated, Self, cast

from pydantic import BaseModel, ConfigDict, Field, model_validator

from panoloc.core import options
from panoloc.core.options import FARTHEST_M

Coordinate = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M, allow_inf_nan=False)]
Vector = Annotated[list[Coordinate], Field(min_length=3, max_length=3, description="x, y, z")]


class RequestModel(BaseModel):
    """A model of a request. Unknown fields are errors, so that a misspelt one is not ignored."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Box(RequestModel):
    """A box along the axes of the map's own frame, metres."""

    min: Vector
    max: Vector

    @model_validator(mode="after")
    def _has_volume(self) -> Self:
        if not all(low < high for low, high in zip(self.min, self.max, strict=True)):
            raise ValueError(f"expected min below max on every axis, got min {self.min} and max {self.max}")
        return self

    def to_options(self) -> options.Box:
        """Return the box for the worker."""
        return cast(options.Box, (tuple(self.min), tuple(self.max)))
