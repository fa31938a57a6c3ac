"""Named evaluation suites and their cameras: recipes of cases with known poses; docs/evaluation.md describes each."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from panoloc.core.errors import OptionsError
from panoloc.core.options import Hints, SessionOptions
from panoloc.lab.rooms.capture.camera_look import DIM, GAMMA_3, WHITE_BALANCE, as_photo, random_look
from panoloc.lab.rooms.capture.imperfect_scan import Imperfections
from panoloc.lab.rooms.capture.shooting import QueryCamera, Shooting
from panoloc.lab.rooms.cases import Case, Region, Suite, make_case
from panoloc.lab.rooms.scenes.generator import FAMILIES

_STREET_REGION: Region = ((-25.0, -5.0, 0.0), (25.0, 5.0, 5.0))

SUITES: dict[str, Suite] = {
    "rooms": Suite(),
    "changed": Suite(change=0.6),
    "camera": Suite(change=0.6, look=random_look),
    "flats": Suite(kind="flat", num_points=500_000),
    "flats_changed": Suite(kind="flat", change=0.6, num_points=500_000),
    "bare": Suite(kind="bare"),
    "dim": Suite(look=as_photo(DIM)),
    "gamma": Suite(look=as_photo(GAMMA_3)),
    "white_balance": Suite(look=as_photo(WHITE_BALANCE)),
    "night": Suite(at_night=True),
    "partial": Suite(max_elevation_deg=45.0),
    "sparse": Suite(num_stations=1, num_points=60_000),
    "imperfect": Suite(change=0.15, imperfections=Imperfections()),
    "survey": Suite(survey_frame=True),
    "twins": Suite(kind="twins"),
    "twins_like": Suite(kind="twins_like"),
    "mirrored": Suite(kind="mirrored"),
    "repeated": Suite(kind="repeated", num_points=500_000),
    "labels": Suite(color_kind="labels"),
    "labels_changed": Suite(change=0.6, color_kind="labels"),
    "street": Suite(kind="street", color_kind="labels", region=_STREET_REGION),
    "street_colors": Suite(kind="street", region=_STREET_REGION),
}

_UP, _FREE = SessionOptions(up_known=True), SessionOptions(up_known=False)
_IN_THE_HAND = Shooting(arm_m=(0.3, 0.7), pitch_deg=8.0)
_PHOTO = Shooting()
_ANY_WAY = Shooting(pitch_deg=60.0, roll_deg=180.0)

_ONE: dict[str, QueryCamera] = {
    "photo": QueryCamera(_PHOTO),
    "photo_upright": QueryCamera(_PHOTO, hints=Hints(upright=True)),
    "photo_free": QueryCamera(_ANY_WAY),
    "photo_gravity": QueryCamera(_ANY_WAY, _UP),
    "photo_tilted": QueryCamera(replace(_PHOTO, pitch_deg=25.0)),
    "photo_tilted_upright": QueryCamera(replace(_PHOTO, pitch_deg=25.0), hints=Hints(upright=True)),
    "photo_zoom": QueryCamera(_PHOTO, zoom=(1.2, 2.0)),
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


def suite_cases(
    name: str,
    seeds: Sequence[int],
    *,
    families: Sequence[str] | None = None,
    width: int = 1024,
    num_points: int | None = None,
) -> Iterator[Case]:
    """Yield one case per seed, made when asked for.

    name: a place, or `place/camera`. families: style families to draw from, None for all; holding some out tests generalization. width: of
    the panorama, or of a photo.
    num_points: of the scan, None for what the suite says.
    Raises OptionsError for an unknown suite or family.
    """
    place, slash, camera = name.partition("/")
    if place not in SUITES:
        raise OptionsError(f"suite: expected one of {', '.join(SUITES)}, alone or with /CAMERA, got {name!r}")
    if slash and camera not in CAMERAS:
        raise OptionsError(f"suite: expected a camera of {', '.join(CAMERAS)} after {place}/, got {name!r}")
    unknown = set(families or ()) - set(FAMILIES)
    if unknown:
        raise OptionsError(f"families: expected some of {', '.join(FAMILIES)}, got {', '.join(sorted(unknown))}")
    suite = SUITES[place] if num_points is None else replace(SUITES[place], num_points=num_points)
    return (make_case(name, suite, seed, families, width, CAMERAS[camera] if slash else None) for seed in seeds)
