"""Content that a tracker of the npm package keeps in place while somebody walks through a room for a minute."""

import sys
import tempfile
import time
from pathlib import Path

from tests.campaign.outcome import Outcome, quantile
from tests.integration.running_service import RunningService
from tests.integration.walked_room import Walked, walk_with_tracker, write_walk

_ROOMS, _WALKS = 3, 3
_LEAST = 0.95


def walks(seed: int) -> Outcome:
    """Walk through rooms with phones that drift in different ways. A walk in which content is off its place too often is a fault."""
    outcome, began, done = Outcome("walks"), time.monotonic(), list[Walked]()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        service = RunningService(Path(folder) / "data")
        try:
            service.wait_until_ready()
            for room in range(seed, seed + _ROOMS):
                place = Path(folder) / str(room)
                write_walk(place, room)
                map_id = service.register((place / "scan.ply").read_bytes(), "{}")
                for drift in range(1, _WALKS + 1):
                    done.append(walk_with_tracker(str(service.http.base_url), map_id, place, drift))
                    print(f"room {room}, phone {drift}: {done[-1]}", file=sys.stderr, flush=True)
                    if done[-1].in_place < _LEAST:
                        outcome.faults.append(
                            f"room {room}, phone {drift}: in place {done[-1].in_place:.3f} of the time"
                        )
        finally:
            service.stop()
    shares = sorted(walked.in_place for walked in done)
    outcome.cases, outcome.seconds = len(done), time.monotonic() - began
    outcome.figures = {
        "in place": f"{sum(shares) / len(shares):.3f} ({shares[0]:.3f} to {shares[-1]:.3f})",
        "median error": f"{quantile([walked.median_m for walked in done], 0.5):.3f} m",
        "queries": f"{sum(walked.num_queries for walked in done) / len(done):.0f} a walk",
    }
    return outcome
