"""What belongs to a query: its images, each with its mask, its camera and its pose; and where the camera should be now, from where
it was by an earlier answer and how it has moved since. What does not belong together is refused by name."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from panoloc.core.geometry.pose import Pose, matrix_from_quaternion
from panoloc.core.options import MAX_SESSION_SPAN_M, PosePrior, TrackedPose
from panoloc.service.answer import Document
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.schemas.queries import (
    MAX_PRIOR_STD_DEG,
    MAX_PRIOR_STD_M,
    Camera,
    ExpectedPose,
    LocalizeOptions,
    Prior,
    SessionFromCamera,
)
from panoloc.service.jobs import QueryImage
from panoloc.service.localizations import IS_TRACKED, Localizations, unknown
from panoloc.service.maps.known_maps import VisibleMaps

_POSE = "session_from_camera"
_ANSWER_ID = "hints.prior.localization_id"
# How far the tracking of phones drifts, about.
_DRIFT, _TURN_DEG_PER_M = 0.01, 0.1


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


async def with_pose_of_prior(
    options: LocalizeOptions, localizations: Localizations, maps: VisibleMaps, map_ids: Sequence[str]
) -> LocalizeOptions:
    """Return the options with the pose of a prior that names an earlier answer; others as they are.

    maps: that the caller sees. map_ids: of the query. Raises LocalizationNotFoundError for an unknown answer, also for one in a map that
    the caller does not see, and InvalidOptionsError.
    """
    hints = options.hints
    if hints is None or hints.prior is None or hints.prior.localization_id is None:
        return options
    answer = await localizations.stored(hints.prior.localization_id, maps.tenant)
    if answer.get("map_id") is not None and not maps.has(answer["map_id"]):
        raise unknown(hints.prior.localization_id, localizations.settings.result_ttl_s)
    _check(answer, options, map_ids)
    prior = _moved(answer, hints.prior, _tracked(options))
    return options.model_copy(update={"hints": hints.model_copy(update={"prior": prior})})


def _check(answer: Document, options: LocalizeOptions, map_ids: Sequence[str]) -> None:
    if answer["status"] != "localized":
        raise InvalidOptionsError.of(
            _ANSWER_ID,
            f"expected a localized answer, got one that is {answer['status']}; leave the prior out, or name another answer",
        )
    if answer["map_id"] not in map_ids:
        raise InvalidOptionsError.of(
            _ANSWER_ID,
            f"expected an answer in the map of the query, got one in {answer['map_id']}; name that map, or leave the prior out",
        )
    if answer["pose"]["frame"] != options.frame:
        raise InvalidOptionsError.of(
            _ANSWER_ID,
            f"expected an answer in the frame of the query, {options.frame}, got {answer['pose']['frame']}; send the same frame",
        )


def _tracked(options: LocalizeOptions) -> SessionFromCamera | None:
    return options.cameras[0].session_from_camera if options.cameras else None


def _moved(answer: Document, prior: Prior, tracked: SessionFromCamera | None) -> Prior:
    """Return the prior as a pose. tracked: the pose of the query's first image in its session."""
    then = answer["pose"]["map_from_camera"]
    if prior.motion is not None:
        now = _after(then, prior.motion)
    elif tracked is not None and answer[IS_TRACKED]:
        now = _after(answer["map_from_session"], tracked)
    else:
        return prior.model_copy(update={"pose": ExpectedPose.model_validate(answer["pose"])})
    way_m = math.dist(then["position_m"].values(), now["position_m"].values())
    accuracy = answer["accuracy"]
    position_std_m = (accuracy["position_m"] or PosePrior.position_std_m) + _DRIFT * way_m
    orientation_std_deg = (accuracy["orientation_deg"] or PosePrior.orientation_std_deg) + _TURN_DEG_PER_M * way_m
    return prior.model_copy(
        update={
            "pose": ExpectedPose.model_validate({"frame": answer["pose"]["frame"], "map_from_camera": now}),
            "position_std_m": prior.position_std_m or min(position_std_m, MAX_PRIOR_STD_M),
            "orientation_std_deg": prior.orientation_std_deg or min(orientation_std_deg, MAX_PRIOR_STD_DEG),
        }
    )


def _after(map_from_first: Document, first_from_second: SessionFromCamera) -> dict[str, Any]:
    """Return `map_from_second`; all in the axes of one frame, left-handed ones too."""
    matrix, moved = np.array(map_from_first["matrix"]), first_from_second.to_options()
    found = Pose(matrix[:3, :3], matrix[:3, 3]).after(
        Pose(matrix_from_quaternion(np.array(moved.quaternion_xyzw)), np.array(moved.position_m))
    )
    return {
        "position_m": dict(zip("xyz", found.position.tolist(), strict=True)),
        "quaternion": dict(zip("xyzw", found.quaternion_xyzw.tolist(), strict=True)),
    }
