"""People who look for their place with a phone: in new rooms, from anywhere, with cameras and arms of any length."""

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from panoloc.core.scan.ply.writer import encode_ply
from panoloc.lab.rooms import SceneSpec, build_scene, scan_scene
from panoloc.lab.rooms.capture.free_space import free_position
from tests.campaign.outcome import Outcome, quantile
from tests.integration.phone import Found, Hand, camera_browser, phone_at
from tests.integration.running_service import RunningService

_PER_ROOM = 4
_NEAR_M = 0.1
_OTHER_SIDE_DEG = 110.0


def phones(count: int, seed: int) -> Outcome:
    """Let `count` phones find their place. Who is not sure of it looks again, turned to another side, as the page says.

    Whoever is told a wrong place, or none after that, is a fault.
    """
    outcome, began, founds = Outcome("phones"), time.monotonic(), []
    for hand, found in _found(count, seed):
        founds.append(found)
        print(f"phone {len(founds)}: {found}", file=sys.stderr, flush=True)
        if not (found.is_sure and found.error_m < _NEAR_M):
            outcome.faults.append(f"{found}, a camera of {hand.longer_hfov_deg:.0f} degrees at {hand.arm_m:.2f} m")
    errors, waits = [found.error_m for found in founds], [found.seconds for found in founds]
    outcome.cases, outcome.seconds = len(founds), time.monotonic() - began
    outcome.figures = {
        "within 0.1 m": f"{count - len(outcome.faults)} of {count}",
        "looked again": str(sum(found.num_tries > 1 for found in founds)),
        "median error": f"{quantile(errors, 0.5):.3f} m",
        "pictures": f"{sum(found.num_shots for found in founds) / count:.1f}",
        "wait": f"{quantile(waits, 0.5):.1f} s, at most {max(waits):.1f} s",
    }
    return outcome


def _found(count: int, seed: int) -> Iterator[tuple[Hand, Found]]:
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        service = RunningService(Path(folder) / "data")
        try:
            service.wait_until_ready()
            for number in range(count):
                if number % _PER_ROOM == 0:
                    scene = build_scene(SceneSpec(kind="room", seed=seed + number, area_m2=float(rng.uniform(12, 40))))
                    map_id = service.register(encode_ply(scan_scene(scene, num_points=200_000)), "{}")
                hand = Hand(
                    scene,
                    free_position(scene, rng),
                    yaw_deg=float(rng.uniform(0, 360)),
                    pitch_deg=float(rng.uniform(-8, 8)),
                    arm_m=float(rng.uniform(0.3, 0.4)),
                    longer_hfov_deg=float(rng.uniform(62, 76)),
                )
                with camera_browser() as through, phone_at(f"{service.http.base_url}/m/{map_id}", through) as phone:
                    found = phone.find(hand)
                    if not found.is_sure:
                        print(f"looks again after {found}", file=sys.stderr, flush=True)
                        hand = replace(hand, yaw_deg=hand.yaw_deg + _OTHER_SIDE_DEG)
                        found = replace(phone.find(hand), num_tries=2)
                    yield hand, found
        finally:
            service.stop()
