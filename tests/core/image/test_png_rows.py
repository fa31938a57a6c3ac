"""A PNG that claims more pixels than it holds is damaged; a large one takes no more memory than it has to."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.errors import MaskDamagedError, PanoramaDamagedError
from panoloc.core.image.reader import read_panorama
from tests.core.image.picture_files import encoded, png

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
import io, numpy as np, re
from PIL import Image
from panoloc.core.image.reader import read_panorama
file = io.BytesIO()
Image.fromarray(np.full((7000, 14000, 3), 90, np.uint8)).save(file, "PNG", compress_level=1)
data = file.getvalue()
del file
panorama = read_panorama(data)
# Not ru_maxrss, which a process inherits from the one that started it.
peak = re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1]
print(panorama.color.shape[0], int(peak) // 1024)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=True)
    height, peak_mb = map(int, done.stdout.split())
    assert 512 <= height < 7000
    assert peak_mb < 1000  # of which torch and the writing of the image take two thirds
