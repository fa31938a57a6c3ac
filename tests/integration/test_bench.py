"""`panoloc bench --quick` with a service of its own, as a person runs it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.running_service import ROOT

pytestmark = pytest.mark.integration


def test_queries_and_memory_of_a_service_started_for_it(tmp_path: Path) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PANOLOC_", "RAY_"))}
    options = "--quick --threads 1 --clients 1 --queries 2 --part query --part memory --out"
    command = [sys.executable, "-m", "panoloc.service.cli", "bench", *options.split(), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment, timeout=250)
    log = tmp_path / "service.log"
    assert done.returncode == 0, done.stderr + (log.read_text() if log.exists() else "")
    parts = json.loads((tmp_path / "bench.json").read_text())["parts"]
    for row in [*parts["query"]["rows"], parts["query"]["paper"]]:
        assert row["failed"] == 0
        assert row["localized"] >= 1
        assert row["latency"]["p95_ms"] >= row["latency"]["median_ms"] > 0
    assert parts["query"]["map"]["num_points"] == 6_000
    memory = parts["memory"]
    assert memory["peak_bytes"] >= memory["after_bytes"] > 0
    assert any("panoloc-worker" in name for name in memory["idle_by_process"])
    assert "Queries over HTTP" in done.stdout
    assert "Memory of the service" in done.stdout
