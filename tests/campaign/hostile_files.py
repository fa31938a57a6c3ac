"""Damaged scans, images and masks, given to the readers that workers use: only errors of `core` may come out, and soon."""

import contextlib
import multiprocessing
import os
import random
import tempfile
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from panoloc.core.errors import CoreError
from panoloc.core.options import ScanOptions, SessionOptions
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.reading import read_scan
from panoloc.service.jobs import QueryImage
from panoloc.service.worker.query_images import read_query
from tests.campaign.damage import damaged
from tests.campaign.outcome import Outcome, quantile
from tests.core.built_maps import BOX
from tests.core.image.picture_files import encoded
from tests.core.scan.scan_files import las_of
from tests.core.scan.test_photos_in_every_kind import KINDS

_CHUNK = 250
_LONGEST_S = 60.0
_SCAN = ScanOptions(max_points=200_000, max_points_used=2000)

_PCD = (
    b"VERSION .7\nFIELDS x y z r g b\nSIZE 4 4 4 1 1 1\nTYPE F F F U U U\nCOUNT 1 1 1 1 1 1\nWIDTH 1000\nHEIGHT 1\n"
    b"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1000\nDATA ascii\n"
)

Try = Callable[[str, bytes], None]


def hostile_scans(num_cases: int, seed: int) -> Outcome:
    """Read damaged scans of every kind."""
    cloud = BOX.scan(1000)
    rows = np.hstack([cloud.positions, np.round(cloud.colors * 255)])
    text = "\n".join(" ".join(f"{value:g}" for value in row) for row in rows).encode()
    seeds = {"room.ply": encode_ply(cloud), "room.las": las_of(cloud), "room.xyz": text, "room.pcd": _PCD + text}
    return _tried(
        "hostile scans", seeds | {name: make(BOX) for name, make in KINDS.items()}, _read_scan, num_cases, seed
    )


def hostile_images(num_cases: int, seed: int) -> Outcome:
    """Read damaged images and masks."""
    pixels = np.random.default_rng(0).integers(0, 256, (64, 128, 3)).astype(np.uint8)
    seeds = {kind: encoded(pixels, kind) for kind in ("JPEG", "PNG", "WEBP")}
    return _tried("hostile images and masks", seeds, _read_image, num_cases, seed)


def _read_scan(name: str, data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(name).name
        path.write_bytes(data)
        read_scan(path, _SCAN)


def _read_image(_: str, data: bytes) -> None:
    whole = encoded(np.full((64, 128, 3), 90, np.uint8))
    with contextlib.suppress(CoreError):
        read_query([QueryImage(whole, mask=data)], "ros", SessionOptions(), 10**7)
    read_query([QueryImage(data)], "ros", SessionOptions(), 10**7)


def _tried(part: str, seeds: dict[str, bytes], attempt: Try, num_cases: int, seed: int) -> Outcome:
    """Try damaged files in processes of their own, which native code may end."""
    outcome, began, lasted = Outcome(part), time.monotonic(), [0.0]
    refused = dead = 0
    fork = multiprocessing.get_context("fork")
    for first in range(0, num_cases, _CHUNK):
        numbers = range(first, min(num_cases, first + _CHUNK))
        ours, theirs = fork.Pipe(duplex=False)
        child = fork.Process(target=_chunk, args=(theirs, seeds, attempt, numbers, seed))
        child.start()
        theirs.close()
        with contextlib.suppress(EOFError):
            while True:
                was_refused, fault, seconds = ours.recv()
                outcome.cases += 1
                refused += was_refused
                lasted.append(seconds)
                if fault:
                    outcome.faults.append(fault)
        child.join()
        if child.exitcode:
            dead += 1
            outcome.faults.append(f"a process ended with {child.exitcode} at case {outcome.cases} of seed {seed}")
    outcome.seconds = time.monotonic() - began
    longest_s = max(lasted)
    if longest_s > _LONGEST_S:
        outcome.faults.append(f"one file took {longest_s:.0f} s")
    outcome.figures = {
        "refused": f"{refused:,}", "dead processes": str(dead), "p99": f"{1000 * quantile(lasted, 0.99):.0f} ms",
        "longest": f"{longest_s:.1f} s",
    }  # fmt: skip
    return outcome


def _chunk(answers: Connection, seeds: dict[str, bytes], attempt: Try, numbers: range, seed: int) -> None:
    os.environ["OMP_NUM_THREADS"] = "1"
    names = sorted(seeds)
    for number in numbers:
        chance = random.Random(f"{seed}-{number}")
        name = names[number % len(names)]
        began, refused, fault = time.monotonic(), False, ""
        try:
            attempt(name, damaged(seeds[name], chance))
        except CoreError:
            refused = True
        except Exception as error:
            fault = f"case {number}, {name}: {type(error).__name__}: {error}"[:300]
        answers.send((refused, fault, time.monotonic() - began))
