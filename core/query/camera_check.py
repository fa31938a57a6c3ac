"""Whether photos agree with the focal length that they are said to have.

A crop, a zoom, a video of a phone that shows less than its photos: a field of view that is some degrees off puts a camera decimetres too
near or too far, and everything else fits, so that no score tells. But a focal length that is refined with the pose comes out right where
photos have any information of it, and how much they have is known (see `panoloc.core.refine.focal_refinement`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.hypotheses import MethodResult
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.query.engine import Engine
from panoloc.core.query.field_of_view import focal_uncertainty
from panoloc.core.stage_clock import StageClock

_WHAT_TO_DO = (
    "check fx_px, hfov_deg or the focal length in the EXIF data, and whether images were cropped or zoomed; "
    "of a crop off the middle send cx_px and cy_px"
)


@dataclass(frozen=True)
class CheckedCameras:
    """A rig with the cameras that its answer is for, the result with them, and what a caller should know of them.

    are_others: whether they are others than those given. bound_deg: the bound of the field of view, degrees, that a searched one has come
    to; None where it is between both, or was not searched.
    """

    rig: Rig
    result: MethodResult
    are_others: bool = False
    warnings: tuple[str, ...] = ()
    bound_deg: float | None = None


def checked_cameras(
    method: Engine,
    rig: Rig,
    maps: Sequence[MapIndex],
    hints: Hints | None,
    clock: StageClock,
    result: MethodResult,
    config: LocalizerConfig,
) -> CheckedCameras:
    """Look whether photos contradict their focal length at the best pose found, where that would be answered.

    Where they do, they are localized with the one that they want, and that is kept where it is an answer and fits clearly better; for one
    in thirty want another although theirs is right. Where there is no time for that, the answer says what they want.
    """
    check, field_of_view = config.camera_check, config.field_of_view
    if result.focal_pull < check.suspect or not method.is_answer(result):
        return CheckedCameras(rig, result)
    best = result.hypotheses[0]
    refined = method.with_focal(rig, maps, best, clock)
    log_factor = float(refined.log_factor)
    if refined.strength < check.contradicting or abs(log_factor) < check.least_log:
        return CheckedCameras(rig, result)
    share = focal_uncertainty(float(refined.information), field_of_view)
    wanted = rig.with_focal_factor(math.exp(log_factor), share)
    if not clock.is_past_half():
        again = method.run(wanted, maps, hints, clock)
        is_answer = method.is_answer(again)
        if is_answer and again.hypotheses[0].score >= check.better * best.score:
            warning = f"the pose is for {_widths(rig, wanted)}, which fits better; {_WHAT_TO_DO}"
            return CheckedCameras(wanted, again, are_others=True, warnings=(warning,))
    warning = f"some of what is seen would fit better for {_widths(rig, wanted)}; {_WHAT_TO_DO}"
    return CheckedCameras(rig, result, warnings=(warning,))


def _widths(given: Rig, fitting: Rig) -> str:
    """Say how wide the first image is in both."""
    widths = [rig.images[0].photo.camera.hfov_deg for rig in (fitting, given)]
    of = "an image" if len(given.images) == 1 else "images of which the first is"
    return f"{of} {widths[0]:.1f} degrees wide, not {widths[1]:.1f} as given"
