"""The campaign in short: every kind of damaged file and request once or a few times."""

import socket
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from tests.campaign.flood import Flood

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_damaged_scans_images_and_requests_break_nothing() -> None:
    command = [sys.executable, "-m", "tests.campaign", "scans", "images", "requests", "--cases", "48", "--seed", "7"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]
    assert "| hostile scans | 48 |" in done.stdout
    assert "| hostile requests | 24 |" in done.stdout


@pytest.mark.slow
def test_impatient_callers_keep_their_connections_and_newcomers_bring_their_own() -> None:
    refusal = b"HTTP/1.1 429 Too Many Requests\r\nContent-Length: 2\r\n\r\n{}"
    connections: list[socket.socket] = []

    def answer(connection: socket.socket) -> None:
        data = b""
        while piece := connection.recv(65536):
            data += piece
            if data.endswith(b"--\r\n"):  # the end of a multipart body
                connection.sendall(refusal)
                data = b""

    def serve(listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                connections.append(listener.accept()[0])
                threading.Thread(target=answer, args=(connections[-1],), daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, args=(listener,), daemon=True).start()
        flood = Flood(f"http://127.0.0.1:{listener.getsockname()[1]}", "map_1")
        impatient = flood.of_impatient(3, 0.5)
        assert len(connections) == 3 < len(impatient.status)
        newcomers = flood.of_newcomers(20, 0.5)
        assert len(connections) == 3 + len(newcomers.status) == 13
    assert set(impatient.status) == set(newcomers.status) == {429}
    assert impatient.wrong == newcomers.wrong == 0
