"""Measure what needs no service, as `panoloc bench` does, where torch and numpy alone are installed.

    python tests/benchmarks/bench_core.py [--part stages] [--quick] [--device cuda] [--threads 2] [--repeats 9] [--json FILE]

Without Pillow, decoding and pictures are left out of the stages, without zstandard the parts about registration and index. Prints one
JSON document per part.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from panoloc.lab.benchmark.core_parts import CORE_PARTS, CoreBenchmark, chosen_device, measurable_parts
from panoloc.lab.benchmark.painted_maps import Rooms
from panoloc.lab.benchmark.sizes import FULL, QUICK
from panoloc.lab.machine import machine, versions


def main() -> None:
    """Run the parts that the command line names, all when it names none."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--part", action="append", choices=list(CORE_PARTS))
    parser.add_argument("--quick", action="store_true", help="everything tiny")
    parser.add_argument("--device", choices=("cpu", "cuda"))
    parser.add_argument("--threads", type=int)
    parser.add_argument("--repeats", type=int)
    parser.add_argument("--json", type=Path, help="where to write the figures")
    arguments = parser.parse_args()
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    sizes = QUICK if arguments.quick else FULL
    if arguments.repeats:
        sizes = replace(sizes, repeats=arguments.repeats)
    device = chosen_device(arguments.device)

    def say(text: str) -> None:
        print(text, file=sys.stderr)

    run = CoreBenchmark(sizes, device, Rooms(device, say), say)
    described = {"machine": {**machine(), "device": str(device)}, "versions": versions(), "parts": {}}
    for name in arguments.part or measurable_parts():
        described["parts"][name] = CORE_PARTS[name](run)
        print(json.dumps({name: described["parts"][name]}))
        if arguments.json:
            arguments.json.write_text(json.dumps(described, indent=1) + "\n")


if __name__ == "__main__":
    main()
