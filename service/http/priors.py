"""Priors by an earlier answer: where the camera should be now, from where it was and how it has moved since."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from panoloc.core.geometry.pose import Pose, matrix_from_quaternion
from panoloc.core.options import PosePrior
from panoloc.service.answer import Document
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.schemas.queries import (
    MAX_PRIOR_STD_DEG,
    MAX_PRIOR_STD_M,
    ExpectedPose,
    LocalizeOptions,
    Prior,
    SessionFromCamera,
)
from panoloc.service.localizations import IS_TRACKED, Localizations, unknown
from panoloc.service.maps.known_maps import VisibleMaps

_AT = "hints.prior.localization_id"
# How far the tracking of phones drifts, about.
_DRIFT, _TURN_DEG_PER_M = 0.01, 0.1


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
            _AT,
            f"expected a localized answer, got one that is {answer['status']}; leave the prior out, or name another answer",
        )
    if answer["map_id"] not in map_ids:
        raise InvalidOptionsError.of(
            _AT,
            f"expected an answer in the map of the query, got one in {answer['map_id']}; name that map, or leave the prior out",
        )
    if answer["pose"]["frame"] != options.frame:
        raise InvalidOptionsError.of(
            _AT,
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
