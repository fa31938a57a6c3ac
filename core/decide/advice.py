"""What a caller may do about an answer that does not tell a place."""

from panoloc.core.camera.rig import Rig
from panoloc.core.options import Hints
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
_FOCAL_LENGTH_IS_UNKNOWN = Remark(
    "accuracy_too_low",
    "the field of view is not known well enough to tell where the photo was taken; give it exactly (hfov_deg, --hfov 69.4) or intrinsics",
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


def with_advice(found: Localization, rig: Rig, hints: Hints | None) -> Localization:
    """Return the answer with what to do where it tells no place or several, and with what of the images was left out."""
    if found.status == "not_localized" and not found.warnings:
        found = found.warned(*why_nothing_fits(rig, hints))
    if found.status == "ambiguous":
        found = found.warned(_PLACES_LOOK_ALIKE)
    return found.warned(*(Remark("regions_ignored", words) for words in rig.left_out))


def accuracy_too_low(rig: Rig) -> Remark:
    """Say what is not known well enough of a rig to say where its first image was taken."""
    return _FOCAL_LENGTH_IS_UNKNOWN if len(rig.images) == 1 else _NOISE_IS_TOO_LARGE


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
