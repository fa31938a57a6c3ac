"""Placed photos, ready to be written, and the files that come of them."""

import json
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pi_heif import register_heif_opener
from PIL import Image

from panoloc.core.earth.geopose import Georeference
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.conversion import converted
from panoloc.core.image.image_header import IMAGE, image_kind
from panoloc.core.options import MAX_PIXELS

TIME_DECIMALS = 6
"""Of seconds since 1970: a double holds no more."""
_LARGE_M = 1000.0  # single precision resolves 0.06 mm there
_EXIF_IFD, _TAKEN, _TAKEN_OFFSET, _TAKEN_FRACTION, _ORIENTATION = 0x8769, 0x9003, 0x9011, 0x9291, 0x0112
_ON_ITS_SIDE = (5, 6, 7, 8)
_FIRST_BYTES = {".jpg": b"\xff\xd8\xff", ".jpeg": b"\xff\xd8\xff", ".png": b"\x89PNG"}


@dataclass(frozen=True)
class PlacedPhoto:
    """A photo with its pose.

    name: of its file, with `/` between folders, unique in its tour. map_from_camera: in the map's own frame, metres.
    width, height: pixels. is_sphere: a full equirectangular panorama. camera_model, hfov_deg: as in an answer. time_unix_s: when it
    was taken, None where unknown; of a camera whose clock does not name its offset from UTC as if that was none, with is_local_time.
    position_radius_m, orientation_radius_deg: 68 % radii, None where unknown. image: the file, None without one. is_converted: it
    was made of the photo, so that an export has to hold it. is_by_hand: a person has placed it.
    """

    name: str
    map_from_camera: Pose
    width: int
    height: int
    is_sphere: bool = True
    camera_model: str = "equirectangular"
    hfov_deg: float = 360.0
    time_unix_s: float | None = None
    is_local_time: bool = False
    confidence: float = 1.0
    position_radius_m: float | None = None
    orientation_radius_deg: float | None = None
    image: Path | None = None
    is_converted: bool = False
    is_by_hand: bool = False


@dataclass(frozen=True)
class LeftOut:
    """A photo that is not written, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Tour:
    """Photos of one map.

    coordinate_system: of the map's positions, by EPSG code or WKT; a georeference takes precedence. geoid_undulation_m:
    height of the geoid above the ellipsoid there, None where unknown. floor_levels_m: of the floors that were found in the
    scan, bottom up, in the map's frame. title: the name of the map, for people. created_unix_s: when the photos were placed; stands
    for the time of a photo where a format needs one. scan: a PLY with the points of the map in its own frame, for formats
    that hold points. survey: the original scan, an E57 in the map's own frame, which the export as E57 copies. page: folder with the
    built page of the walk-through. lacks: what cannot be in the export, and why; None: nothing.
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
    floor_levels_m: tuple[float, ...] = ()
    title: str = ""
    page: Path | None = None
    lacks: str | None = None

    @property
    def times_unix_s(self) -> list[float]:
        """Return a time per photo: when it was taken; 0, 1, 2 … for all where that is not known of each."""
        known = [photo.time_unix_s for photo in self.photos if photo.time_unix_s is not None]
        return known if len(known) == len(self.photos) else [float(number) for number in range(len(self.photos))]

    @property
    def positions(self) -> NDArray[np.float64]:
        """Return where the photos are, (n, 3)."""
        return np.array([photo.map_from_camera.position for photo in self.photos]).reshape(-1, 3)

    @property
    def offset_m(self) -> NDArray[np.float64]:
        """Return (3,), in whole metres: what to take from positions for readers in single precision, zero near the origin.

        Survey coordinates, in the millions, would be half a metre off in such readers.
        """
        positions = self.positions
        if not len(positions) or np.abs(positions).max() <= _LARGE_M:
            return np.zeros(3)
        return np.asarray(np.rint((positions.min(axis=0) + positions.max(axis=0)) / 2))


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


def plain(value: float, decimals: int = 9) -> str:
    """Return a number as text without an exponent, without zeros at its end and without a negative zero."""
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text


