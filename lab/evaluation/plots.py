"""Plots of an evaluation: how errors are distributed, and how honest the confidence is. Needs matplotlib, which is optional."""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from lab.evaluation.ranking_metrics import reliability_bins
from lab.evaluation.rows import RIGHT, Row


def write_plots(rows: Sequence[Row], folder: Path) -> list[Path] | None:
    """Write errors.png and reliability.png to `folder` and return their paths; None when matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    by_method = {name: [r for r in rows if r.method == name] for name in dict.fromkeys(r.method for r in rows)}
    return [_error_plot(by_method, folder / "errors.png"), _reliability_plot(by_method, folder / "reliability.png")]


def _error_plot(by_method: dict[str, list[Row]], path: Path) -> Path:
    """Plot the share of queries whose error is below each value; a query without a pose never is."""
    figure, axes = _figure(2)
    for axis, field, label, span in (
        (axes[0], "position_error_m", "position error (m)", (1e-4, 30.0)),
        (axes[1], "orientation_error_deg", "orientation error (degrees)", (1e-3, 180.0)),
    ):
        for name, rows in by_method.items():
            own = [row for row in rows if not row.cross]
            errors = sorted(getattr(row, field) for row in own if getattr(row, field) is not None)
            shares = np.append(0, np.arange(1, len(errors) + 1)) / max(1, len(own))
            axis.step([span[0], *errors, span[1]], [*shares, shares[-1]], where="post", label=name)
        axis.set(xscale="log", xlabel=label, ylabel="share of queries", xlim=span, ylim=(0, 1.02))
        axis.grid(alpha=0.3)
        axis.legend()
    figure.savefig(path)
    return path


def _reliability_plot(by_method: dict[str, list[Row]], path: Path) -> Path:
    """Plot the share right (0.3 m, 10 degrees) over the confidence stated, with the number of answers at each bin."""
    figure, (axis,) = _figure(1)
    axis.plot([0, 1], [0, 1], color="grey", linestyle="--")
    for name, rows in by_method.items():
        answers = [row for row in rows if row.confidence is not None]
        confidences = np.array([row.confidence for row in answers], np.float64)
        bins = reliability_bins(confidences, np.array([row.within(RIGHT) for row in answers], bool))
        axis.plot([b.mean_probability for b in bins], [b.share_right for b in bins], marker="o", label=name)
        for one in bins:
            axis.annotate(str(one.count), (one.mean_probability, one.share_right), fontsize=7)
    axis.set(xlabel="confidence", ylabel="share within 0.3 m and 10 degrees", xlim=(-0.02, 1.02), ylim=(-0.02, 1.05))
    axis.grid(alpha=0.3)
    axis.legend()
    figure.savefig(path)
    return path


def _figure(columns: int) -> tuple[Any, Sequence[Any]]:
    # The object interface draws without a window system and keeps no global state.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5 * columns, 4.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, [figure.add_subplot(1, columns, k + 1) for k in range(columns)]
