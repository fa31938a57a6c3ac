"""`python -m tests.campaign.house_drive FOLDER`: a robot drives for a minute through a scanned house, with odometry that errs.

FOLDER: the case `house`. What the camera sees is rendered from the furnished scan; the map is that scan, or that of the empty house.
"""

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.core.render.render_cloud import make_render_cloud, point_spacing
from panoloc.core.render.synthetic_view import render_views
from panoloc.core.scan.reading import read_scan
from panoloc.lab.rooms import cut_photo
from tests.campaign.outcome import Outcome, table
from tests.campaign.robot import DRIVES, SECONDS, drive_once
from tests.integration.running_service import RunningService
from tests.ros2.drive import drive_along

_ROUTE = [(1.0, -0.5), (4.0, -1.5), (6.0, -1.0), (7.0, -3.5), (4.0, -3.0)]
"""Metres, between the furniture of the open part of the house."""
_ROWS = 1024


def main(arguments: Sequence[str]) -> int:
    """Print the errors of each drive in each map."""
    folder = Path(arguments[0])
    cloud = read_scan(folder / "scan_furnished.ply")
    points, colors = torch.from_numpy(cloud.positions), torch.from_numpy(cloud.colors).float() / 255
    rendered = make_render_cloud(points, colors, point_spacing(points))

    def photo(camera: Camera, body: Pose, number: int) -> NDArray[np.uint8]:
        """Return the rendering from the camera; the same at every visit."""
        center = torch.from_numpy(body.position - cloud.origin_offset).float()[None]
        view = render_views(rendered, center, _ROWS, with_points=False)
        panorama = Panorama((255 * view.color[0]).byte().numpy(), view.valid[0].numpy())
        return cut_photo(panorama, camera, body.rotation).color

    drives = {fault: drive_along(np.array(_ROUTE), photo, SECONDS, 0.4, faults) for fault, faults in DRIVES.items()}
    outcome, began = Outcome("robot in a house"), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pl-") as name:
        service = RunningService(Path(name) / "data")
        try:
            service.wait_until_ready()
            for state in ("furnished", "empty"):
                map_id = service.register((folder / f"scan_{state}.ply").read_bytes(), "{}")
                for fault, driven in drives.items():
                    drive_once(outcome, f"{state}, {fault}", driven, str(service.http.base_url), map_id, Path(name))
        finally:
            service.stop()
    outcome.cases, outcome.seconds = 2 * len(drives), time.monotonic() - began
    print(table([outcome]))
    return int(bool(outcome.faults))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
