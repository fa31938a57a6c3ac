"""Time the search alone: score maps and scores of all poses, for the `fast` and the `paper` method.

    python tests/benchmarks/bench_search.py [--threads 2] [--repeats 15] [--device cpu] [--json FILE]

Random histograms of the shape that a room gives (about 12 of 512 bins in a patch). Needs torch and numpy only. Rows: 100 starts x
2,304 rotations with one colour model, with four, with ten times the rotations, with ten times the starts. Medians after a warm-up.
"""

import argparse
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from core.config import SearchConfig
from core.intersection import bin_major, intersection_tensor
from core.patch_descriptors import (
    centered_roots,
    normalize_per_view,
    principal_basis,
    similarity_tensor,
)
from core.pose_scores import score_poses, select_candidates
from core.rotations import uniform_rotations
from core.score_maps import score_map_2d, view_patch_scores
from core.spherical_patches import PatchGrid, rotation_table

CONFIG = SearchConfig()
GRID = PatchGrid(CONFIG.patch_rows, CONFIG.patch_columns)
OCCUPIED_BINS = 12
# starts, rotations, colour models
ROWS = ((100, 2304, 1), (100, 2304, 4), (100, 23040, 1), (1000, 2304, 1))


@dataclass(frozen=True)
class Timing:
    """One row of the table; times in milliseconds, the last one per synthetic view (start x rotation)."""

    method: str
    starts: int
    rotations: int
    color_models: int
    tensor_ms: float
    score_maps_ms: float
    scores_ms: float
    total_ms: float
    fastest_ms: float
    slowest_ms: float
    per_view_ms: float


def random_histograms(rng: np.random.Generator, views: int) -> Tensor:
    """Return histograms (V, P, bins³) with about a dozen occupied bins each."""
    num_bins = CONFIG.bins**3
    histograms = np.zeros((views * len(GRID), num_bins), np.float32)
    bins = rng.integers(0, num_bins, (len(histograms), OCCUPIED_BINS))
    np.put_along_axis(histograms, bins, rng.dirichlet(np.ones(OCCUPIED_BINS), len(histograms)).astype(np.float32), 1)
    histograms /= histograms.sum(axis=1, keepdims=True)
    return torch.from_numpy(histograms.reshape(views, len(GRID), num_bins))


class FastSearch:
    """What `core.search` computes for one map; the map's side is prepared beforehand, as at registration."""

    name = "fast"

    def __init__(self, rng: np.random.Generator, starts: int, rotations: Tensor, device: torch.device) -> None:
        solid = GRID.solid_angles()
        parts = [random_histograms(rng, min(100, starts - first)) for first in range(0, starts, 100)]
        self.basis = principal_basis(centered_roots(parts[0], solid)[0], CONFIG.descriptor_size).to(device)
        centered = [centered_roots(part, solid) for part in parts]
        self.views = torch.cat([roots @ self.basis.cpu() for roots, _ in centered]).to(device)
        self.view_weights = torch.cat([weights for _, weights in centered]).to(device)
        query, weights = centered_roots(random_histograms(rng, 1), solid)
        self.query, self.weights = query[0].to(device), weights[0].to(device)
        self.rotations = rotations.to(device)
        self.table = rotation_table(GRID, rotations).to(device)
        self.positions = torch.rand((starts, 3), generator=torch.Generator().manual_seed(0)).to(device) * 6

    def tensor(self) -> Tensor:
        return normalize_per_view(
            similarity_tensor(self.query @ self.basis, self.views), self.weights, self.view_weights
        )

    def scores(self, tensor: Tensor) -> Tensor:
        scores = score_poses(tensor, self.table, self.weights)
        limits = CONFIG.distinct_angle_deg, CONFIG.distinct_distance_m
        return select_candidates(scores, self.positions, self.rotations, CONFIG.num_candidates, *limits).scores


