"""One picture for each quantity that was swept."""

from pathlib import Path
from typing import Any

import pytest

from lab.benchmark.plots import write_plots


@pytest.mark.slow
def test_each_sweep_becomes_a_picture(parts: dict[str, dict[str, Any]], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    written = write_plots(parts["scaling"]["rows"], tmp_path) or []
    assert [path.name for path in written] == [
        "cost-starts.png",
        "cost-rotations.png",
        "cost-points.png",
        "cost-pixels.png",
        "cost-maps.png",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in written)


def test_without_matplotlib_nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.benchmark.plots.find_spec", lambda name: None)
    assert write_plots([], tmp_path / "out") is None
    assert not (tmp_path / "out").exists()
