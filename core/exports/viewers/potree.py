"""Potree 1.8: `coordinates.txt` for its Images360Loader, which lies in the folder of the photos."""

from collections.abc import Iterator

from core.exports.angles import photo_angles
from core.exports.number_text import TIME_DECIMALS, plain
from core.exports.tour import ExportedFile, Tour

_COLUMNS = ("filename", "time", "long", "lat", "alt", "course", "pitch", "roll")


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield the table: positions are map coordinates, `course` clockwise from the map's y axis, `pitch` up, `roll` right side down.

    Eight columns, because forks read a ninth as part of a quaternion; the loader always skips the first line.
    """
    lines = ["\t".join(_COLUMNS)]
    for photo, time_unix_s in zip(tour.photos, tour.times_unix_s, strict=True):
        pose = photo.map_from_camera
        angles = photo_angles(pose.rotation)
        numbers = [*pose.position, angles.heading_deg, angles.elevation_deg, angles.roll_deg]
        lines.append("\t".join([photo.name, plain(time_unix_s, TIME_DECIMALS), *map(plain, numbers)]))
    yield ExportedFile("coordinates.txt", ("\n".join(lines) + "\n").encode())
