"""The camera of an image as people see it: in the pixels of the whole file, turned upright. Decodes nothing."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera, CameraDescription
from panoloc.core.errors import OptionsError
from panoloc.core.image.image_header import IMAGE, open_image
from panoloc.core.image.known_camera import Crop, described_for, known_camera, upright_size


@dataclass(frozen=True)
class ShownCamera:
    """A camera, and where (px) the image lies in its own: of a GPano crop, in the full sphere."""

    camera: Camera
    left: float = 0.0
    top: float = 0.0

    def of_seen(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where pixels (n, 2) of the image as people see it are in the camera's own."""
        moved: NDArray[np.float64] = pixels + np.array([self.left, self.top])
        return moved


def shown_camera(data: bytes, described: CameraDescription | None, max_pixels: int) -> ShownCamera:
    """Return the camera of a file as `panoloc.core.image.reader.read_image` would find it.

    Raises as that does for what is no image or says nothing of its camera, and OptionsError for a photo that is stored turned with a camera
    that is described as it is stored.
    """
    image = open_image(data, IMAGE, max_pixels)
    size = upright_size(image)
    described = described_for(image, data, described)
    if described is not None:
        if described.is_as_stored(image.size) and size != image.size:
            raise OptionsError(
                f"pairs: expected a camera described as its image is seen, {size[0]} x {size[1]} px, got one of the image as it is stored, "
                f"{image.width} x {image.height} px; place the photo by a rough pose instead"
            )
        return ShownCamera(described.of_image(image.size, size))
    found = known_camera(image, data)
    if isinstance(found, Camera):
        return ShownCamera(found)
    if isinstance(found, Crop):
        return ShownCamera(_sphere(found.full_width, found.full_height), found.left, found.top)
    return ShownCamera(_sphere(*size))


def _sphere(width: int, height: int) -> Camera:
    return Camera("equirectangular", width, height, width / (2 * math.pi), height / math.pi, width / 2, height / 2)
