"""`panoloc ros2` and the robot as processes over DDS on the loopback, in a domain of their own."""

import os
import pickle
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.ros2.poses import distance_between
from tests.ros2.drive import STEP_S, Drive, motion

ROOT = Path(__file__).parents[2]
Array = NDArray[np.float64]
# Beside other tests and other machines nobody hears.
_LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)


def environment() -> dict[str, str]:
    """Return variables of a domain that nobody else is likely to use."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("PANOLOC_")}
    return own | {"CYCLONEDDS_URI": _LOOPBACK, "ROS_DOMAIN_ID": str(random.randrange(20, 200))}


@contextmanager
def running_node(url: str, map_id: str, log: Path, variables: dict[str, str], *options: str) -> Iterator[None]:
    """Run `panoloc ros2` until the end of the block."""
    command = [sys.executable, "-P", "-m", "panoloc.service.cli", "ros2", "--url", url, "--map", map_id, *options]
    with log.open("wb") as lines:
        node = subprocess.Popen(command, cwd=ROOT, env=variables, stdout=lines, stderr=lines)
    try:
        yield
    finally:
        node.send_signal(signal.SIGINT)
        try:
            node.wait(10)
        finally:
            node.kill()
            node.wait()


def played(drive: Drive, folder: Path, variables: dict[str, str], speed: float) -> dict[str, Any]:
    """Let the robot drive and return what it heard."""
    (folder / "drive").write_bytes(pickle.dumps(drive))
    command = [sys.executable, "-m", "tests.ros2.robot", str(folder / "drive"), str(folder / "heard"), str(speed)]
    subprocess.run(command, cwd=ROOT, env=variables, check=True, timeout=len(drive.truth) * STEP_S / speed + 60)
    heard: dict[str, Any] = pickle.loads((folder / "heard").read_bytes())
    return heard


def errors(drive: Drive, heard: dict[str, Any]) -> tuple[Array, Array]:
    """Return metres and degrees by which the robot in the map is off at each step, NaN before it knows."""
    found = [
        (np.nan, np.nan) if known is None else distance_between(known @ motion(odometry), motion(truth))
        for known, odometry, truth in zip(heard["map_from_odom"], drive.odometry, drive.truth, strict=True)
    ]
    metres, radians = np.array(found).T
    return metres, np.degrees(radians)


def errors_of_odometry(drive: Drive) -> tuple[Array, Array]:
    """Return the same of the odometry alone, had the first pose been right."""
    start = motion(drive.truth[0]) @ motion(drive.odometry[0]).inverse()
    return errors(drive, {"map_from_odom": [start] * len(drive.truth)})
