"""The verdict: from judged hypotheses to how sure each place is, whether to say so, and what a caller may do where no place is told.

One model decides: a pose is localized where it is probably right; ambiguous where it would be if its aliases were not there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from panoloc.core.camera.rig import Rig
from panoloc.core.config import DISTANCES, JudgeConfig
from panoloc.core.decide.agreement import PhotoAgreement
from panoloc.core.decide.confidence import ConfidenceModel
from panoloc.core.decide.hypotheses import NO_NOISE, Accuracy, Hypothesis, distinct
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.options import Hints, Status
from panoloc.core.remarks import Remark
from panoloc.core.results import Localization

_PLACES_LOOK_ALIKE = Remark(
    "places_look_alike",
    "several places look the same from here; send an image that shows where they differ, several frames on the way there, or a hint of the "
    "place",
)
_HINTS_MAY_BE_WRONG = Remark(
    "widen_hints",
    "no pose within the hints fits well enough; if the hints could be wrong, widen them or leave them out",
)
_HINTS_LEAVE_NOTHING = Remark("widen_hints", "the hints leave no pose to search; widen them or leave them out")
_NOTHING_IN_REACH = Remark(
    "nothing_in_reach",
    "no pose in reach of the scan fits after refinement; the camera may have been outside of it",
)
_PANORAMA_MAY_BE_WRONG = Remark(
    "check_image",
    "no pose fits the panorama well enough; if it shows this place, much of what it shows has changed, or it is no full sphere: "
    "describe a crop or a stretched image (options.cameras)",
)
_CAMERA_MAY_BE_WRONG = Remark(
    "check_camera",
    "no pose fits the photo well enough; if it shows this place, much of what it shows has changed, or its field of view is not as given "
    "(a crop, a zoom): let it be searched within bounds (hfov_range_deg, --hfov 45-90)",
)
_NOTHING_WITHIN_BOUNDS = Remark(
    "check_camera",
    "no pose fits the photo well enough with any field of view within its bounds; if it shows this place, much of what it shows has "
    "changed, or its field of view lies beyond them: give it (hfov_deg, --hfov 69), or other bounds",
)
_FOCAL_LENGTH_MAY_BE_WRONG = Remark(
    "accuracy_too_low",
    "the photo fits another focal length better than the one given, and shows too little to tell where it was taken; check whether it was "
    "cropped, zoomed or turned, or send one that shows more of the place",
)
_FOCAL_LENGTH_IS_UNKNOWN = Remark(
    "accuracy_too_low",
    "the field of view is not known well enough to tell where the photo was taken; give it exactly (hfov_deg, --hfov) or, if that "
    "is it, the intrinsics (fx_px) or a photo that shows more of the place",
)
_NOISE_IS_TOO_LARGE = Remark(
    "accuracy_too_low",
    "the field of view, or the tracking between images, is not known well enough to say where the first image was taken; "
    "give the field of view (hfov_deg) or the intrinsics, more images, or a smaller noise of the tracking (position_noise_m)",
)
_CAMERAS_MAY_BE_WRONG = Remark(
    "check_camera",
    "no pose fits the images well enough; if they show this place, much of what they show has changed, "
    "or cameras or poses are not as given (options.cameras, session_from_camera, frame)",
)


@dataclass(frozen=True)
class Verdict:
    """Hypotheses at different places, best first, the confidence of each, what to say of the best one, and its radii.

    num_equals: how many places come first together: 1, or those that look the same.
    """

    places: list[Hypothesis]
    confidences: list[float]
    status: Status
    accuracy: Accuracy
    num_equals: int = 1


def verdict(
    hypotheses: Sequence[Hypothesis], model: ConfidenceModel, noise: Accuracy = NO_NOISE, prior: float = 1.0
) -> Verdict:
    """Judge the places of hypotheses, at least one, the best first. noise: what adds to the errors of the pose itself. prior: how probable
    it is that the right place is in one of the maps that were searched."""
    places = distinct(hypotheses, DISTANCES.place)
    best, *rivals = places
    accuracy = model.accuracy(best, noise)

    def confidence_against(some: Sequence[Hypothesis]) -> float:
        """Return how sure the best is if these were its only rivals."""
        most = model.threshold / 2 if best.beyond_limits else accuracy.share_right
        return model.among(min(model.confidence(best, some), most), prior)

    aliases = [rival for rival in rivals if rival.is_alias]
    others = [rival for rival in rivals if not rival.is_alias]
    against_all = confidence_against(rivals)
    if against_all < model.threshold <= confidence_against(others):
        shared = [against_all, *(against_all * min(odds, 1.0) for odds in model.alias_odds(best, aliases))]
        confidences = shared + _left_over(others, 1 - sum(shared), min(shared))
        return Verdict([best, *aliases, *others], confidences, "ambiguous", accuracy, len(shared))
    status: Status = "localized" if against_all >= model.threshold else "not_localized"
    confidences = [against_all, *_left_over(rivals, 1 - against_all, against_all)]
    return Verdict(places, confidences, status, accuracy)


def _left_over(places: Sequence[Hypothesis], left: float, most: float) -> list[float]:
    """Return confidences of places that come after the best ones: what is left, by their scores, and none above `most`.

    Of each less was measured than of the best, and only one of them is right.
    """
    total = sum(max(place.score, 0.0) for place in places)
    return [min(most, left * max(place.score, 0.0) / max(total, 1e-12)) for place in places]


class Doubts:
    """The rules. threshold: the confidence from which on an answer is localized."""

    def __init__(self, config: JudgeConfig, threshold: float) -> None:
        self._config, self._threshold = config, threshold

    def unless_contradicted(
        self,
        found: Localization,
        agreements: Sequence[PhotoAgreement | None],
        is_first_elsewhere: Callable[[], bool],
    ) -> Localization:
        """Return the answer, not localized where images contradict the pose that fits the others: more than a few, or the first.

        Two frames of four that fit can outweigh two that are of another place, or whose poses are wrong. is_first_elsewhere: tells whether
        the first image is by itself elsewhere than the others put it; asked where it fits worst, or was not compared. The pose of the
        answer is that of this image.
        """
        judge = self._config
        known = [k for k, each in enumerate(agreements) if each is not None]
        doubtful = [k for k, each in enumerate(agreements) if each is not None and each.contradicts(judge)]
        count, is_lost = len(agreements), found.status == "not_localized"
        if found.best is None or count == 1 or (is_lost and doubtful == known):
            return found  # of another place, all of them: nothing that some of them contradict
        if not is_lost and 0 not in doubtful and _fits_worst(agreements[0], agreements[1:]) and is_first_elsewhere():
            doubtful = [0, *doubtful]
        share = len(doubtful) / count
        is_refused = not is_lost and (share > judge.contradicting_share or 0 in doubtful)
        # A pose that is metres from the others spoils the fit of all: which of them agree then says little.
        outside = [k for k in range(count) if k not in known] if is_lost or is_refused else []
        blamed = outside or doubtful
        if not blamed:
            return found
        found = found.warned(_contradiction(blamed, count, bool(outside)))
        return self._refused(found, 1 - share) if is_refused else found

    def unless_plain(self, found: Localization, edges_deg: float | None) -> Localization:
        """Return the answer, not localized where images show hardly any edges: a plain wall in soft light fits in many places, and which of
        them fits best is chance. edges_deg: how long all edges are together; None: nobody knows."""
        if found.status == "not_localized" or edges_deg is None or edges_deg >= self._config.least_edges_deg:
            return found
        words = (
            "the image shows next to no edges, as a plain wall does; only one that shows more of the place can be found"
        )
        return self._refused(found.warned(Remark("turn_more", words)))

    def unless_at_bound(self, found: Localization, bound_deg: float | None) -> Localization:
        """Return the answer, not localized where the photo fits best with a field of view at one of the bounds that it was searched
        within: it may lie beyond."""
        if bound_deg is None:
            return found
        at_bound = f"when it is {bound_deg:g} degrees wide, a bound of the range (hfov_range_deg, --hfov)"
        if found.status == "not_localized":
            lost = f"nothing fits well enough; what fits best does so {at_bound}: widen it if the photo may lie beyond"
            return found.warned(Remark("widen_hfov_range", lost))
        return self._refused(found.warned(Remark("widen_hfov_range", f"the photo fits best {at_bound}; widen it")))

    def _refused(self, found: Localization, share: float = 1.0) -> Localization:
        """Return the answer as one that is not localized, no surer than a share of what it was and half the threshold; nor are its
        alternatives."""
        assert found.best is not None
        most = min(found.best.confidence * share, self._threshold / 2)
        found = found.with_each(lambda one: replace(one, confidence=min(one.confidence, most)))
        return replace(found, status="not_localized")


def _fits_worst(first: PhotoAgreement | None, others: Sequence[PhotoAgreement | None]) -> bool:
    """Return whether the scan explains no more of an image than of any other, or whether it was not compared."""
    return first is None or all(first.share_explained <= each.share_explained for each in others if each is not None)


def is_elsewhere(judged: Verdict, found: Pose, expected: Pose) -> bool:
    """Return whether an image is surely farther from where it is expected than right poses are, and than twice its radius, which is no
    chance. judged, found: of that image alone."""
    error, right, radii = pose_error(found, expected), DISTANCES.right, judged.accuracy
    most = (
        max(right.distance_m, 2 * (radii.position_m or 0.0)),
        max(right.angle_deg, 2 * (radii.orientation_deg or 0.0)),
    )
    return judged.status == "localized" and not error.within(*most)


def _contradiction(doubtful: Sequence[int], count: int, are_outside: bool) -> Remark:
    """Say of which images, counted from 0, the poses or cameras must be wrong. are_outside: they show nothing of the scan."""
    numbers, is_one = [str(k + 1) for k in doubtful], len(doubtful) == 1
    named = f"image {numbers[0]}" if is_one else f"images {', '.join(numbers[:-1])} and {numbers[-1]}"
    its = "its" if is_one else "their"
    if are_outside:
        said = f"{named} of {count} would lie outside of the scan at the pose that fits best"
        return Remark(
            "images_contradict",
            f"{said}; check frame and {its} session_from_camera, or leave {'it' if is_one else 'them'} out",
        )
    said = f"{named} of {count} {'does' if is_one else 'do'} not agree with the pose that fits the others"
    cameras = "the field of view of its camera" if is_one else "the field of view of their cameras"
    unless = "unless much of what is seen there has changed"
    return Remark("images_contradict", f"{said}; check frame, {its} session_from_camera and {cameras}, {unless}")


def with_advice(found: Localization, rig: Rig, hints: Hints | None) -> Localization:
    """Return the answer with what to do where it tells no place or several, and with what of the images was left out."""
    if found.best is None:
        found = found.warned(*why_there_is_no_pose(found.search.num_poses, hints))
    elif found.status == "not_localized" and not found.warnings:
        found = found.warned(*why_nothing_fits(rig, hints))
    if found.status == "ambiguous":
        found = found.warned(_PLACES_LOOK_ALIKE)
    return found.warned(*(Remark("regions_ignored", words) for words in rig.left_out))


def accuracy_too_low(rig: Rig) -> Remark:
    """Say what is not known well enough of a rig to say where its first image was taken."""
    if len(rig.images) > 1:
        return _NOISE_IS_TOO_LARGE
    photo = rig.photos[0]
    is_known = not photo.focal_uncertainty and photo.hfov_range_deg is None
    return _FOCAL_LENGTH_MAY_BE_WRONG if is_known else _FOCAL_LENGTH_IS_UNKNOWN


def why_there_is_no_pose(num_poses: int, hints: Hints | None) -> tuple[Remark, ...]:
    """Say what may be wrong where a search of so many poses left none."""
    if num_poses == 0:
        return (_HINTS_LEAVE_NOTHING,)
    is_narrowed = hints is not None and hints.is_narrowing
    return (_HINTS_MAY_BE_WRONG, _NOTHING_IN_REACH) if is_narrowed else (_NOTHING_IN_REACH,)


def why_nothing_fits(rig: Rig, hints: Hints | None) -> tuple[Remark, ...]:
    """Say what may be wrong with a rig that no pose fits well."""
    reasons = [_HINTS_MAY_BE_WRONG] if hints is not None and hints.is_narrowing else []
    photos = rig.photos
    if len(photos) > 1:
        reasons.append(_CAMERAS_MAY_BE_WRONG)
    elif photos[0].camera.is_whole_sphere:
        reasons.append(_PANORAMA_MAY_BE_WRONG)
    else:
        reasons.append(_CAMERA_MAY_BE_WRONG if photos[0].hfov_range_deg is None else _NOTHING_WITHIN_BOUNDS)
    return tuple(reasons)
