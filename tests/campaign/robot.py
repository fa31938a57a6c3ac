"""A robot that drives through a flat for a minute, with odometry that errs: how far off it is with corrections and without."""

import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.campaign.outcome import Outcome
from tests.integration.running_service import RunningService
from tests.ros2.drive import STEP_S, Drive, Faults, drive, flat, scan_of
from tests.ros2.running_node import environment, errors, errors_of_odometry, played, running_node

SECONDS = 60.0
DRIVES = {
    "drift": Faults(),
    "slip of 0.5 m after 25 s": Faults(slip=(25.0, 0.5)),
    "carried away after 25 s": Faults(carried=(25.0, 8.0)),
}
_FOUND_AGAIN_M = 0.3


def robot(seed: int) -> Outcome:
    """Drive once for each fault. A fault of the campaign: a robot that is lost at the end, or was never found."""
    outcome, began = Outcome("robot"), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pl-") as name:
        folder = Path(name)
        scene = flat(seed)
        drives = {fault: drive(scene, SECONDS, 0.4, faults) for fault, faults in DRIVES.items()}
        service = RunningService(folder / "data")
        try:
            service.wait_until_ready()
            map_id = service.register(scan_of(scene), "{}")
            for fault, driven in drives.items():
                drive_once(outcome, fault, driven, str(service.http.base_url), map_id, folder)
        finally:
            service.stop()
    outcome.cases, outcome.seconds = len(drives), time.monotonic() - began
    return outcome


def drive_once(outcome: Outcome, fault: str, driven: Drive, url: str, map_id: str, folder: Path) -> None:
    """Play a drive to a node and a service, and add how far off the robot was, and what is a fault."""
    variables = environment()
    with running_node(url, map_id, folder / "node.log", variables):
        heard = played(driven, folder, variables, speed=1.0)
    metres, degrees = errors(driven, heard)
    known = ~np.isnan(metres)
    if not known.any() or metres[-1] > _FOUND_AGAIN_M:
        outcome.faults.append(f"{fault}: lost at the end: {(folder / 'node.log').read_text()[-2000:]}")
        return
    alone_m, alone_deg = errors_of_odometry(driven)
    told = [
        f"first pose after {np.argmax(known) * STEP_S:.1f} s",
        f"odometry alone {_spread(alone_m, alone_deg, known)}",
        f"corrected {_spread(metres, degrees, known)}",
    ]
    if "drift" not in fault:
        lost = np.flatnonzero(metres[round(25 / STEP_S) :] > _FOUND_AGAIN_M)
        told.append(f"found again after {(lost[-1] + 1 if len(lost) else 0) * STEP_S:.1f} s")
    outcome.figures[f"{fault}:"] = "; ".join(told)


def _spread(metres: NDArray[np.float64], degrees: NDArray[np.float64], known: NDArray[np.bool_]) -> str:
    """Return median, 95th percentile and maximum."""
    each_m, each_deg = (np.percentile(each[known], (50, 95, 100)) for each in (metres, degrees))
    return "/".join(f"{each:.2f}" for each in each_m) + " m " + "/".join(f"{each:.1f}" for each in each_deg) + "°"
