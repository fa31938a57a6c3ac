"""The control points of maps, as they were sent, and what they say of a map.

In storage: `control/{map}.json`, beside the maps and not in them, as changes are. It contains its own digest.
"""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass

from panoloc.core.survey.control_check import ControlCheck, check_control, georeference_document
from panoloc.core.survey.control_csv import ControlPoint
from panoloc.service.answer import Document
from panoloc.service.errors import StoredFileMissingError
from panoloc.service.jobs import MapRef
from panoloc.service.maps.record import MapRecord, bounds_of, place_on_earth
from panoloc.service.maps.selection import serving_ref
from panoloc.service.storage import Storage
from panoloc.service.storage.sealed_json import seal, unseal


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class ControlPoints:
    """Points of a map. coordinate_system, geoid_undulation_m: as `check_control` takes them. revision: of the scan in which they lie."""

    points: list[ControlPoint] = field(default_factory=list)
    coordinate_system: str | None = None
    geoid_undulation_m: float | None = None
    revision: int | None = None


_FAR_M = 50.0  # from a scan, where nobody clicks in it
_STORED = TypeAdapter(ControlPoints)


class ControlBook:
    """Used from one event loop; files are read and written in threads."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage

    async def read(self, map_id: str) -> ControlPoints:
        """Return the points of a map, none where nobody has sent any. Raises StorageError."""
        try:
            data = await asyncio.to_thread(self._storage.read, _key_of(map_id))
        except StoredFileMissingError:
            return ControlPoints()
        return unseal(_STORED, data, _key_of(map_id))

    async def write(self, ref: MapRef, sent: ControlPoints) -> ControlPoints:
        """Store points over the former ones, and return them. One without a place in the scan keeps the one that its name had there."""
        former = await self.read(ref.id)
        places = {} if former.revision != ref.revision else {each.name: each.position_m for each in former.points}
        points = [
            each if each.position_m is not None else replace(each, position_m=places.get(each.name))
            for each in sent.points
        ]
        kept = replace(sent, points=points, revision=ref.revision)
        await asyncio.to_thread(self._storage.replace, _key_of(ref.id), seal(_STORED, kept))
        return kept

    async def forget(self, map_id: str) -> None:
        """Delete the points of a map."""
        await asyncio.to_thread(self._storage.delete, _key_of(map_id))


def control_document(record: MapRecord, kept: ControlPoints) -> Document:
    """Return the body of `GET /maps/{id}/control-points`. Blocking. Raises OptionsError, MapNotReadyError and MapUnusableError."""
    ref = serving_ref(record)
    found = check_control(kept.points, kept.coordinate_system, kept.geoid_undulation_m, place_on_earth(record))
    used = [point.name for point in kept.points if point.position_m is not None]
    warnings = list(found.warnings)
    if kept.points and kept.revision != ref.revision:
        warnings.append(
            f"the places in the scan are of revision {kept.revision}, and revision {ref.revision} serves; click them again"
        )
    if far := _far(kept.points, bounds_of(record)):
        warnings.append(
            f"{', '.join(far[:5])}: the place in the scan is more than {_FAR_M:g} m outside of the scan; check its unit and columns"
        )
    return {
        "map_id": ref.id,
        "revision": ref.revision,
        "is_on_earth": found.is_on_earth,
        "coordinate_system": kept.coordinate_system,
        "geoid_undulation_m": kept.geoid_undulation_m,
        "points": [_point(point, used, found) for point in kept.points],
        "as_is": _summary(found.as_is),
        "fit": _fit(found),
        "no_fit": found.no_fit,
        "no_georeference": found.no_georeference,
        "suspect": found.suspect,
        "warnings": warnings,
    }


def _far(points: Sequence[ControlPoint], bounds: Mapping[str, Sequence[float]] | None) -> list[str]:
    """Return the names of the points whose places are far outside of a scan."""
    if bounds is None:
        return []
    lower, upper = np.array(bounds["min"]), np.array(bounds["max"])
    return [
        point.name
        for point in points
        if point.position_m is not None
        and np.linalg.norm(point.position_m - np.clip(point.position_m, lower, upper)) > _FAR_M
    ]


def _point(point: ControlPoint, used: Sequence[str], found: ControlCheck) -> Document:
    number = used.index(point.name) if point.position_m is not None else None
    known = dict(
        zip(("latitude_deg", "longitude_deg", "height_m") if point.is_geodetic else "xyz", point.known, strict=True)
    )
    fit = found.fit
    return {
        "name": point.name,
        **dict.fromkeys(("x", "y", "z", "latitude_deg", "longitude_deg", "height_m")),
        **known,
        "position_m": None if point.position_m is None else list(point.position_m),
        "as_is": None if number is None or found.as_is is None else _residual(found.as_is[number]),
        "fitted": None if number is None or fit is None else _residual(fit.residuals[number]),
        "left_out_m": None if number is None or fit is None else round(float(fit.left_out_m[number]), 5),
    }


def _residual(off: NDArray[np.float64]) -> Document:
    values = {"east_m": off[0], "north_m": off[1], "up_m": off[2]}
    lengths = {"horizontal_m": np.hypot(off[0], off[1]), "distance_m": np.linalg.norm(off)}
    return {name: round(float(value), 5) for name, value in (values | lengths).items()}


def _summary(off: NDArray[np.float64] | None) -> Document | None:
    if off is None or not len(off):
        return None
    squares = np.square(off).mean(axis=0)
    values = {
        "rms_horizontal_m": np.sqrt(squares[:2].sum()),
        "rms_up_m": np.sqrt(squares[2]),
        "rms_m": np.sqrt(squares.sum()),
        "largest_m": np.linalg.norm(off, axis=1).max(),
    }
    return {"num_points": len(off), **{name: round(float(value), 5) for name, value in values.items()}}


def _fit(found: ControlCheck) -> Document | None:
    fit = found.fit
    if fit is None:
        return None
    return {
        **(_summary(fit.residuals) or {}),
        "rms_left_out_m": round(float(np.sqrt(np.square(fit.left_out_m).mean())), 5),
        "turn_deg": round(float(np.degrees(fit.yaw_rad)), 5),
        "scale": round(fit.scale, 7),
        "tilt_deg": round(fit.tilt_deg, 4),
        "georeference": found.georeference and georeference_document(found.georeference),
    }


def _key_of(map_id: str) -> str:
    return f"control/{map_id}.json"
