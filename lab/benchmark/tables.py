"""The figures of the benchmark as tables for people."""

from collections.abc import Callable
from typing import Any

from rich.markup import escape

from panoloc.lab.display import table

Figures = dict[str, Any]


def tables_of(document: Figures) -> list[object]:
    """Return what was measured on, and one table or more for each part of a document."""
    tables: list[object] = [_machine_line(document)]
    for name, figures in document["parts"].items():
        tables += _TABLES[name](figures)
    return tables


def _machine_line(document: Figures) -> str:
    machine, versions = document["machine"], document["versions"]
    device = machine["cuda_device"] if machine["device"] == "cuda" else machine["processor"]
    size = ", quick sizes: these figures say only that everything runs" if document["quick"] else ""
    return escape(
        f"{device}, {machine['cpu_count']} processors, {machine['threads']} threads; "
        f"panoloc {versions['panoloc']}, Python {versions['python']}, torch {versions['torch']}, numpy {versions['numpy']}"
        f"{size}. Milliseconds are medians (quartiles)."
    )


def _stages(figures: Figures) -> list[object]:
    height = round((figures["pixels"] / 2) ** 0.5)
    size = f"{figures['points']:,} points used, {figures['starts']} starts, {2 * height} x {height} pixels"
    rows = [
        {
            "stage": name,
            "median (quartiles)": _spread(spread),
            "from": f"{spread['min_ms']:.1f}",
            "to": f"{spread['max_ms']:.1f}",
        }
        for name, spread in figures["stages"].items()
    ]
    error_m, error_deg = figures["position_error_m"], figures["orientation_error_deg"]
    off = "" if error_m is None else f", off by {error_m * 1000:.1f} mm and {error_deg:.2f}°"
    return [table(rows, 1, f"Stages of a query, ms ({size})"), f"The answer was {figures['status']}{off}."]


def _registration(figures: Figures) -> list[object]:
    rows = []
    for row in figures["rows"]:
        one, total = row["median"], row["total"]
        rows.append(
            {
                "scan": row["scan_format"],
                "points": f"{one['points']:,}",
                "used": f"{one['points_used']:,}",
                "starts": one["starts"],
                "file MB": _mb(one["scan_bytes"]),
                "index MB": _mb(one["index_bytes"]),
                "total": f"{total['median_ms'] / 1000:.1f} ({total['min_ms'] / 1000:.1f} to {total['max_ms'] / 1000:.1f})",
                "peak MB": _mb(row["peak_bytes"]),
                "before MB": _mb(one["base_bytes"]),
            }
        )
    stages = [f"{name} {seconds:.2f}" for name, seconds in figures["rows"][-1]["median"]["seconds"].items()]
    return [table(rows, 1, "Registration, s"), f"Of the last: {', '.join(stages)} s"]


def _index(figures: Figures) -> list[object]:
    row = {
        "points": f"{figures['points']:,}",
        "starts": figures["starts"],
        "encoded MB": _mb(figures["encoded_bytes"]),
        "in memory MB": _mb(figures["resident_bytes"]),
        "encode ms": _spread(figures["encode"]),
        "decode ms": _spread(figures["decode"]),
    }
    return [table([row], 0, "Map index")]


def _maps(figures: Figures) -> list[object]:
    rows = []
    for row in figures["rows"]:
        stages = dict(row["stages"])
        total = _spread(stages.pop("total"))
        counts = {name: f"{row[name]:,}" for name in ("maps", "starts", "points", "pixels")}
        names = {name: 0 for query in figures["rows"] for name in query["stages"] if name != "total"}
        times = {name: f"{stages[name]['median_ms']:.1f}" if name in stages else "–" for name in names}
        # A synthetic view is one start seen with one rotation.
        view_us = stages["search"]["median_ms"] * 1000 / (row["starts"] * row["rotations"])
        rows.append(
            {**counts, **times, "total": total, "search µs per view": f"{view_us:.3f}", "status": row["status"]}
        )
    return [table(rows, 0, "One query over maps, ms")]


def _query(figures: Figures) -> list[object]:
    place, paper = figures["map"], figures["paper"] or {}
    size = f"{place['num_points_used'] or 0:,} points used, {place['num_starts']} starts"
    title = f"Queries over HTTP, ms ({size}, {figures['panorama_width']} pixels wide)"
    rows = [
        {
            **{name: row[name] for name in ("method", "clients", "queries", "failed", "localized")},
            **_latency(row),
            "mean": f"{row['latency']['mean_ms']:.0f}",
            "queries per s": f"{row['throughput_per_s']:.2f}",
        }
        for row in [*figures["rows"], *([paper] if "latency" in paper else [])]
    ]
    stages = [f"{name} {ms:.0f}" for name, ms in figures["rows"][0]["service_stages_ms"].items()]
    tables: list[object] = [table(rows, 2, title), f"The service says of the first row: {', '.join(stages)} ms"]
    if paper.get("ratio"):
        tables.append(f"The method paper took {paper['ratio']:.0f} times as long as the method fast.")
    return tables


def _cameras(figures: Figures) -> list[object]:
    rows = [
        {
            **{name: row[name] for name in ("camera", "images", "queries", "right", "localized")},
            **_latency(row),
            "to a panorama": f"{row['ratio']:.2f}",
        }
        for row in figures["rows"]
    ]
    title = f"Cameras over HTTP, furnished rooms of which 60 % has changed ({figures['points']:,} points)"
    return [table(rows, 1, title)]


def _memory(figures: Figures) -> list[object]:
    idle, after = figures["idle_by_process"], figures["after_by_process"]
    sizes = {name: (idle.get(name, 0), after.get(name, 0)) for name in after | idle}
    sizes["together"] = figures["idle_bytes"], figures["after_bytes"]
    rows = [
        {"process": name, "idle": _mb(before), f"after {figures['queries']} queries": _mb(then)}
        for name, (before, then) in sizes.items()
    ]
    peak = f"At most {_mb(figures['peak_bytes'])} MB while it answered."
    return [table(rows, 1, "Memory of the service (PSS), MB"), peak]


_TABLES: dict[str, Callable[[Figures], list[object]]] = {
    "stages": _stages,
    "registration": _registration,
    "index": _index,
    "maps": _maps,
    "query": _query,
    "cameras": _cameras,
    "memory": _memory,
}


def _latency(row: Figures) -> dict[str, str]:
    return {"p50": f"{row['latency']['median_ms']:.0f}", "p95": f"{row['latency']['p95_ms']:.0f}"}


def _spread(spread: Figures) -> str:
    return f"{spread['median_ms']:.1f} ({spread['lower_quartile_ms']:.1f}–{spread['upper_quartile_ms']:.1f})"


def _mb(num_bytes: int) -> str:
    return f"{num_bytes / 1e6:.1f}"