def why_not_as_named(photo: PlacedPhoto) -> str | None:
    """Return why a photo that is called a JPEG or PNG is none, None when it is: its name may lie. Raises OSError."""
    assert photo.image is not None
    ending = PurePosixPath(photo.name).suffix.lower()
    with photo.image.open("rb") as stream:
        if stream.read(4).startswith(_FIRST_BYTES[ending]):
            return None
    return f"its content does not match {ending}; rename it to match its content"


def read_tour(path: Path, folder: Path) -> Tour:
    """Return the tour that a JSON file describes: the input of the process that writes exports.

    folder: gets a JPEG of each panorama in HEIC or AVIF, which other systems do not read; its name gets a second ending, `a.heic.jpg`.

    {"name": "map_…", "created_unix_s": 0, "georeference": null | {…}, "coordinate_system": null | "EPSG:25832",
     "geoid_undulation_m": null | 46.2, "scan": null | "points.ply", "survey": null | "scan.e57",
     "floor_levels_m": [0.0], "title": "Office", "page": null | "…/walk",
     "photos": [{"name": "a.jpg", "image": "/…/00000", "frame": "ros", "position_m": [x, y, z],
                 "quaternion_xyzw": [x, y, z, w], "camera_model": "equirectangular", "hfov_deg": 360,
                 "confidence": 0.9,
                 "position_radius_m": 0.02, "orientation_radius_deg": 0.3}],
     "left_out": [{"name": "b.jpg", "reason": "not_localized"}]}

    Sizes and times are read from the photos. Raises OSError and PanoramaDamagedError for photos that cannot be opened.
    """
    # What is here has been placed, so that its decoder has read it in its sandbox.
    register_heif_opener()
    document = json.loads(path.read_text(encoding="utf-8"))
    place = document["georeference"]
    given = {
        **document,
        "photos": tuple(_photo(folder, **each) for each in document["photos"]),
        "left_out": tuple(LeftOut(**each) for each in document["left_out"]),
        "georeference": None if place is None else Georeference(**place),
        "floor_levels_m": tuple(document["floor_levels_m"]),
        **{name: None if document[name] is None else Path(document[name]) for name in ("scan", "survey", "page")},
    }
    return Tour(**given)


def _photo(
    folder: Path,
    *,
    name: str,
    image: str,
    frame: Any,
    position_m: list[float],
    quaternion_xyzw: list[float],
    camera_model: str,
    **given: Any,
) -> PlacedPhoto:
    # More pixels than Pillow likes were accepted when the photo was placed; nothing is decoded here.
    Image.MAX_IMAGE_PIXELS = None
    with Image.open(image) as opened:
        exif = opened.getexif()
        width, height = opened.size
        time_unix_s, is_local_time = _time_taken(exif.get_ifd(_EXIF_IFD))
    if exif.get(_ORIENTATION) in _ON_ITS_SIDE:
        width, height = height, width
    is_sphere, file = camera_model == "equirectangular" and width == 2 * height, Path(image)
    is_converted = is_sphere and opened.format in ("HEIF", "AVIF")
    if is_converted:
        file = folder / uuid.uuid4().hex
        data = converted(Path(image).read_bytes(), IMAGE, MAX_PIXELS)
        file.write_bytes(data)
        name += ".png" if image_kind(data) == "png" else ".jpg"
    return PlacedPhoto(
        name=name,
        map_from_camera=Pose.from_frame(position_m, quaternion_xyzw, frame),
        width=width,
        height=height,
        is_sphere=is_sphere,
        camera_model=camera_model,
        time_unix_s=time_unix_s,
        is_local_time=is_local_time,
        image=file,
        is_converted=is_converted,
        **given,
    )


def _time_taken(exif: dict[int, Any]) -> tuple[float | None, bool]:
    """Return when a photo was taken in Unix seconds, None where unknown, and whether its clock names no offset and counts as UTC here."""
    text, offset, fraction = (str(exif.get(tag, "")).strip("\x00 ") for tag in (_TAKEN, _TAKEN_OFFSET, _TAKEN_FRACTION))
    # Cameras that do not know their offset write spaces and a colon.
    has_offset = any(letter.isdigit() for letter in offset)
    try:
        taken = datetime.strptime(text + (offset if has_offset else "+00:00"), "%Y:%m:%d %H:%M:%S%z")
        return taken.astimezone(UTC).timestamp() + float(f"0.{fraction or 0}"), not has_offset
    except ValueError:
        return None, False
