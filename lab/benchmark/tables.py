"""The figures of the benchmark as tables for people."""

from collections.abc import Callable, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

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
        f"{device}, {machine['cpu_count']} processors, {machine['torch_threads']} threads; "
        f"panoloc {versions['panoloc']}, Python {versions['python']}, torch {versions['torch']}, numpy {versions['numpy']}"
        f"{size}. Milliseconds are medians (quartiles)."
    )


def _search(figures: Figures) -> list[object]:
    table = _table(
        "Search with score maps, ms",
        ["method"],
        "starts",
        "rotations",
        "models",
        "tensor",
        "score maps",
        "scores",
        "total",
        "µs per view",
    )
    for row in figures["rows"]:
        steps = [_median(row[name]) for name in ("tensor", "score_maps", "scores")]
        counts = [f"{row[name]:,}" for name in ("starts", "rotations", "color_models")]
        table.add_row(row["method"], *counts, *steps, _spread(row["total"]), f"{row['view_us']:.3f}")
    return [table]


def _stages(figures: Figures) -> list[object]:
    title = f"Stages of a query, ms ({figures['points']:,} points used, {figures['starts']} starts, {_size(figures['pixels'])})"
    table = _table(title, ["stage"], "median (quartiles)", "from", "to")
    for name, spread in figures["figures"]["stages"].items():
        table.add_row(name, _spread(spread), f"{spread['min_ms']:.1f}", f"{spread['max_ms']:.1f}")
    return [table, _rightness(figures["figures"])]


def _registration(figures: Figures) -> list[object]:
    table = _table(
        "Registration, s", ["points"], "used", "starts", "file MB", "index MB", "total", "peak MB", "before MB"
    )
    for row in figures["rows"]:
        one, total = row["median"], row["total"]
        seconds = f"{total['median_ms'] / 1000:.1f} ({total['min_ms'] / 1000:.1f} to {total['max_ms'] / 1000:.1f})"
        sizes = (_mb(one["scan_bytes"]), _mb(one["index_bytes"]))
        memory = (_mb(row["peak_bytes"]), _mb(one["base_bytes"]))
        table.add_row(f"{one['points']:,}", f"{one['points_used']:,}", str(one["starts"]), *sizes, seconds, *memory)
    stages = [f"{name} {seconds:.2f}" for name, seconds in figures["rows"][-1]["median"]["seconds"].items()]
    return [table, f"Of the last: {', '.join(stages)} s"]


def _index(figures: Figures) -> list[object]:
    table = _table(
        "Map index", ["points"], "starts", "encoded MB", "in memory MB", "encode ms", "decode ms", "from Redis ms"
    )
    redis = figures["redis"]
    table.add_row(
        f"{figures['points']:,}", str(figures["starts"]), _mb(figures["encoded_bytes"]), _mb(figures["resident_bytes"]),
        _spread(figures["encode"]), _spread(figures["decode"]), _spread(redis["load"]) if redis else "–",
    )  # fmt: skip
    return [table]


def _maps(figures: Figures) -> list[object]:
    return [_query_table("One query over maps, ms", [], figures["rows"], lambda row: [])]


def _scaling(figures: Figures) -> list[object]:
    rows = figures["rows"]
    labels = {id(row["query"]): [row["parameter"], f"{row['value']:,}"] for row in rows}
    queries = [row["query"] for row in rows]
    return [_query_table("Cost of a query, ms", ["against", "value"], queries, lambda row: labels[id(row)])]


