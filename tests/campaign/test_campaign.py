"""The campaign in short: every kind of damaged file and request once or a few times."""

import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests.campaign.damage import damaged
from tests.campaign.outcome import Outcome, table

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_damaged_scans_images_and_requests_break_nothing() -> None:
    command = [sys.executable, "-m", "tests.campaign", "scans", "images", "requests", "--cases", "48", "--seed", "7"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert "| hostile scans | 48 |" in done.stdout
    assert "| hostile requests | 24 |" in done.stdout


def test_the_same_seed_damages_in_the_same_way() -> None:
    data = bytes(range(256)) * 4
    assert damaged(data, random.Random("1-2")) == damaged(data, random.Random("1-2")) != data


def test_faults_are_told_below_the_table() -> None:
    text = table([Outcome("soak", 3, 1.0, {"files": "1 → 9"}, ["files grew from 1 to 9"])])
    assert "| soak | 3 | 1 | files 1 → 9 | 1 |" in text
    assert "soak: files grew from 1 to 9" in text
