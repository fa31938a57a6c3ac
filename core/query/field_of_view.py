"""The field of view of a photo whose camera nobody knows: searched in steps, then refined at the pose that was found.

The search alone tells fields of view apart: at the right one the small pictures of some start fit best. At the best of them the photo is
localized, and the pose that is found is refined together with the focal length.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Rig
from panoloc.core.config import FieldOfViewConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.errors import OptionsError
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.query.engine import Engine
from panoloc.core.stage_clock import StageClock

_AT_BOUND_DEG = 0.1


def searched_range_deg(rig: Rig) -> tuple[float, float] | None:
    """Return the degrees that the only photo of a rig is wide at least and at most; None where its camera is known.

    Raises OptionsError where the camera of one of several photos is not known.
    """
    ranges = [image.photo.hfov_range_deg for image in rig.images]
    if len(ranges) > 1 and any(ranges):
        raise OptionsError(
            "hfov_range_deg: expected a single photo, got several; send hfov_deg or the intrinsics of each"
        )
    return ranges[0]


def bound_reached(camera: Camera, range_deg: tuple[float, float]) -> float | None:
    """Return the bound of a field of view, degrees, that a camera found within both has come to; None where it is between them."""
    return next((bound for bound in range_deg if abs(camera.hfov_deg - bound) < _AT_BOUND_DEG), None)


def with_found_camera(
    method: Engine,
    rig: Rig,
    maps: Sequence[MapIndex],
    hints: Hints | None,
    clock: StageClock,
    config: FieldOfViewConfig,
) -> Rig:
    """Return the rig of one photo with the field of view, of those in its range, that fits best."""
    photo = rig.images[0].photo
    if photo.hfov_range_deg is None:
        return rig
    low, high = (_focal_px(photo.camera, width) for width in reversed(photo.hfov_range_deg))
    found = _localized(method, rig, maps, hints, clock, (low, high), config)
    if found is None:
        return _with_focal(rig, math.sqrt(low * high), config.most_uncertainty)
    focal, information = _refined(method, rig, maps, clock, found, (low, high), config)
    return _with_focal(rig, focal, focal_uncertainty(information, config))


def _localized(
    method: Engine,
    rig: Rig,
    maps: Sequence[MapIndex],
    hints: Hints | None,
    clock: StageClock,
    bounds_px: tuple[float, float],
    config: FieldOfViewConfig,
) -> tuple[float, Hypothesis] | None:
    """Return the focal length, pixels, of those the search likes best, at which the photo fits best, and how it lies there."""
    low, high = bounds_px
    count = max(1, math.ceil(math.log(high / low) / math.log(config.search_step)))
    tried = [low * (high / low) ** ((k + 0.5) / count) for k in range(count)]
    scores = {focal: method.search_score(_with_focal(rig, focal), maps, hints, clock) for focal in tried}
    best: tuple[float, Hypothesis] | None = None
    for focal in sorted(tried, key=lambda each: -scores[each])[: config.most_tried]:
        result = method.run(_with_focal(rig, focal), maps, hints, clock)
        if result.hypotheses and (best is None or result.hypotheses[0].score > best[1].score):
            best = focal, result.hypotheses[0]
        if method.confidence_of_answer(result) >= method.config.judge.sure:
            break
    return best


def _refined(
    method: Engine,
    rig: Rig,
    maps: Sequence[MapIndex],
    clock: StageClock,
    found: tuple[float, Hypothesis],
    bounds_px: tuple[float, float],
    config: FieldOfViewConfig,
) -> tuple[float, float]:
    """Return the focal length, pixels, to which rounds of refinement with the pose lead, each with the window of the one before; and the
    information that the photo has of it."""
    focal, hypothesis = found
    last_log, share = 0.0, 1.0
    for _ in range(config.most_rounds):
        refined = method.with_focal(_with_focal(rig, focal), maps, hypothesis, clock)
        hypothesis = replace(hypothesis, rotation=refined.rotation, position=refined.position)
        log = float(refined.log_factor)
        # Where rounds swing to and fro around the right one, they go half as far.
        share = share / 2 if log * last_log < 0 else share
        last_log, focal = log, min(max(focal * math.exp(log * share), bounds_px[0]), bounds_px[1])
        if abs(log) < math.log(config.settled):
            break
    return focal, float(refined.information)


def focal_uncertainty(information: float, config: FieldOfViewConfig) -> float:
    """Return the share that a focal length may be off by (68 %) that photos tell with so much information."""
    share = config.noise / math.sqrt(max(information, 1e-9))
    return min(max(share, config.least_uncertainty), config.most_uncertainty)


def _focal_px(camera: Camera, hfov_deg: float) -> float:
    return Camera.from_hfov("pinhole", camera.width_px, camera.height_px, hfov_deg).fx_px


def _with_focal(rig: Rig, focal_px: float, uncertainty: float = 0.0) -> Rig:
    """Return the rig of one photo with another focal length, pixels, which may be off by a share."""
    return rig.with_focal_factor(focal_px / rig.images[0].photo.camera.fx_px, uncertainty)
