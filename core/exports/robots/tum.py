"""TUM trajectory: one line per photo."""

from collections.abc import Iterator

from core.exports.number_text import TIME_DECIMALS, plain
from core.exports.tour import ExportedFile, Tour


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `poses.tum`: map from body, seconds and metres, quaternion with w last; and the photo of each line."""
    lines = ["# timestamp tx ty tz qx qy qz qw: map from body, body axes x forward, y left, z up"]
    names = []
    for photo, time_unix_s in zip(tour.photos, tour.times_unix_s, strict=True):
        pose = photo.map_from_camera
        time = plain(time_unix_s, TIME_DECIMALS)
        lines.append(" ".join([time, *(plain(value, 12) for value in (*pose.position, *pose.quaternion_xyzw))]))
        names.append(f"{time} {photo.name}")
    yield ExportedFile("poses.tum", ("\n".join(lines) + "\n").encode())
    yield ExportedFile("names.txt", ("".join(f"{name}\n" for name in names)).encode())