def _query(figures: Figures) -> list[object]:
    place = figures["map"]
    size = f"{place['num_points_used'] or 0:,} points used, {place['num_starts']} starts"
    title = f"Queries over HTTP, ms ({size}, {figures['panorama_width']} pixels wide)"
    table = _table(
        title, ["method", "clients"], "queries", "failed", "localized", "p50", "p95", "mean", "queries per s"
    )
    paper = figures["paper"] or {}
    for row in [*figures["rows"], *([paper] if "latency" in paper else [])]:
        latency = row["latency"]
        times = [f"{latency[name]:.0f}" for name in ("median_ms", "p95_ms", "mean_ms")]
        counts = [str(row[name]) for name in ("clients", "queries", "failed", "localized")]
        table.add_row(row["method"], *counts, *times, f"{row['throughput_per_s']:.2f}")
    stages = [f"{name} {ms:.0f}" for name, ms in figures["rows"][0]["service_stages_ms"].items()]
    tables: list[object] = [table, f"The service says of the first row: {', '.join(stages)} ms"]
    if paper.get("ratio"):
        tables.append(f"The method paper took {paper['ratio']:.0f} times as long as the method fast.")
    return tables


def _cameras(figures: Figures) -> list[object]:
    title = f"Cameras over HTTP, furnished rooms of which 60 % has changed ({figures['points']:,} points)"
    table = _table(title, ["camera"], "images", "queries", "right", "localized", "p50", "p95", "to a panorama")
    for row in figures["rows"]:
        times = [f"{row['latency'][name]:.0f}" for name in ("median_ms", "p95_ms")]
        counts = [str(row[name]) for name in ("images", "queries", "right", "localized")]
        table.add_row(row["camera"], *counts, *times, f"{row['ratio']:.2f}")
    return [table]


def _memory(figures: Figures) -> list[object]:
    table = _table("Memory of the service (PSS), MB", ["process"], "idle", f"after {figures['queries']} queries")
    names = figures["after_by_process"] | figures["idle_by_process"]
    for name in names:
        table.add_row(escape(name), *(_mb(figures[f"{when}_by_process"].get(name, 0)) for when in ("idle", "after")))
    table.add_row("together", _mb(figures["idle_bytes"]), _mb(figures["after_bytes"]))
    return [table, f"At most {_mb(figures['peak_bytes'])} MB while it answered."]


_TABLES: dict[str, Callable[[Figures], list[object]]] = {
    "search": _search,
    "stages": _stages,
    "registration": _registration,
    "index": _index,
    "maps": _maps,
    "scaling": _scaling,
    "query": _query,
    "cameras": _cameras,
    "memory": _memory,
}


def _query_table(
    title: str, labels: Sequence[str], rows: Sequence[Figures], label: Callable[[Figures], list[str]]
) -> Table:
    """Return one row per query with the medians of its stages."""
    stages = [name for name in rows[0]["figures"]["stages"] if name != "total"]
    table = _table(title, labels, "maps", "starts", "rotations", "points", "pixels", *stages, "total", "status")
    for row in rows:
        counts = [f"{row[name]:,}" for name in ("maps", "starts", "rotations", "points", "pixels")]
        times = row["figures"]["stages"]
        shown = [_median(times[name]) if name in times else "–" for name in stages]
        table.add_row(*label(row), *counts, *shown, _spread(times["total"]), row["figures"]["status"])
    return table


def _table(title: str, labels: Sequence[str], *headings: str) -> Table:
    table = Table(
        title=escape(title), title_justify="left", title_style="bold", box=None, pad_edge=False, header_style="dim"
    )
    for heading in labels:
        table.add_column(heading, no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table


def _rightness(figures: Figures) -> str:
    answer = f"The answer was {figures['status']}"
    if figures["position_error_m"] is None:
        return f"{answer}."
    error_mm, error_deg = figures["position_error_m"] * 1000, figures["orientation_error_deg"]
    return f"{answer}, off by {error_mm:.1f} mm and {error_deg:.2f}°."


def _spread(spread: Figures) -> str:
    return f"{spread['median_ms']:.1f} ({spread['lower_quartile_ms']:.1f}–{spread['upper_quartile_ms']:.1f})"


def _median(spread: Figures) -> str:
    return f"{spread['median_ms']:.1f}"


def _size(pixels: int) -> str:
    height = round((pixels / 2) ** 0.5)
    return f"{2 * height} x {height} pixels"


def _mb(num_bytes: int | None) -> str:
    return "–" if num_bytes is None else f"{num_bytes / 1e6:.1f}"
