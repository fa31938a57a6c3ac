"""How the scan of a map is read: whether as it is, and whether other options make a difference."""

from dataclasses import replace

from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.options import ScanOptions
from panoloc.service.maps.record import Revision


def is_read_otherwise(revision: Revision, wanted: ScanOptions) -> bool:
    """Tell whether a revision may have to be registered again for `wanted`. Of a coordinate system the units alone matter."""
    former = revision.options.scan
    if replace(wanted, coordinate_system=former.coordinate_system) != former:
        return True
    if wanted.coordinate_system == former.coordinate_system:
        return False
    systems = former.coordinate_system, wanted.coordinate_system
    return not (_is_in_metres(revision) and all(map(_has_metres, systems)))


def is_in_map_frame(revision: Revision) -> bool:
    """Tell whether the coordinates of the scan are those of the map."""
    read_as = (revision.stats or {}).get("read_as")
    up_axis = read_as["up_axis"] if read_as else revision.options.scan.up_axis
    return _is_in_metres(revision) and up_axis == "z"


def _is_in_metres(revision: Revision) -> bool:
    read_as = (revision.stats or {}).get("read_as")
    units = (read_as["unit"], read_as["height_unit"]) if read_as else (revision.options.scan.unit,)
    return set(units) == {"m"}


def _has_metres(system: str | None) -> bool:
    if system is None:
        return True
    found = coordinate_system(system)
    return found.metres_per_unit == 1.0 and found.height_metres_per_unit in (None, 1.0)
