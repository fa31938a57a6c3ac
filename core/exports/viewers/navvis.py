"""NavVis `pano-poses.csv`, with the photos under the names that it asks for."""

from collections.abc import Iterator
from pathlib import PurePosixPath

from core.exports.axes import quaternion_wxyz
from core.exports.number_text import fixed
from core.exports.tour import ExportedFile, Tour

_HEADER = "# pano poses v1.0: ID; filename; timestamp; pano_pos_x; pano_pos_y; pano_pos_z; pano_ori_w; pano_ori_x; pano_ori_y; pano_ori_z"


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield the table, w of the quaternion first, body axes x forward, y left, z up; then the photos, and what they were called."""
    lines, names = [_HEADER], ["# filename; name of the photo"]
    for number, (photo, time_unix_s) in enumerate(zip(tour.photos, tour.times_unix_s, strict=True)):
        pose = photo.map_from_camera
        file_name = f"{number:05}-pano{PurePosixPath(photo.name).suffix or '.jpg'}"
        numbers = [time_unix_s, *pose.position, *quaternion_wxyz(pose.rotation)]
        lines.append("; ".join([str(number), file_name, *(fixed(value, 6) for value in numbers)]))
        names.append(f"{file_name}; {photo.name}")
        if photo.image is not None:
            yield ExportedFile(file_name, photo.image)
    yield ExportedFile("pano-poses.csv", ("\n".join(lines) + "\n").encode())
    yield ExportedFile("names.csv", ("\n".join(names) + "\n").encode())
