"""Maps of the scans of a run, each built once: suites with different cameras show the same scan."""

import hashlib
import time
from dataclasses import dataclass, field

import torch

from core.index.map_builder import build_map_index
from core.index.map_index import MapIndex
from lab.evaluation.known_cases import LoadedScan


@dataclass
class BuiltMaps:
    """The maps that were asked for last, at most `kept`: they are large. device: "cpu", "cuda", None to choose."""

    device: str | None
    kept: int
    _built: dict[str, tuple[MapIndex, float]] = field(default_factory=dict)

    def of(self, scan: LoadedScan) -> tuple[MapIndex, float]:
        """Return the map of a scan and the seconds that it took to build."""
        key = _digest(scan)
        if key in self._built:
            found = self._built.pop(key)
        else:
            while len(self._built) >= self.kept:
                del self._built[next(iter(self._built))]
            began = time.perf_counter()
            device = self.device or ("cuda" if torch.cuda.is_available() else "cpu")
            index = build_map_index(scan.cloud, scan.options, device=device)
            found = index, time.perf_counter() - began
        self._built[key] = found  # the last one in it is the last one asked for
        return found


def _digest(scan: LoadedScan) -> str:
    """Return what only scans with the same points, colours and options have."""
    cloud = scan.cloud
    found = hashlib.sha256(repr((scan.options, cloud.num_points_read)).encode())
    for array in (cloud.positions, cloud.colors, cloud.origin_offset):
        found.update(repr((array.dtype, array.shape)).encode())
        found.update(array.tobytes())
    return found.hexdigest()
