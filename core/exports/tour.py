"""Placed photos, ready to be written, and the files that come of them."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panoloc.core.geometry.pose import Pose


@dataclass(frozen=True)
class PlacedPhoto:
    """A photo with its pose.

    name: of its file, with `/` between folders, unique in its tour. map_from_camera: in the map's own frame, metres.
    width, height: pixels. is_sphere: a full equirectangular panorama. time_unix_s: when it was taken, None where unknown.
    position_radius_m, orientation_radius_deg: 68 % radii, None where unknown. image: the file, None without one.
    """

    name: str
    map_from_camera: Pose
    width: int
    height: int
    is_sphere: bool = True
    time_unix_s: float | None = None
    confidence: float = 1.0
    position_radius_m: float | None = None
    orientation_radius_deg: float | None = None
    image: Path | None = None


@dataclass(frozen=True)
class LeftOut:
    """A photo that is not written, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Georeference:
    """Where a map lies on Earth: WGS 84, its origin's height above the ellipsoid, the compass heading of its y axis."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    heading_deg: float


@dataclass(frozen=True)
class Tour:
    """Photos of one map.

    coordinate_system: of the map's positions, by EPSG code or WKT; a georeference takes precedence. geoid_undulation_m:
    height of the geoid above the ellipsoid there, None where unknown. created_unix_s: when the photos were placed; stands
    for the time of a photo where a format needs one. scan: a PLY with the points of the map in its own frame, for formats
    that hold points. survey: the original scan, an E57 in the map's own frame, which the export as E57 copies.
    """

    name: str
    photos: tuple[PlacedPhoto, ...]
    left_out: tuple[LeftOut, ...] = ()
    georeference: Georeference | None = None
    created_unix_s: float = 0.0
    coordinate_system: str | None = None
    scan: Path | None = None
    survey: Path | None = None
    geoid_undulation_m: float | None = None

    @property
    def times_unix_s(self) -> list[float]:
        """Return a time per photo: when it was taken; 0, 1, 2 … for all where that is not known of each."""
        known = [photo.time_unix_s for photo in self.photos if photo.time_unix_s is not None]
        return known if len(known) == len(self.photos) else [float(number) for number in range(len(self.photos))]


@dataclass(frozen=True)
class ExportedFile:
    """A file to write. path: below the folder or in the zip, with `/`. content: its bytes, or a file that has them."""

    path: str
    content: bytes | Path


def json_file(path: str, document: Any) -> ExportedFile:
    """Return a document as a file of JSON."""
    return ExportedFile(path, (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())


def text_file(path: str, lines: Iterable[str]) -> ExportedFile:
    """Return lines as a text file."""
    return ExportedFile(path, "".join(f"{line}\n" for line in lines).encode())
