"""How the scan of a map is read: whether as it is, and whether other options make a difference."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.errors import ScanDamagedError, ScanFormatError, ScanTooLargeError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.frame import unit_of
from panoloc.service.maps.record import MapRecord, Revision
from panoloc.service.problems import CORE_PROBLEMS

# Of files that no other unit or axes mend.
_UNREADABLE = {CORE_PROBLEMS[kind].type for kind in (ScanFormatError, ScanDamagedError, ScanTooLargeError)}


def revision_to_read(record: MapRecord) -> Revision:
    """Return the revision whose scan is read in another way: the newest, or the serving one if no options mend the newest file."""
    failure = (record.newest.error or {}).get("type")
    return record.serving if record.serving is not None and failure in _UNREADABLE else record.newest


def wanted_reading(record: MapRecord, given: Mapping[str, Any]) -> ScanOptions:
    """Return how the scan of `revision_to_read` is to be read. given: options of it that were sent."""
    return replace(revision_to_read(record).options.scan, **given, coordinate_system=record.coordinate_system)


def with_stated(record: MapRecord, given: Mapping[str, Any]) -> MapRecord:
    """Return a map with options that only state how its scan is read already, without the questions that they answer.

    Where there are none, or they alter the reading, the same map is returned.
    """
    former, wanted = revision_to_read(record), wanted_reading(record, given)
    if not given or is_read_otherwise(former, wanted):
        return record
    stated = {"unit": wanted.unit, "height_unit": _height_unit(wanted, wanted.unit), "up_axis": wanted.up_axis}
    doubts = [each for each in former.diagnostics if not _is_answered(each, stated)]
    noted = replace(former, options=replace(former.options, scan=wanted), diagnostics=doubts)
    is_newest, is_serving = record.newest == former, record.serving == former
    return replace(
        record, newest=noted if is_newest else record.newest, serving=noted if is_serving else record.serving
    )


def is_read_otherwise(revision: Revision, wanted: ScanOptions) -> bool:
    """Tell whether a revision may have to be registered again for `wanted`. Of a coordinate system the units alone matter."""
    former, read_as = revision.options.scan, _read_as(revision)
    if (wanted.unit, wanted.height_unit) != (former.unit, former.height_unit):
        # A unit that was judged is judged only as long as none is given.
        is_kept = wanted.unit == former.unit == "auto" and read_as.get("unit_from") in ("assumed", "file")
        unit = read_as["unit"] if is_kept else wanted.unit
        if (unit, _height_unit(wanted, unit)) != (read_as["unit"], read_as["height_unit"]):
            return True
    if wanted.up_axis not in (former.up_axis, read_as["up_axis"]):
        return True
    return wanted.coordinate_system != former.coordinate_system and _units_of(wanted.coordinate_system) != (
        read_as["unit"],
        read_as["height_unit"],
    )


def is_in_map_frame(revision: Revision) -> bool:
    """Tell whether the coordinates of the scan are those of the map."""
    read_as = _read_as(revision)
    return (read_as["unit"], read_as["height_unit"], read_as["up_axis"]) == ("m", "m", "z")


def _read_as(revision: Revision) -> dict[str, Any]:
    """Return `stats.read_as`; before it is known, and of maps of earlier versions, what was given."""
    given = revision.options.scan
    return (revision.stats or {}).get("read_as") or {
        "unit": given.unit,
        "height_unit": _height_unit(given, given.unit),
        "up_axis": given.up_axis,
    }


def _height_unit(options: ScanOptions, unit: str | None) -> str | None:
    return unit if options.height_unit == "auto" else options.height_unit


def _units_of(system: str | None) -> tuple[str | None, str | None]:
    """Return the units of a grid and of its heights; metres without one."""
    if system is None:
        return "m", "m"
    found = coordinate_system(system)
    return unit_of(found.metres_per_unit), unit_of(found.height_metres_per_unit or found.metres_per_unit)


def _is_answered(diagnostic: Mapping[str, Any], stated: Mapping[str, Any]) -> bool:
    choices = (diagnostic.get("question") or {}).get("choices", [])
    return any(choice["patch"].items() <= stated.items() for choice in choices)
