"""`scripts/count-instructions`: how many instructions a query takes, one thread, which no other work on the machine changes.

Counted by callgrind, whose processor has AVX2 and no more. The first query is not counted.
"""

import os
import pickle
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import torch

from panoloc.core.kernels.library import kernels_name
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_codec import decode_map_index, encode_map_index
from panoloc.lab.rooms.suites import suite_cases

_QUERIES = {"panorama": "changed", "one photo": "changed/photo", "six frames": "changed/frames6"}
_SEED, _POINTS = 3, 150_000
_VALGRIND = ("valgrind", "--tool=callgrind", "--instr-atstart=no", "--callgrind-out-file=/dev/null")


def main() -> None:
    """Count each kind of query, and print a table."""
    print("| query | million instructions | answer |\n|---|---|---|")
    for name, suite in _QUERIES.items():
        (case,) = suite_cases(suite, [_SEED], num_points=_POINTS)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "query.pickle"
            path.write_bytes(pickle.dumps((case.query, case.hints, encode_map_index(build_map_index(case.cloud)))))
            done = subprocess.run(
                [*_VALGRIND, sys.executable, "-m", __spec__.name, str(path)], capture_output=True, text=True, check=True
            )
        collected = re.search(r"Collected : (\d+)", done.stderr)
        assert collected is not None, done.stderr
        print(f"| {name} | {int(collected[1]) / 1e6:,.0f} | {done.stdout.strip()} |", flush=True)


def answer(path: Path) -> None:
    """Answer the query in a file twice, the second time counted."""
    torch.set_num_threads(1)
    query, hints, encoded = pickle.loads(path.read_bytes())
    localizer, index = Localizer(device="cpu"), decode_map_index(encoded)
    localizer.localize(query, [index], hints=hints)
    _count("on")
    found = localizer.localize(query, [index], hints=hints)
    _count("off")
    print(f"{found.status}, kernels {kernels_name()}")


def _count(switch: str) -> None:
    subprocess.run(["callgrind_control", f"--instr={switch}", str(os.getpid())], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        answer(Path(sys.argv[1]))
    else:
        main()