class PaperSearch:
    """Histogram intersections, score maps and Eq. 4 on the search grid."""

    name = "paper"

    def __init__(self, rng: np.random.Generator, starts: int, rotations: Tensor, device: torch.device) -> None:
        parts = [random_histograms(rng, min(100, starts - first)) for first in range(0, starts, 100)]
        self.starts, self.views = starts, bin_major(torch.cat(parts)).to(device)
        self.query = random_histograms(rng, 1)[0].to(device)
        self.table = rotation_table(GRID, rotations).to(device)
        self.sines = GRID.polar_sines(device)

    def tensor(self) -> Tensor:
        return intersection_tensor(self.query, self.views, self.starts)

    def scores(self, tensor: Tensor) -> Tensor:
        weights = 0.5 * (score_map_2d(tensor, self.table) + self.sines)
        return score_poses(tensor, self.table, weights).flatten().topk(6).values


def timed(step: Callable[[], Tensor], device: torch.device) -> tuple[float, Tensor]:
    """Return milliseconds and the result."""
    began = time.perf_counter()
    result = step()
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return (time.perf_counter() - began) * 1000, result


def measure(
    search: FastSearch | PaperSearch, color_models: int, repeats: int, device: torch.device
) -> Sequence[list[float]]:
    """Return the times of the tensor, of the score maps, of the scores, and of all, for each repetition after two warm-ups."""
    times: list[list[float]] = [[], [], [], []]
    for repeat in range(repeats + 2):
        spent = [0.0, 0.0, 0.0]
        for _ in range(color_models):
            first, tensor = timed(search.tensor, device)

            def score_maps(tensor: Tensor = tensor) -> Tensor:
                score_map_2d(tensor, search.table)
                return view_patch_scores(tensor, search.table)

            second, _ = timed(score_maps, device)
            third, _ = timed(lambda tensor=tensor: search.scores(tensor), device)  # type: ignore[misc]
            spent = [a + b for a, b in zip(spent, (first, second, third), strict=True)]
        if repeat >= 2:
            for column, value in zip(times, (*spent, sum(spent)), strict=True):
                column.append(value)
    return times


def benchmark(repeats: int, device: torch.device) -> list[Timing]:
    """Measure every row for both methods."""
    found = []
    for kind in (FastSearch, PaperSearch):
        for starts, num_rotations, models in ROWS:
            search = kind(np.random.default_rng(0), starts, uniform_rotations(num_rotations), device)
            times = measure(search, models, repeats, device)
            tensor_ms, maps_ms, scores_ms, total_ms = (statistics.median(column) for column in times)
            per_view = total_ms / (starts * num_rotations * models)
            fastest, slowest = min(times[3]), max(times[3])
            row = (kind.name, starts, num_rotations, models)
            found.append(Timing(*row, tensor_ms, maps_ms, scores_ms, total_ms, fastest, slowest, per_view))
    return found


def machine(device: torch.device) -> dict[str, str | int]:
    """Describe what was measured on."""
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else processor_name()
    return {
        "device": name,
        "threads": torch.get_num_threads(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "numpy": np.__version__,
        "system": platform.platform(),
    }


def processor_name() -> str:
    """Return the processor's name, as the system tells it."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def print_table(rows: Sequence[Timing]) -> None:
    """Print the rows as aligned columns."""
    print(
        f"{'method':7} {'starts':>6} {'rotations':>9} {'models':>6} {'tensor':>8} {'maps':>8} {'scores':>8} {'total':>8}  ms  spread"
    )
    for row in rows:
        print(
            f"{row.method:7} {row.starts:6} {row.rotations:9} {row.color_models:6} {row.tensor_ms:8.1f} {row.score_maps_ms:8.1f} "
            f"{row.scores_ms:8.1f} {row.total_ms:8.1f}      {row.fastest_ms:.1f} to {row.slowest_ms:.1f}, "
            f"{row.per_view_ms * 1000:.3f} µs per view"
        )


def main() -> None:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--json", type=Path, help="where to write the figures")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    device = torch.device(arguments.device)
    with torch.inference_mode():
        rows = benchmark(arguments.repeats, device)
    described = {"machine": machine(device), "rows": [asdict(row) for row in rows]}
    print_table(rows)
    text = json.dumps(described, indent=1)
    if arguments.json:
        arguments.json.write_text(text + "\n")
    print(json.dumps(described["machine"]))
    if not arguments.json:
        print(text)


if __name__ == "__main__":
    main()
