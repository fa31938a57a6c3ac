"""The cameras that suites are photographed with; docs/evaluation.md describes each."""

from dataclasses import dataclass, replace

from panoloc.core.options import Hints, SessionOptions
from panoloc.lab.rooms.capture.shooting import Shooting


@dataclass(frozen=True)
class QueryCamera:
    """A way to photograph a query.

    shooting: how the images are taken; None: as a full panorama with a defect drawn over it. session: what is known of their poses among
    each other; None: of one image nothing, its own frame is the session. hints: of the call. masked: the mask
    covers the defect exactly.
    """

    shooting: Shooting | None
    session: SessionOptions | None = None
    hints: Hints | None = None
    masked: bool = False


_UP, _FREE = SessionOptions(up_known=True), SessionOptions(up_known=False)
_IN_THE_HAND = Shooting(arm_m=(0.3, 0.7), pitch_deg=8.0)
_PHOTO = Shooting()
_ANY_WAY = Shooting(pitch_deg=60.0, roll_deg=180.0)

_ONE: dict[str, QueryCamera] = {
    "photo": QueryCamera(_PHOTO),
    "photo_upright": QueryCamera(_PHOTO, hints=Hints(upright=True)),
    "photo_free": QueryCamera(_ANY_WAY),
    "photo_gravity": QueryCamera(_ANY_WAY, _UP),
    "photo_wide": QueryCamera(replace(_PHOTO, hfov_deg=(100.0, 100.0))),
    "fisheye": QueryCamera(replace(_PHOTO, model="opencv_fisheye", hfov_deg=(150, 190))),
    "sweep": QueryCamera(Shooting("cylindrical", (180.0, 360.0), vfov_deg=50.0, pitch_deg=3.0, roll_deg=3.0)),
    "void": QueryCamera(None),
    "void_masked": QueryCamera(None, masked=True),
}
_SEVERAL: dict[str, QueryCamera] = {
    "frames2": QueryCamera(replace(_IN_THE_HAND, num_images=(2, 2), apart_deg=90.0), _UP),
    "frames4": QueryCamera(replace(_IN_THE_HAND, num_images=(4, 4), apart_deg=60.0), _UP),
    "frames6": QueryCamera(replace(_IN_THE_HAND, num_images=(6, 6), apart_deg=60.0), _UP),
    "frames_walk": QueryCamera(replace(_IN_THE_HAND, num_images=(4, 8), apart_deg=None, walk_m=2.0), _UP),
}
CAMERAS: dict[str, QueryCamera] = {
    **_ONE,
    **_SEVERAL,
    **{f"{name}_free": replace(camera, session=_FREE) for name, camera in _SEVERAL.items()},
}
