"""A PNG that claims more pixels than it holds is damaged; a large one takes no more memory than it has to."""

import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import MaskDamagedError, PanoramaDamagedError
from panoloc.core.image.reader import read_panorama
from tests.core.image.picture_files import encoded, png, png_of_packed

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("raw", [b"", bytes(10_000), bytes(14_000 * 3 + 1) * 500], ids=["none", "a part", "some rows"])
def test_a_small_file_that_claims_many_pixels_is_damaged_and_costs_nothing(raw: bytes) -> None:
    image = png(14_000, 7000, 8, 2, raw)
    began = time.perf_counter()
    with pytest.raises(PanoramaDamagedError, match="ends early"):
        read_panorama(image)
    assert time.perf_counter() - began < 2
    whole = encoded(np.full((64, 128, 3), 90, np.uint8))
    with pytest.raises(MaskDamagedError, match="ends early"):
        read_panorama(whole, mask=image)


def test_a_picture_of_one_colour_is_whole_however_small_its_file() -> None:
    image = png(2048, 1024, 8, 2, (b"\0" + b"\x80\x70\x60" * 2048) * 1024)
    assert len(image) < 30_000
    assert read_panorama(image).color.shape == (1024, 2048, 3)


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the peak of Linux")
def test_the_largest_png_takes_less_than_a_gigabyte() -> None:
    program = """
import re, sys
from panoloc.core.image.reader import read_panorama
panorama = read_panorama(sys.stdin.buffer.read())
# Not ru_maxrss, which a process inherits from the one that started it.
peak = re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1]
print(panorama.color.shape[0], int(peak) // 1024)
"""
    rows, checksum, packing = (b"\0" + b"\x5a" * 42_000) * 70, 1, zlib.compressobj(1, wbits=-15)
    for _ in range(100):
        checksum = zlib.adler32(rows, checksum)
    # A block of rows a hundred times, which is quicker than to pack all rows.
    packed = (packing.compress(rows) + packing.flush(zlib.Z_FULL_FLUSH)) * 100
    image = png_of_packed(14_000, 7000, 8, 2, b"\x78\x01" + packed + b"\3\0" + checksum.to_bytes(4, "big"))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, input=image, cwd=ROOT, check=True)
    height, peak_mb = map(int, done.stdout.split())
    assert 512 <= height < 7000
    assert peak_mb < 1000  # of which torch takes a quarter
