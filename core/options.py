"""What a caller may choose: how a scan is read, how its map is built, what narrows a query, and the words for it.

Neither torch nor numpy, so that whoever takes requests can make these values without loading the algorithm. Every default
and every limit of a choice stands here once.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

from panoloc.core.errors import OptionsError, ScanTooLargeError

Vector = tuple[float, float, float]
Box = tuple[Vector, Vector]

Method = Literal["fast", "paper"]
Status = Literal["localized", "ambiguous", "not_localized"]
Frame = Literal["ros", "opencv", "webxr", "unity"]
Unit = Literal["m", "cm", "mm", "ft", "us-ft"]
UpAxis = Literal["z", "y", "x", "-z", "-y", "-x"]
UnitChoice = Literal[Unit, "auto"]
UpAxisChoice = Literal[UpAxis, "auto"]
ColorKind = Literal["rgb", "labels"]
StartsMethod = Literal["octree", "grid"]
ExportFormat = Literal[
    "tour",
    "plan",
    "potree",
    "navvis",
    "colmap",
    "colmap-rig",
    "opensfm",
    "nerfstudio",
    "metashape",
    "arcgis",
    "stac",
    "e57",
    "gpano",
    "ros",
    "tum",
    "gltf",
    "psv",
    "pannellum",
    "geojson",
]
ReportFormat = Literal["html", "pdf", "csv", "geojson", "bcf"]
"""Of what changed since a scan."""

FORMATS_ON_EARTH: frozenset[ExportFormat] = frozenset({"arcgis", "stac", "gpano", "geojson"})
"""They have places on Earth, so that a map needs a georeference or a coordinate system."""

METRES_PER_UNIT: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "us-ft": 1200 / 3937}

FARTHEST_M = 1e8
"""Of any coordinate: nothing on Earth lies farther from the origin of its frame, geocentric ones included."""
MIN_SPACING_M, MAX_SPACING_M = 0.05, 50.0
"""Of the distance of starts."""
MIN_POINTS = 100
"""Of a scan that becomes a map: fewer are a mistake of the export, not a place."""
MAX_TOP_K = 20
"""Poses that one answer may hold; the search keeps 32 candidates, and those close together are one pose."""
MAX_PIXELS = 100_000_000
"""Of an image that is decoded, where nobody says otherwise."""
CAMERAS_FILE = "cameras.json"
"""In a folder of photos: {name of a photo: its camera as `cameras` of a query have it}."""


@dataclass(frozen=True)
class ScanOptions:
    """How to read a scan.

    unit: length unit of the file's coordinates. up_axis: the axis that points up in the file. height_unit: of the coordinates along
    it. "auto": as the file says, else as it looks. coordinate_system: of the coordinates, where it was given; its units count as the
    file's own. color_kind: "labels" are colour codes of classes and never averaged.
    max_points: a file with more points is refused before anything is allocated.
    max_points_used: how many points may remain after voxel thinning.
    format: file extension ("ply", ".laz"), used when the path has none.
    from_strangers: the file is parsed in a process of its own whatever its format, not only where its format needs that.

    Raises OptionsError for a value out of its range.
    """

    unit: UnitChoice = "auto"
    up_axis: UpAxisChoice = "auto"
    height_unit: UnitChoice = "auto"
    coordinate_system: str | None = None
    color_kind: ColorKind = "rgb"
    max_points: int = 200_000_000
    max_points_used: int = 500_000
    format: str | None = None
    from_strangers: bool = False

    def __post_init__(self) -> None:
        _check_choice("unit", self.unit, UnitChoice)
        _check_choice("up_axis", self.up_axis, UpAxisChoice)
        _check_choice("height_unit", self.height_unit, UnitChoice)
        _check_choice("color_kind", self.color_kind, ColorKind)
        for name, value in (("max_points", self.max_points), ("max_points_used", self.max_points_used)):
            if value < 1:
                raise OptionsError(f"{name}: expected at least 1, got {value}")

    def check_num_points(self, num_points: int) -> None:
        """Raise ScanTooLargeError for more points than may be read."""
        if num_points > self.max_points:
            raise ScanTooLargeError(
                f"expected a scan of at most {self.max_points:,} points, got {num_points:,}; "
                "thin or split the scan before uploading"
            )


@dataclass(frozen=True)
class IndexOptions:
    """What the operator may choose for a map.

    starts_method: "octree" (rooms) or "grid" (open spaces). spacing_m: distance of starts, metres; None: from the configuration.
    region: (min, max) in the scan's own frame, metres, where cameras can be. color_kind: "rgb" or semantic "labels".

    Raises OptionsError for a value out of its range.
    """

    starts_method: StartsMethod = "octree"
    spacing_m: float | None = None
    region: Box | None = None
    color_kind: ColorKind = "rgb"

    def __post_init__(self) -> None:
        _check_choice("starts.method", self.starts_method, StartsMethod)
        _check_choice("color_kind", self.color_kind, ColorKind)
        if self.spacing_m is not None and not MIN_SPACING_M <= self.spacing_m <= MAX_SPACING_M:
            raise OptionsError(
                f"starts.spacing_m: expected {MIN_SPACING_M:g} to {MAX_SPACING_M:g} metres, got {self.spacing_m}"
            )
        if self.region is not None and not all(low < high for low, high in zip(*self.region, strict=True)):
            raise OptionsError(f"starts.region: expected min below max on every axis, got {self.region}")


@dataclass(frozen=True)
class PosePrior:
    """Where the caller expects the first camera: `map_from_camera` in the axes of `frame`.

    position_m: (x, y, z), metres. quaternion_xyzw: a unit quaternion. position_std_m, orientation_std_deg: standard deviations. is_only:
    nothing is searched elsewhere, and what fits best there is the answer.
    """

    position_m: Vector
    quaternion_xyzw: tuple[float, float, float, float]
    frame: Frame = "ros"
    position_std_m: float = 0.3
    orientation_std_deg: float = 5.0
    is_only: bool = False


@dataclass(frozen=True)
class Hints:
    """What the caller knows beforehand; every field but the last narrows the search and is never exceeded by the answer.

    position_m: (x, y, z) in the map's own frame, metres, with `radius_m` around it.
    region: ((min x, y, z), (max x, y, z)) in the map's own frame, metres.
    upright: the camera is level within `max_tilt_deg`.
    heading_deg: yaw of the image centre, counter-clockwise about z from +x, within `heading_tolerance_deg`.
    prior: is looked at first, in a query of one map; it may be wrong, for then everything is searched, unless it is the only one.
    """

    position_m: Vector | None = None
    radius_m: float | None = None
    region: Box | None = None
    upright: bool = False
    max_tilt_deg: float | None = None
    heading_deg: float | None = None
    heading_tolerance_deg: float | None = None
    prior: PosePrior | None = None

    @property
    def is_narrowing(self) -> bool:
        """Return whether there is any hint that the answer may not exceed, or a prior beside which nothing is searched."""
        return replace(self, prior=None) != Hints() or self.has_only_prior

    @property
    def has_only_prior(self) -> bool:
        """Return whether nothing is searched beside the prior."""
        return self.prior is not None and self.prior.is_only

    @property
    def most_tilt_deg(self) -> float | None:
        """Return how far the camera may be tilted, degrees; None for any."""
        if self.max_tilt_deg is not None:
            return self.max_tilt_deg
        return DEFAULT_TOLERANCE_DEG if self.upright else None


@dataclass(frozen=True)
class TrackedPose:
    """`session_from_camera` as a device's own tracking gives it, in the axes of the query's `frame`.

    position_m: (x, y, z), metres. quaternion_xyzw: a unit quaternion.
    """

    position_m: Vector = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class SessionOptions:
    """What is known of the poses of a session.

    up_known: the session's up axis is against gravity. position_noise_m, orientation_noise_deg: standard deviations of the tracking
    between images, which widen the radii of the answer.
    """

    up_known: bool = False
    position_noise_m: float = 0.01
    orientation_noise_deg: float = 0.5


MAX_SESSION_TILT_DEG = 5.0
"""Of a session whose up axis is known, against gravity: phones are right within two degrees."""
MAX_IMAGES = 32
"""Of one query."""
MAX_SESSION_SPAN_M = 100.0
"""Between the first image of a session and any other: what is farther apart is a mistake of the tracking, or in other units."""
MAX_POSITION_NOISE_M, MAX_ORIENTATION_NOISE_DEG = 1.0, 30.0
"""Of a tracking that still says something."""
QUATERNION_TOLERANCE = 0.01
"""Of the norm of a quaternion that is called unit: devices and JSON writers round."""

DEFAULT_RADIUS_M = 5.0
"""Of a hinted position without a radius."""
DEFAULT_TOLERANCE_DEG = 45.0
"""Of a camera that is said to be upright, or to look somewhere, without a tolerance: people hold phones at 20 to 30 degrees."""


def _check_choice(name: str, value: str, choices: Any) -> None:
    allowed = get_args(choices)
    if value not in allowed:
        raise OptionsError(f"{name}: expected {', '.join(allowed[:-1])} or {allowed[-1]}, got {value!r}")
