"""What a part of the campaign found, and the table of all parts."""

from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass
class Outcome:
    """One row. faults: what must not happen, in words; none where all promises were kept."""

    part: str
    cases: int = 0
    seconds: float = 0.0
    figures: dict[str, str] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)


def table(outcomes: Iterable[Outcome]) -> str:
    """Return a Markdown table, and the faults below it."""
    found = list(outcomes)
    rows = ["| part | cases | seconds | figures | faults |", "|---|---|---|---|---|"]
    for each in found:
        figures = ", ".join(f"{name} {value}" for name, value in each.figures.items())
        rows.append(f"| {each.part} | {each.cases:,} | {each.seconds:.0f} | {figures} | {len(each.faults)} |")
    rows += [f"{each.part}: {fault}" for each in found for fault in each.faults[:20]]
    return "\n".join(rows)


def quantile(values: list[float], share: float) -> float:
    """Return the value below which a share of all lies, 0 where there is none."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] if values else 0.0
