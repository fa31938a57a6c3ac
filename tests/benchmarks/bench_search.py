"""Time the search alone: score maps and scores of all poses, for the `fast` and the `paper` method.

    python tests/benchmarks/bench_search.py [--threads 2] [--repeats 15] [--device cpu] [--json FILE]

Random histograms of the shape that a room gives (about 12 of 512 bins in a patch). Needs torch and numpy only. Rows: 100 starts x
2,304 rotations with one colour model, with four, with ten times the rotations, with ten times the starts, and 400 starts with four
models. Medians after a warm-up.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from lab.benchmark.method.search_benchmark import SearchTiming, time_search
from lab.benchmark.sizes import FULL
from lab.machine import machine, versions


def print_table(rows: Sequence[SearchTiming]) -> None:
    """Print the rows as aligned columns."""
    print("method  starts rotations models   tensor     maps   scores    total  ms  spread")
    for row in rows:
        parts = (row.tensor, row.score_maps, row.scores, row.total)
        print(
            f"{row.method:7} {row.starts:6} {row.rotations:9} {row.color_models:6} "
            f"{' '.join(f'{part.median_ms:8.1f}' for part in parts)}      "
            f"{row.total.min_ms:.1f} to {row.total.max_ms:.1f}, {row.view_us:.3f} µs per view"
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
    rows = time_search(replace(FULL, repeats=arguments.repeats), device)
    described = {"machine": {**machine(), **versions()}, "rows": [asdict(row) for row in rows]}
    print_table(rows)
    text = json.dumps(described, indent=1)
    if arguments.json:
        arguments.json.write_text(text + "\n")
    print(json.dumps(described["machine"]))
    if not arguments.json:
        print(text)


if __name__ == "__main__":
    main()
