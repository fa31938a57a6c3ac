"""What a caller may say about a map."""

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, field_validator

from service.http.schemas.geometry import Box, Model

# No control characters: names and tags end up in logs, terminals and URLs.
_PRINTABLE = r"^[^\x00-\x1f\x7f]*$"

Name = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=200, pattern=_PRINTABLE)]
Tag = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=64, pattern=_PRINTABLE)]
Tags = Annotated[list[Tag], Field(max_length=32)]


class StartsOptions(Model):
    """Where the search starts."""

    method: Literal["octree", "grid"] = Field("octree", description="`octree` for rooms, `grid` for open spaces.")
    spacing_m: float | None = Field(
        None, ge=0.05, le=50, description="Distance of starts; null: chosen by the service."
    )
    region: Box | None = Field(None, description="Where cameras can be; null: everywhere inside the scanned space.")


class ScanOptions(Model):
    """How to read a scan and what to build from it."""

    unit: Literal["m", "cm", "mm", "ft"] = Field("m", description="Unit of the scan's coordinates.")
    up_axis: Literal["z", "y"] = Field("z", description="Axis of the scan that points up.")
    color_kind: Literal["rgb", "labels"] = Field("rgb", description="`labels`: colours are codes of classes.")
    starts: StartsOptions = Field(default_factory=lambda: StartsOptions.model_validate({}))


class Georeference(Model):
    """Where the map's origin lies on Earth (WGS 84)."""

    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=180)
    height_m: float = Field(0.0, ge=-20_000, le=100_000, description="Above the ellipsoid.")
    heading_deg: float = Field(
        0.0, ge=-360, le=360, description="Compass heading of the map's y axis, clockwise from north."
    )


class MapOptions(ScanOptions):
    """The part `options` of `POST /maps`."""

    name: Name | None = Field(None, description="For people; the file's name when left out.")
    tags: Tags = Field(default_factory=list, description="A query may name a tag instead of maps.")
    georeference: Georeference | None = None

    @field_validator("tags")
    @classmethod
    def _each_once(cls, tags: list[str]) -> list[str]:
        return list(dict.fromkeys(tags))

    def scan_options(self) -> dict[str, Any]:
        """Return what the worker has to know, JSON-safe."""
        return self.model_dump(mode="json", include=set(ScanOptions.model_fields))


class MapPatch(Model):
    """The body of `PATCH /maps/{id}`: fields left out stay as they are; `georeference: null` removes it."""

    name: Name = ""
    tags: Tags = Field(default_factory=list)
    georeference: Georeference | None = None

    @field_validator("tags")
    @classmethod
    def _each_once(cls, tags: list[str]) -> list[str]:
        return list(dict.fromkeys(tags))

    def changes(self) -> dict[str, Any]:
        """Return the fields that were given, JSON-safe."""
        return self.model_dump(mode="json", include=self.model_fields_set)


MAP_OPTIONS_EXAMPLE = {
    "name": "3rd floor",
    "tags": ["building 7"],
    "unit": "mm",
    "starts": {"method": "octree", "region": {"min": [0, 0, 0.5], "max": [12, 8, 2.2]}},
}
