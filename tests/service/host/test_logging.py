"""Logs of our own and of libraries look the same, and tracebacks show no values."""

import json
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import logging
import structlog
from panoloc.service.host.logging import configure_logging

configure_logging("info", {format!r})
structlog.contextvars.bind_contextvars(request_id="req_1")
structlog.get_logger("service.x").info("ours", map_id="map_1")
logging.getLogger("library").warning("theirs", extra={{"pid": 7, "color_message": "x"}})
structlog.get_logger("service.x").debug("too much")
try:
    secret = "hunter2"
    raise ValueError("broken")
except ValueError:
    structlog.get_logger("service.x").exception("a fault")
"""


def lines_of(log_format: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(format=log_format)],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[3],
    )
    assert done.stdout == ""
    return done.stderr.splitlines()


def test_json_lines_bear_the_request_id_and_every_field() -> None:
    ours, theirs, fault = map(json.loads, lines_of("json"))
    assert (ours["event"], ours["request_id"], ours["map_id"], ours["level"]) == ("ours", "req_1", "map_1", "info")
    assert (theirs["event"], theirs["pid"], theirs["logger"]) == ("theirs", 7, "library")
    assert "color_message" not in theirs
    assert theirs["timestamp"].endswith("Z")
    assert "ValueError: broken" in fault["exception"]


def test_a_traceback_for_people_does_not_show_variables() -> None:
    text = "\n".join(lines_of("console"))
    assert "ValueError: broken" in text
    assert "hunter2" not in text.replace('secret = "hunter2"', "")
