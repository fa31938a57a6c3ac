"""The images of a query, each with its mask, its camera and its pose; what does not belong together is refused by
name."""

import math
from collections.abc import Sequence

from panoloc.core.options import MAX_SESSION_SPAN_M, TrackedPose
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.schemas.queries import Camera, LocalizeOptions
from panoloc.service.jobs import QueryImage

_POSE = "session_from_camera"


def query_images(images: Sequence[bytes], masks: Sequence[bytes], options: LocalizeOptions) -> tuple[QueryImage, ...]:
    """Put together what belongs to each image. Raises InvalidOptionsError."""
    if not images:
        raise InvalidOptionsError.of(
            "image", "expected an image in a part of this name, got none; send one, such as -F image=@photo.jpg"
        )
    if len(masks) not in (0, 1, len(images)):
        wanted = "one or none" if len(images) == 1 else f"none, one for all, or one per image ({len(images)})"
        raise InvalidOptionsError.of(
            "mask", f"expected {wanted}, got {len(masks)}; send them in the order of the images"
        )
    cameras = _cameras(options, len(images))
    poses = _poses(options, cameras)
    return tuple(
        QueryImage(
            data,
            masks[number % len(masks)] if masks else None,
            None if camera is None else camera.to_options(),
            pose,
        )
        for number, (data, camera, pose) in enumerate(zip(images, cameras, poses, strict=True))
    )


def _cameras(options: LocalizeOptions, num_images: int) -> Sequence[Camera | None]:
    given = options.cameras
    if given is None:
        return [None] * num_images
    if len(given) == num_images:
        return given
    if len(given) > 1:
        wanted = "one entry" if num_images == 1 else f"one entry for all images, or one per image ({num_images})"
        raise InvalidOptionsError.of(
            "cameras", f"expected {wanted}, got {len(given)}; send them in the order of the images"
        )
    if given[0].session_from_camera is not None:
        raise InvalidOptionsError.of(
            f"cameras.0.{_POSE}",
            f"expected a separate pose for each of the {num_images} images, got one for all; send one entry of "
            "`cameras` per image",
        )
    return [given[0]] * num_images


def _poses(options: LocalizeOptions, cameras: Sequence[Camera | None]) -> list[TrackedPose | None]:
    poses = [
        None if camera is None or camera.session_from_camera is None else camera.session_from_camera.to_options()
        for camera in cameras
    ]
    if len(poses) > 1 and None in poses:
        # The entry without a pose is known only where there is one entry per image.
        at = f"cameras.{poses.index(None)}.{_POSE}" if len(options.cameras or ()) == len(poses) else "cameras"
        raise InvalidOptionsError.of(
            at,
            f"expected {_POSE} for each of the {len(poses)} images, got {len(poses) - poses.count(None)} of them; "
            "send the poses from the device's tracking, one entry of `cameras` per image, or send each image as a "
            "separate query",
        )
    if poses == [None] and options.session is not None and options.session.up == "known":
        raise InvalidOptionsError.of(
            "session.up",
            f"expected {_POSE} beside it, got an image without a pose, so that no axis is known; send its pose, or "
            "hints.upright for a level camera",
        )
    for number, pose in enumerate(poses):
        if pose is not None and poses[0] is not None:
            _check_distance(number, math.dist(pose.position_m, poses[0].position_m))
    return poses


def _check_distance(number: int, distance_m: float) -> None:
    if distance_m > MAX_SESSION_SPAN_M:
        raise InvalidOptionsError.of(
            f"cameras.{number}.{_POSE}.position_m",
            f"expected at most {MAX_SESSION_SPAN_M:g} m from the first image, got {distance_m:g} m; send metres, and "
            "only images of one place",
        )
