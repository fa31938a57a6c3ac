"""Decodes the images of a query into a rig."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.errors import OptionsError, PanoramaTooLargeError
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.image_header import numbered
from panoloc.core.image.photo_window import rig_on_sphere
from panoloc.core.image.reader import read_image
from panoloc.core.kernels.library import num_threads
from panoloc.core.options import Frame, SessionOptions, TrackedPose
from panoloc.core.results import Localization
from panoloc.service.jobs import QueryImage

_DRAWN_ROWS = 512  # pictures are 1024 pixels for a full turn


def read_query(images: Sequence[QueryImage], frame: Frame, session: SessionOptions, max_pixels: int) -> Rig:
    """Decode the images of a query.

    frame: axes of their poses. max_pixels: of all images together. A single image without a pose is no session. Raises
    errors of `core`.
    """
    read = _read(images, max_pixels)
    if len(read) == 1 and images[0].session_from_camera is None:
        return Rig.of_photo(read[0])
    poses = (_pose(image.session_from_camera, frame) for image in images)
    return Rig(tuple(RigImage(one, pose) for one, pose in zip(read, poses, strict=True)), session)


def as_found(rig: Rig, found: Localization) -> Rig:
    """Return the rig with the cameras that the search found, where they differ from those given."""
    if not found.found_cameras:
        return rig
    images = tuple(
        replace(image, photo=replace(image.photo, camera=camera, hfov_range_deg=None))
        for image, camera in zip(rig.images, found.found_cameras, strict=True)
    )
    return replace(rig, images=images)


def shown_on_sphere(rig: Rig, found: Localization) -> tuple[Panorama, Localization]:
    """Return all images on one sphere, and the result with the pose of that sphere as its best, for pictures."""
    sphere = rig_on_sphere(rig, _DRAWN_ROWS)
    if found.best is None or found.map_from_session is None:
        return sphere, found
    return sphere, replace(found, best=replace(found.best, pose=found.map_from_session.after(rig.session_from_rig)))


def _read(images: Sequence[QueryImage], max_pixels: int) -> list[Photo]:
    """Decode in as many threads as compute: decoding releases the GIL. The first error cancels those that wait."""
    found: list[Photo] = []
    threads = ThreadPoolExecutor(min(len(images), num_threads()))
    try:
        tasks = [
            threads.submit(read_image, each.data, each.mask, camera=each.camera, max_pixels=max_pixels)
            for each in images
        ]
        for number, task in enumerate(tasks, 1):
            with numbered(number, len(images)):
                found.append(task.result())
                _check_pixels(found, max_pixels)
    finally:
        threads.shutdown(cancel_futures=True)
    return found


def _pose(tracked: TrackedPose | None, frame: Frame) -> Pose:
    if tracked is None:
        raise OptionsError(
            "cameras: expected session_from_camera for each of several images, got an image without it; send one for "
            "each image"
        )
    return Pose.from_frame(tracked.position_m, tracked.quaternion_xyzw, frame)


def _check_pixels(read: Sequence[Photo], max_pixels: int) -> None:
    """Check the limit again: GPano crops have grown to their full spheres since their headers were checked."""
    found = sum(image.valid.size for image in read)
    if found > max_pixels:
        raise PanoramaTooLargeError(
            f"image: expected at most {max_pixels:,} pixels over all images, got {found:,} with GPano crops extended to full spheres; "
            "scale the images down"
        )
