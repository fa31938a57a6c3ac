"""Plots of what a query costs against the number of starts, rotations, points, pixels and maps. Needs matplotlib, which is optional."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from lab.benchmark.method.query_costs import PARAMETERS

_TOTAL = "total"
_SHOWN_SHARE = 0.01  # of the longest total; stages below it in every query crowd the legend


def write_plots(rows: Sequence[Mapping[str, Any]], folder: Path) -> list[Path] | None:
    """Write cost-PARAMETER.png for every swept parameter and return the paths; None when matplotlib is not installed.

    rows: of the part `scaling`, as dictionaries.
    """
    if find_spec("matplotlib") is None:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for parameter in PARAMETERS:
        swept = sorted((row for row in rows if row["parameter"] == parameter), key=lambda row: int(row["value"]))
        if swept:
            found.append(_cost_plot(parameter, swept, folder / f"cost-{parameter}.png"))
    return found


def _cost_plot(parameter: str, rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Plot medians over the parameter, with the quartiles of the total."""
    # The object interface draws without a window system and keeps no global state.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 4.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.add_subplot(1, 1, 1)
    values = [row["value"] for row in rows]
    stages = [row["query"]["figures"]["stages"] for row in rows]
    least = _SHOWN_SHARE * max(each[_TOTAL]["median_ms"] for each in stages)
    for name in stages[0]:
        medians = [each[name]["median_ms"] for each in stages]
        if max(medians) >= least:
            width = 2.5 if name == _TOTAL else 1.2
            axis.plot(values, medians, marker="o", linewidth=width, label=name)
    lower, upper = ([each[_TOTAL][f"{name}_quartile_ms"] for each in stages] for name in ("lower", "upper"))
    axis.fill_between(values, lower, upper, alpha=0.2)
    axis.set(xscale="log", yscale="log", xlabel=parameter, ylabel="milliseconds per query (median)")
    axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize=8)
    figure.savefig(path)
    return path
