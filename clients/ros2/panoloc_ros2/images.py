"""Images of ROS as files that the service takes, and their CameraInfo as an entry of `cameras`."""

import struct
import zlib
from typing import Any

import numpy as np

from .poses import Pose, as_json

CHANNELS = {"rgb8": (0, 1, 2), "bgr8": (2, 1, 0), "rgba8": (0, 1, 2), "bgra8": (2, 1, 0), "mono8": (0,)}
"""By encoding the bytes of a pixel in the order of a file."""
MODELS = {"plumb_bob": "opencv", "rational_polynomial": "opencv", "equidistant": "opencv_fisheye", "": "pinhole"}


_HEADS = (b"\xff\xd8", b"\x89PNG")


class UnusableError(Exception):
    """A message that cannot be sent; the text says what to change."""


def check_image(image: Any) -> None:
    """Raise UnusableError for an encoding that cannot be sent."""
    if not hasattr(image, "encoding"):
        if not bytes(image.data[:4]).startswith(_HEADS):
            raise UnusableError(f"expected jpeg or png images, got others, of the format {image.format!r}")
    elif image.encoding not in CHANNELS:
        is_depth = image.encoding in ("16UC1", "32FC1")
        how = (
            "subscribe to the colour image, this looks like depth"
            if is_depth
            else "let image_proc convert them, or subscribe to the compressed topic"
        )
        raise UnusableError(f"expected images in {', '.join(CHANNELS)}, got {image.encoding!r}: {how}")
    elif not _num_bytes(image.encoding) * image.width <= image.step <= len(image.data) / max(image.height, 1):
        raise UnusableError(
            f"expected {image.height} rows of {image.step} bytes for {image.width} pixels in {image.encoding}, got {len(image.data)} bytes"
        )


def _num_bytes(encoding: str) -> int:
    return 4 if encoding.endswith("a8") else len(CHANNELS[encoding])


def file_of(image: Any) -> bytes:
    """Return a sensor_msgs/Image as PNG, and a CompressedImage as it is."""
    data = bytes(image.data)
    if not hasattr(image, "encoding"):
        return data
    channels, depth = CHANNELS[image.encoding], _num_bytes(image.encoding)
    rows = np.frombuffer(data, np.uint8, image.height * image.step).reshape(image.height, image.step)[
        :, : image.width * depth
    ]
    pixels = rows.reshape(image.height, image.width, depth)[..., channels].reshape(image.height, -1)
    lines = np.pad(pixels, ((0, 0), (1, 0))).tobytes()  # each line begins with its filter, 0
    head = struct.pack(">IIBBBBB", image.width, image.height, 8, 2 if len(channels) == 3 else 0, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(lines, 1)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in chunks
    )


def camera_entry(info: Any, odom_from_optical: Pose, is_rectified: bool = False) -> dict[str, Any]:
    """Return what describes an image: its CameraInfo and the pose of its optical frame. Raises UnusableError.

    is_rectified: the image is without distortion, as image_proc makes it.
    """
    k, p = info.k, info.p
    fx, fy, cx, cy = (p[0], p[5], p[2], p[6]) if is_rectified else (k[0], k[4], k[2], k[5])
    distortion = [float(each) for each in info.d]
    if not any(distortion[8:]):  # some drivers fill up with zeros to all 14 of OpenCV
        distortion = distortion[:8]
    model = MODELS.get(info.distortion_model)
    if is_rectified or not any(distortion):
        model, distortion = "opencv_fisheye" if model == "opencv_fisheye" and not is_rectified else "pinhole", []
    if model is None:
        raise UnusableError(
            f"expected a distortion model of {', '.join(filter(None, MODELS))} in camera_info, got {info.distortion_model!r}: "
            "subscribe to the rectified image and set `rectified`"
        )
    if fx <= 0:
        raise UnusableError("expected the intrinsics in camera_info, got a focal length of 0: calibrate the camera")
    # Of a binned or cropped image the intrinsics belong to the full one. (REP 104)
    roi, bins = info.roi, (max(info.binning_x, 1), max(info.binning_y, 1))
    size = (roi.width or info.width, roi.height or info.height)
    return {
        "model": model,
        "width_px": size[0] // bins[0],
        "height_px": size[1] // bins[1],
        "fx_px": fx / bins[0],
        "fy_px": fy / bins[1],
        # The centre of the first pixel is (0, 0) there, and (0.5, 0.5) here.
        "cx_px": (cx - roi.x_offset + 0.5) / bins[0],
        "cy_px": (cy - roi.y_offset + 0.5) / bins[1],
        "distortion": distortion or ([0.0] * 4 if model == "opencv_fisheye" else []),
        "session_from_camera": as_json(odom_from_optical),
    }
