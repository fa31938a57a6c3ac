"""The spherical images of an E57 file: where each was taken, and its JPEG or PNG."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.scan.e57.scan_entry import pose_of

_BLOBS = {"jpegImage": ".jpg", "pngImage": ".png"}
_MAX_IMAGE_BYTES = 256 << 20


@dataclass(frozen=True)
class SphericalImage:
    """A panorama of an E57 file.

    rotation: (3, 3) and position: (3,), from the camera (x forward, y left, z up) to the file's frame; None where the file does not say.
    suffix: of the format that the file says it is, `.jpg` or `.png`.
    """

    name: str
    suffix: str
    num_bytes: int
    rotation: NDArray[np.float64] | None
    position: NDArray[np.float64] | None
    _blob: Any

    def read(self) -> bytes:
        """Return the image file."""
        data = np.zeros(self.num_bytes, np.uint8)
        self._blob.read(data, 0, self.num_bytes)
        return data.tobytes()


def spherical_images(root: Any) -> tuple[list[SphericalImage], int]:
    """Return the spherical images of an open file, and how many others it has: of other projections, or larger than is read.

    A camera's x axis looks at the middle of its image, y to the left, z up. An image twice as wide as high is a full sphere whatever size
    of pixels it states, because files state wrong ones.
    """
    nodes = root["images2D"] if root.isDefined("images2D") else ()
    found = [each for number in range(len(nodes)) if (each := _image(nodes[number], number)) is not None]
    return found, len(nodes) - len(found)


def _image(node: Any, number: int) -> SphericalImage | None:
    if not node.isDefined("sphericalRepresentation"):
        return None
    sphere = node["sphericalRepresentation"]
    if int(sphere["imageWidth"].value()) != 2 * int(sphere["imageHeight"].value()):
        return None
    for blob_name, suffix in _BLOBS.items():
        if not sphere.isDefined(blob_name):
            continue
        blob = sphere[blob_name]
        num_bytes = int(blob.byteCount())
        if not 0 < num_bytes <= _MAX_IMAGE_BYTES:
            return None
        name = str(node["name"].value()) if node.isDefined("name") else ""
        rotation, position = pose_of(node) if node.isDefined("pose") else (None, None)
        return SphericalImage(name.strip() or f"image-{number:04}", suffix, num_bytes, rotation, position, blob)
    return None
