"""COLMAP text models: with its EQUIRECTANGULAR camera, which it knows since 4.1.0, or with six pinholes per panorama."""

import io
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from panoloc.core.exports.frames import cam_from_world, quaternion_wxyz
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, plain, text_file
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.file_names import distinct_names
from panoloc.core.scan.reading import read_points_of_map

FACES: tuple[str, ...] = ("front", "right", "back", "left", "up", "down")
_DECIMALS = 15  # positions are multiplied by rotations: in national grids nine would lose millimetres
_MAX_POINTS = 200_000
_QUALITY = 95


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can."""
    if " " in photo.name:
        return "its name has a space, which ends a name in COLMAP's text files; rename the photo"
    return None


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield cameras, images (camera from world; axes right, down, forward) and the map's points without tracks."""
    sizes = sorted({(photo.width, photo.height) for photo in tour.photos})
    cameras = [
        f"{number} EQUIRECTANGULAR {width} {height} {width} {height}" for number, (width, height) in enumerate(sizes, 1)
    ]
    yield _table("cameras.txt", "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", cameras)
    images = []
    for number, photo in enumerate(tour.photos, 1):
        camera = sizes.index((photo.width, photo.height)) + 1
        # Without its second line, which names points, an image would swallow the next one.
        images += [f"{number} {_pose_text(cam_from_world(photo.map_from_camera))} {camera} {photo.name}", ""]
    yield _table("images.txt", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then POINTS2D[]", images)
    yield _table("points3D.txt", "POINT3D_ID X Y Z R G B ERROR TRACK[]", _points_of(tour.scan))


def write_rig(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `sparse/0/`, then `images/FACE/NAME.jpg`: four faces around, one up, one down, each 90 degrees wide.

    For tools that know no spheres. `names.csv` has the photo of each NAME. The reference sensor of a rig is its front
    face, so the rig of a frame stands where the panorama does.
    """
    sizes = sorted({face_size(photo) for photo in tour.photos})
    cameras = [
        f"{_id(sizes.index(size), face)} PINHOLE {size} {size} {size / 2} {size / 2} {size / 2} {size / 2}"
        for size in sizes
        for face in range(len(FACES))
    ]
    yield _table("sparse/0/cameras.txt", "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]", cameras)
    yield _table(
        "sparse/0/rigs.txt",
        "RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, SENSOR_FROM_RIG)",
        [_rig(number) for number in range(len(sizes))],
    )
    names = _image_names(tour.photos)
    frames, images = [], []
    for number, (photo, image_name) in enumerate(zip(tour.photos, names, strict=True)):
        rig = sizes.index(face_size(photo))
        data = " ".join(f"CAMERA {_id(rig, face)} {_id(number, face)}" for face in range(len(FACES)))
        frames.append(f"{number + 1} {rig + 1} {_pose_text(cam_from_world(photo.map_from_camera))} {len(FACES)} {data}")
        for face, face_name in enumerate(FACES):
            pose = _pose_text(_face_pose(photo.map_from_camera, face_name))
            images += [f"{_id(number, face)} {pose} {_id(rig, face)} {face_name}/{image_name}", ""]
    yield _table("sparse/0/frames.txt", "FRAME_ID RIG_ID RIG_FROM_WORLD NUM_DATA_IDS DATA_IDS[]", frames)
    yield _table("sparse/0/images.txt", "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then POINTS2D[]", images)
    yield _table("sparse/0/points3D.txt", "POINT3D_ID X Y Z R G B ERROR TRACK[]", _points_of(tour.scan))
    photos_of = (f"{name}; {photo.name}" for name, photo in zip(names, tour.photos, strict=True))
    yield text_file("names.csv", ("# name below images/FACE; name of the photo", *photos_of))
    for photo, image_name in zip(tour.photos, names, strict=True):
        if photo.image is not None:
            yield from _cut(photo, image_name)


def face_size(photo: PlacedPhoto) -> int:
    """Return the edge of a face in pixels: as fine as the panorama is at its horizon, in the middle of the face."""
    return max(1, round(photo.width / np.pi))


def turned(face: str) -> NDArray[np.float64]:
    """Return the rotation (3, 3) from a face's camera (x forward, y left, z up) to the panorama."""
    if face in ("up", "down"):
        up = 1 if face == "up" else -1
        return np.array([[0.0, 0, -up], [0, 1, 0], [up, 0, 0]])
    c, s = [(1, 0), (0, -1), (-1, 0), (0, 1)][FACES.index(face)]
    return np.array([[c, -s, 0.0], [s, c, 0], [0, 0, 1]])


def cut_face(colors: NDArray[np.uint8], size: int, face: str) -> NDArray[np.uint8]:
    """Return the face (size, size, 3) of a panorama (h, w, 3), interpolated between its pixels."""
    height, width = colors.shape[:2]
    across = (np.arange(size) + 0.5) / size * 2 - 1
    left, up = np.meshgrid(-across, -across)
    x, y, z = np.einsum("ij,jrc->irc", turned(face), np.stack([np.ones_like(left), left, up]))
    column = (0.5 - np.arctan2(y, x) / (2 * np.pi)) * width - 0.5
    row = (0.5 - np.arctan2(z, np.hypot(x, y)) / np.pi) * height - 0.5
    first_column, first_row = np.floor(column).astype(int), np.floor(row).astype(int)
    of_column, of_row = (column - first_column)[..., None], (row - first_row)[..., None]
    blended = np.zeros((size, size, 3))
    for down, weight_down in ((0, 1 - of_row), (1, of_row)):
        rows = np.clip(first_row + down, 0, height - 1)
        for aside, weight_aside in ((0, 1 - of_column), (1, of_column)):
            blended += weight_down * weight_aside * colors[rows, (first_column + aside) % width]
    return np.rint(blended).astype(np.uint8)


def _face_pose(map_from_camera: Pose, face: str) -> Pose:
    return cam_from_world(Pose(map_from_camera.rotation @ turned(face), map_from_camera.position))


def _rig(number: int) -> str:
    panorama = Pose(np.eye(3), np.zeros(3))
    world_from_rig = cam_from_world(panorama).inverse()
    sensors = " ".join(
        f"CAMERA {_id(number, face)} 1 {_pose_text(_face_pose(panorama, name).after(world_from_rig))}"
        for face, name in enumerate(FACES)
        if face > 0
    )
    return f"{number + 1} {len(FACES)} CAMERA {_id(number, 0)} {sensors}"


def _id(group: int, face: int) -> int:
    """Return the number of a camera in a rig, or of an image in a photo."""
    return group * len(FACES) + face + 1


def _image_names(photos: Sequence[PlacedPhoto]) -> list[str]:
    names = [PurePosixPath(photo.name) for photo in photos]
    # Where a space stands, names end in COLMAP's text files.
    return distinct_names(str(name.with_name(name.name.replace(".", "_") + ".jpg")).replace(" ", "_") for name in names)


def _cut(photo: PlacedPhoto, image_name: str) -> Iterator[ExportedFile]:
    with Image.open(photo.image) as opened:  # type: ignore[arg-type]
        # The pose is that of the photo as EXIF turns it, and so is its size.
        colors = np.asarray(ImageOps.exif_transpose(opened).convert("RGB"))
    for face in FACES:
        out = io.BytesIO()
        Image.fromarray(cut_face(colors, face_size(photo), face)).save(out, "JPEG", quality=_QUALITY)
        yield ExportedFile(f"images/{face}/{image_name}", out.getvalue())


def _table(name: str, columns: str, lines: Sequence[str]) -> ExportedFile:
    """Return a file of a text model."""
    return text_file(name, (f"# {columns}", *lines))


def _pose_text(pose: Pose) -> str:
    """Return QW QX QY QZ TX TY TZ."""
    return " ".join(plain(value, _DECIMALS) for value in (*quaternion_wxyz(pose.rotation), *pose.position))


def _points_of(scan: Path | None) -> list[str]:
    """Return the lines of the points of a map, thinned to what a text file can bear; none without a scan."""
    if scan is None:
        return []
    cloud = read_points_of_map(scan, _MAX_POINTS)
    positions = cloud.positions.astype(np.float64) + cloud.origin_offset
    return [
        f"{number} {' '.join(plain(value, 6) for value in position)} {' '.join(map(str, color))} 0"
        for number, (position, color) in enumerate(zip(positions.tolist(), cloud.colors.tolist(), strict=True), 1)
    ]
