"""The campaign in short: every kind of damaged file and request once or a few times."""

import socketserver
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.changes.finding import Change
from panoloc.lab.rooms.capture.change_truth import ChangedObject
from tests.campaign.changes import Measured, area_under_curve, compare
from tests.campaign.flood import Flood
from tests.campaign.intake import drawn, intake, verdict_on

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_damaged_scans_images_and_requests_break_nothing() -> None:
    command = [sys.executable, "-m", "tests.campaign", "scans", "images", "requests", "--cases", "24", "--seed", "7"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert "| hostile scans | 24 |" in done.stdout
    assert "| hostile requests | 12 |" in done.stdout


@pytest.mark.slow
def test_no_scan_with_mixed_up_units_or_axes_is_silently_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.campaign.intake._POINTS", 15_000)
    outcome = intake(2, 96)  # in millimetres, with -y and -z up
    assert (outcome.faults, outcome.figures["right"]) == ([], "2")
    heights_in_feet = drawn(92_003)
    assert verdict_on(heights_in_feet) == ("asked", "up_axis_doubtful, unit_doubtful")


@pytest.mark.slow
def test_impatient_callers_keep_their_connections_and_newcomers_bring_their_own() -> None:
    refusal = b"HTTP/1.1 429 Too Many Requests\r\nContent-Length: 2\r\n\r\n{}"
    connections = 0

    class Busy(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            nonlocal connections
            connections += 1
            data = b""
            while piece := self.request.recv(65536):
                data += piece
                if data.endswith(b"--\r\n"):  # the end of a multipart body
                    self.request.sendall(refusal)
                    data = b""

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Busy) as server:
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        flood = Flood(f"http://127.0.0.1:{server.server_address[1]}", "map_1")
        impatient = flood.of_impatient(3, 0.5)
        assert connections == 3 < len(impatient.status)
        newcomers = flood.of_newcomers(20, 0.5)
        assert connections == 3 + len(newcomers.status) == 13
        server.shutdown()
    assert set(impatient.status) == set(newcomers.status) == {429}
    assert impatient.wrong == newcomers.wrong == 0


def test_objects_are_compared_with_the_truth_by_place_and_by_what_became_of_them() -> None:
    sizes = np.zeros(3), np.ones(3)
    true = [
        ChangedObject("sofa", is_new, True, low + sizes[0], low + sizes[1], np.zeros((0, 3)), 0.1, 100)
        for is_new, low in ((False, np.array([0.0, 0, 0])), (True, np.array([3.0, 0, 0])))
    ]
    moved = Change("1", "moved", np.array([3.6, 0.5, 0.5]), np.ones(3), np.array([0.5, 0.5, 0.7]), 0.9, (0,))
    made_up = Change("2", "came", np.array([0.5, 0.5, 0.5]), np.ones(3), None, 0.9, (0,))
    counts = Measured()
    assert compare([moved, made_up], true, counts) == pytest.approx([0.1, 0.2])
    assert (counts.recall, counts.precision, counts.moved_found) == (1.0, 2 / 3, 1)
    assert area_under_curve(np.array([0.1, 0.5, 0.5, 0.9], np.float32), np.array([False, False, True, True])) == 0.875
