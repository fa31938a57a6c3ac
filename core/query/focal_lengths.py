"""Focal lengths that are not known for certain: what is known of them before a pose is, and what poses say of them.

A crop, a zoom, a video of a phone that shows less than its photos: a camera with another field of view than stated seems to stand in front
of or behind its place, and all else fits nearly as well. So the focal length of the best pose becomes unknown number seven of the
refinement: images may contradict what is stated. Unless that was measured, the pose is also refined from where the camera would stand with
other focal lengths. These poses compete with the best one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Rig
from panoloc.core.config import FocalConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.errors import OptionsError
from panoloc.core.remarks import Remark
from panoloc.core.render.comparison import Comparison

_AT_BOUND_DEG = 0.1  # as far as rounding takes a field of view that is held at a bound
_WHAT_TO_DO = (
    "check fx_px, hfov_deg or the focal length in the EXIF data, and whether images were cropped or zoomed; "
    "of a crop off the middle send cx_px and cy_px"
)


@dataclass(frozen=True)
class FocalPrior:
    """What is known of the focal lengths of a rig: bounds of their logarithm over those of its cameras; whether these are stated, and so
    likelier than all others, or one guess among many; and whether they were measured, and so are others only where the images say so."""

    least: float
    most: float
    is_stated: bool
    is_measured: bool = False

    def is_as_stated(self, log_focal: float | None, step: float) -> bool:
        """Return whether a focal length, the logarithm of its factor, is the stated one: the search bears half a step."""
        return self.is_stated and log_focal is not None and abs(log_focal) < step / 2

    def is_guess(self, log_focal: float | None) -> bool:
        """Return whether a pose has the focal length that the search guessed, neither stated nor refined."""
        return log_focal is None and not self.is_stated

    def tried(self, step: float) -> list[float]:
        """Return the logarithms that poses are refined from."""
        every = [k * step for k in range(math.ceil(self.least / step), math.floor(self.most / step) + 1)]
        return [log for log in every if log] if self.is_stated else every


def focal_prior(rig: Rig, config: FocalConfig) -> FocalPrior | None:
    """Return what is known of the focal lengths of a rig; None where its cameras have none.

    Raises OptionsError where bounds are known of some of several photos, or others of each.
    """
    photos = rig.photos
    range_deg, *others = [photo.hfov_range_deg for photo in photos]
    if any(other != range_deg for other in others):
        raise OptionsError(
            "hfov_range_deg: expected the same bounds for all images, taken with one camera, got others; "
            "send hfov_deg or the intrinsics of each"
        )
    if not rig.has_focal_length:
        return None
    if range_deg is None:
        is_measured = not any(photo.focal_uncertainty for photo in photos)
        return FocalPrior(*config.bounds, is_stated=True, is_measured=is_measured)
    least, most = (_log_factor(photos[0].camera, width) for width in reversed(range_deg))
    return FocalPrior(least, most, is_stated=False)


def guesses(rig: Rig, config: FocalConfig) -> list[Rig]:
    """Return the rig with focal lengths so close together that the search finds the right pose with one of them; as it is where one is
    stated. Likewise an image without a focal length with the extents that it may have, a step or less apart."""
    if rig.has_unsure_extent:
        camera = rig.photos[0].camera
        if camera.hfov_deg < 360:
            others = [rig.with_other_extent(wider, 0.0) for wider in (-config.step, config.step)]
        else:  # a strip all around may have been cut on one side alone
            most = (math.pi - camera.height_px / camera.fy_px) / 2
            count = math.ceil(most / config.step)
            angles = [sign * most * k / count for k in range(1, count + 1) for sign in (-1, 1)]
            others = [rig.with_other_extent(0.0, higher) for higher in angles]
        return [rig, *(each for each in others if each is not None)]
    prior = focal_prior(rig, config)
    if prior is None or prior.is_stated:
        return [rig]
    count = max(1, math.ceil((prior.most - prior.least) / config.step))
    logs = [prior.least + (prior.most - prior.least) * (k + 0.5) / count for k in range(count)]
    return [rig.with_focal_factor(math.exp(log)) for log in logs]


def with_other_focal_lengths(
    best: Hypothesis, comparison: Comparison, prior: FocalPrior, axis: torch.Tensor, config: FocalConfig
) -> list[Hypothesis]:
    """Return where the camera of a pose would stand with other focal lengths: what it sees halfway deep keeps its size.

    comparison: of that pose alone. axis: (3,), the middle of the first image in the axes of the rig.
    """
    if comparison.depth_m is None:
        return []
    ahead, own = best.rotation @ axis * comparison.depth_m, best.log_focal or 0.0
    return [
        replace(best, position=best.position - ahead * (math.exp(log - own) - 1), log_focal=log)
        for log in prior.tried(config.step)
        if best.log_focal is None or abs(log - own) > config.step / 4
    ]


def contradicts(other: Hypothesis, best: Hypothesis, prior: FocalPrior, config: FocalConfig) -> bool:
    """Return whether images say that a stated focal length is another. other: the best pose, refined with its focal length unknown.

    It has to be another by more than chance, and to fit hardly worse: where next to nothing tells the focal length, scores fall. One that
    was measured is not wrong by a few percent.
    """
    if prior.is_measured and prior.is_as_stated(other.log_focal, config.step):
        return False
    return leaves_stated(other, config, config.contradiction) and other.score >= config.stated**2 * best.score


def leaves_stated(other: Hypothesis, config: FocalConfig, times: float) -> bool:
    """Return whether a pose has another focal length than the stated one by more than so many times its uncertainty."""
    return abs(other.log_focal or 0.0) > times * focal_uncertainty(other.information, config)


def focal_uncertainty(information: float, config: FocalConfig) -> float:
    """Return the share that a focal length may be off by (68 %) of which images have so much information."""
    return min(config.noise / math.sqrt(max(information, 1e-6)), 1.0)


@dataclass(frozen=True)
class FoundCameras:
    """The rig with the cameras that its answer is for, and what a caller should know of them.

    are_others: whether they are others than those given. bound_deg: the bound of the field of view, degrees, that a searched one has come
    to; None where it is between both, or was not searched.
    """

    rig: Rig
    are_others: bool = False
    warnings: tuple[Remark, ...] = ()
    bound_deg: float | None = None


def found_cameras(given: Rig, searched: Rig, hypotheses: Sequence[Hypothesis], config: FocalConfig) -> FoundCameras:
    """Return the cameras of the best of hypotheses. searched: the rig from whose focal lengths theirs are counted."""
    log_focal = hypotheses[0].log_focal if hypotheses else None
    rig = searched if log_focal is None else searched.with_focal_factor(math.exp(log_focal))
    if given.has_unsure_extent:  # pixels per radian in place of focal lengths
        log_focal = math.log(rig.photos[0].camera.fx_px / given.photos[0].camera.fx_px)
    range_deg, found_deg = given.photos[0].hfov_range_deg, rig.photos[0].camera.hfov_deg
    if range_deg is not None:
        bound = next((bound for bound in range_deg if abs(found_deg - bound) < _AT_BOUND_DEG), None)
        return FoundCameras(rig, True, bound_deg=bound)
    if log_focal is None:
        return FoundCameras(rig)
    if abs(log_focal) < config.step / 2:  # as given, as far as one image tells
        return FoundCameras(rig, True)
    is_one = len(given.images) == 1
    of = "an image" if is_one else "images of which the first is"
    widths = f"{found_deg:.1f} degrees wide, not {given.photos[0].camera.hfov_deg:.1f} as given"
    tracked = "" if is_one else "; check that positions of session_from_camera are in metres"
    words = f"the pose is for {of} {widths}, which fits better; {_WHAT_TO_DO}{tracked}"
    return FoundCameras(rig, True, (Remark("hfov_contradicted", words),))


def _log_factor(camera: Camera, hfov_deg: float) -> float:
    """Return the logarithm of the factor by which the focal length of a camera would be longer if it was so wide."""
    return math.log(Camera.from_hfov("pinhole", camera.width_px, camera.height_px, hfov_deg).fx_px / camera.fx_px)
