"""The images of an E57 file: where each was taken, with which camera, and its JPEG or PNG."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanDamagedError
from panoloc.core.geometry.pose import Pose

_BLOBS = {"jpegImage": ".jpg", "pngImage": ".png"}
_MAX_IMAGE_BYTES = 256 << 20
SAME_PLACE_M = 0.01
# Rows: the axes of the standard's pinhole camera (x right, y up, z backward) in ours (x forward, y left, z up).
_PINHOLE_AXES = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics of an image in pixels, from the left and upper edges of its first pixel."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def as_camera(self) -> dict[str, object]:
        """Return it as an entry of `cameras` of a query."""
        sizes = {"width_px": self.width, "height_px": self.height, "fx_px": self.fx, "fy_px": self.fy}
        return {"model": "pinhole", **sizes, "cx_px": self.cx, "cy_px": self.cy}


@dataclass(frozen=True)
class E57Image:
    """An image of an E57 file.

    pinhole: None for a full sphere. rotation (3, 3), position (3,): from the camera (x forward, y left, z up) to the
    file's frame; None where the file does not say. suffix: `.jpg` or `.png`, as the file says.
    """

    name: str
    suffix: str
    num_bytes: int
    pinhole: Pinhole | None
    rotation: NDArray[np.float64] | None
    position: NDArray[np.float64] | None
    _blob: Any

    def read(self) -> bytes:
        """Return the image file."""
        data = np.zeros(self.num_bytes, np.uint8)
        self._blob.read(data, 0, self.num_bytes)
        return data.tobytes()


def images_of(root: Any) -> tuple[list[E57Image], int]:
    """Return the images of an open file, and how many images are not read: of other projections, or too large.

    It returns panoramas, and pinhole images, such as six cube faces, of places without a panorama. A panorama's x axis
    looks at the middle of its image, y to the left, z up. An image twice as wide as high is a full sphere: the
    pixel size that files state is often wrong.
    """
    nodes = root["images2D"] if root.isDefined("images2D") else ()
    found = [each for number in range(len(nodes)) if (each := _image(nodes[number], number)) is not None]
    panoramas = [image for image in found if image.pinhole is None]
    at = np.array([image.position for image in panoramas if image.position is not None]).reshape(-1, 3)
    kept = [image for image in found if image.pinhole is None or not _is_one_of(image.position, at)]
    return kept, len(nodes) - len(found)


def _is_one_of(position: NDArray[np.float64] | None, places: NDArray[np.float64]) -> bool:
    if position is None:
        return len(places) > 0
    return bool((np.linalg.norm(places - position, axis=1) < SAME_PLACE_M).any())


def _image(node: Any, number: int) -> E57Image | None:
    if node.isDefined("sphericalRepresentation"):
        picture, pinhole = node["sphericalRepresentation"], None
        is_read = int(picture["imageWidth"].value()) == 2 * int(picture["imageHeight"].value())
    elif node.isDefined("pinholeRepresentation"):
        picture = node["pinholeRepresentation"]
        pinhole = _pinhole(picture)
        is_read = pinhole is not None
    else:
        return None
    found = [(picture[name], suffix) for name, suffix in _BLOBS.items() if picture.isDefined(name)]
    if not is_read or not found or not 0 < found[0][0].byteCount() <= _MAX_IMAGE_BYTES:
        return None
    blob, suffix = found[0]
    name = str(node["name"].value()).strip() if node.isDefined("name") else ""
    rotation, position = pose_of(node) if node.isDefined("pose") else (None, None)
    if rotation is not None and pinhole is not None:
        rotation = rotation @ _PINHOLE_AXES
    return E57Image(name or f"image-{number:04}", suffix, blob.byteCount(), pinhole, rotation, position, blob)


def _pinhole(node: Any) -> Pinhole | None:
    """Return the intrinsics of an image, None where they make no sense."""
    width, height = int(node["imageWidth"].value()), int(node["imageHeight"].value())
    focal_m, *pixels_m = (float(node[name].value()) for name in ("focalLength", "pixelWidth", "pixelHeight"))
    if min(width, height) < 1 or not all(0 < value < math.inf for value in (focal_m, *pixels_m)):
        return None
    middle = [
        float(node[name].value()) if node.isDefined(name) else size / 2
        for name, size in (("principalPointX", width), ("principalPointY", height))
    ]
    if not all(0 <= at <= size for at, size in zip(middle, (width, height), strict=True)):
        return None
    return Pinhole(width, height, focal_m / pixels_m[0], focal_m / pixels_m[1], *middle)


def pose_of(node: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation (3, 3) and translation (3,) from a scan's or image's frame to the file's; identity without a pose."""
    if not node.isDefined("pose"):
        return np.eye(3), np.zeros(3)
    pose = node["pose"]
    position, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if pose.isDefined("translation"):
        position = tuple(pose["translation"][axis].value() for axis in "xyz")
    if pose.isDefined("rotation"):
        turn = tuple(pose["rotation"][part].value() for part in "xyzw")
    if not 1e-6 < math.hypot(*turn) < math.inf:
        raise ScanDamagedError(
            "A scan or an image of the E57 file has a pose without a rotation. Export the scan again."
        )
    found = Pose.from_frame(position, turn, "ros")
    return found.rotation, found.position
