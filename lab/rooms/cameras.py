"""The cameras that suites are photographed with: recipes of queries that are not full panoramas."""

from dataclasses import dataclass, replace

from core.options import Hints, SessionOptions
from lab.rooms.capture.shooting import Shooting


@dataclass(frozen=True)
class QueryCamera:
    """A way to photograph a query.

    shooting: how the images are taken; None: as a full panorama with a defect drawn over it. session: what is known of their poses among
    each other; None: of one image nothing, its own frame is the session. hints: of the call. masked: the mask
    covers the defect exactly.
    """

    description: str
    shooting: Shooting | None
    session: SessionOptions | None = None
    hints: Hints | None = None
    masked: bool = False


_UP, _FREE = SessionOptions(up_known=True), SessionOptions(up_known=False)
_IN_THE_HAND = Shooting(arm_m=(0.3, 0.7), pitch_deg=8.0)
_PHOTO = Shooting()
_ANY_WAY = Shooting(pitch_deg=60.0, roll_deg=180.0)

_ONE: dict[str, QueryCamera] = {
    "photo": QueryCamera("one level photo, 69 x 54 degrees, nothing known of its orientation", _PHOTO),
    "photo_upright": QueryCamera(
        "the photos of `photo` with the hint that they are upright", _PHOTO, None, Hints(upright=True)
    ),
    "photo_free": QueryCamera("one photo held in any way: portrait, turned, up to 60 degrees up or down", _ANY_WAY),
    "photo_gravity": QueryCamera("the photos of `photo_free` with their gravity, as a phone has it", _ANY_WAY, _UP),
    "photo_wide": QueryCamera("one level photo, 100 degrees wide", replace(_PHOTO, hfov_deg=(100.0, 100.0))),
    "fisheye": QueryCamera(
        "one level image of a fisheye, 150 to 190 degrees", replace(_PHOTO, model="opencv_fisheye", hfov_deg=(150, 190))
    ),
    "sweep": QueryCamera(
        "a phone's sweep panorama: a cylinder 180 to 360 degrees wide and 50 high",
        Shooting("cylindrical", (180.0, 360.0), vfov_deg=50.0, pitch_deg=3.0, roll_deg=3.0),
    ),
    "void": QueryCamera(
        "full panoramas with void, holes, bars, patches or fills without a mask, detected or not as the image is read",
        None,
    ),
    "void_masked": QueryCamera("the panoramas of `void` with a perfect mask", None, masked=True),
}
_SEVERAL: dict[str, QueryCamera] = {
    "frames2": QueryCamera(
        "two frames at a right angle, turned in the hand 0.3 to 0.7 m from the body; poses with 1 cm and 0.5 degrees of noise",
        replace(_IN_THE_HAND, num_images=(2, 2), apart_deg=90.0),
        _UP,
    ),
    "frames4": QueryCamera(
        "four frames 60 degrees apart, as `frames2`", replace(_IN_THE_HAND, num_images=(4, 4), apart_deg=60.0), _UP
    ),
    "frames6": QueryCamera(
        "six frames all around, as `frames2`", replace(_IN_THE_HAND, num_images=(6, 6), apart_deg=60.0), _UP
    ),
    "frames_walk": QueryCamera(
        "four to eight frames on a walk of two metres, looking around, as `frames2`",
        replace(_IN_THE_HAND, num_images=(4, 8), apart_deg=None, walk_m=2.0),
        _UP,
    ),
}
CAMERAS: dict[str, QueryCamera] = {
    **_ONE,
    **_SEVERAL,
    **{
        f"{name}_free": replace(
            camera, description=f"the images of `{name}` in axes that know no gravity", session=_FREE
        )
        for name, camera in _SEVERAL.items()
    },
}
