"""Changes as one HTML file that needs nothing else: plan, list, and photo and scan side by side."""

import base64
from html import escape
from typing import Any

from panoloc.core.changes.reports.report import ChangeReport, color_of, floor_words, kind_words, place_words, size_words

_STYLE = """
:root { color-scheme: light dark; font: 16px/1.5 system-ui, sans-serif; }
body { max-width: 1000px; margin: 0 auto; padding: 24px 16px; }
img { max-width: 100%; height: auto; border-radius: 6px; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
th, td { text-align: left; padding: 6px 10px; border-bottom: 1px solid #8886; vertical-align: top; }
td.n { font-variant-numeric: tabular-nums; white-space: nowrap; }
.wide { overflow-x: auto; }
section { margin: 28px 0; break-inside: avoid; }
.kind { display: inline-block; padding: 0 8px; border-radius: 10px; color: #fff; font-size: 13px; }
.soft { opacity: .75; font-size: 14px; }
"""


def as_html(report: ChangeReport) -> bytes:
    """Return the page."""
    rows = "".join(_row(number, each) for number, each in enumerate(report.objects, 1))
    parts = "".join(_section(report, number, each) for number, each in enumerate(report.objects, 1))
    head = "<tr><th>#</th><th>Change</th><th>Place x, y, z (m)</th><th>Size</th><th>Floor</th><th>Certainty</th><th>Photos</th></tr>"
    table = f'<div class="wide"><table>{head}{rows}</table></div>' if rows else f"<p>{report.nothing}</p>"
    title = escape(report.title)
    page = f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Changes in {title}</title><style>{_STYLE}</style>
<h1>Changes in {title}</h1>
<p>{escape(report.summary)}</p>
<p class="soft">Made {escape(report.made_at)}. {escape(report.frame)}</p>
<img alt="Plan of {title} with the numbered changes" src="data:image/png;base64,{_base64(report.plan)}">
<h2>List</h2>
{table}
{parts}
</html>
"""
    return page.encode()


def _row(number: int, each: dict[str, Any]) -> str:
    return (
        f'<tr><td class="n"><a href="#o{number}">{number}</a></td><td>{_kind(each)}</td>'
        f'<td class="n">{place_words(each, "<br>")}</td><td class="n">{size_words(each["size_m"])}</td>'
        f'<td class="n">{floor_words(each)}</td><td class="n">{each["certainty"]:.0%}</td><td class="n">{each["num_photos"]}</td></tr>'
    )


def _section(report: ChangeReport, number: int, each: dict[str, Any]) -> str:
    picture = report.pictures.get(each["id"])
    if picture is None:
        return ""
    shown = f'<img alt="Photo and scan of change {number}" src="data:image/jpeg;base64,{_base64(picture)}">'
    below = " New place above, old place below." if each["kind"] == "moved" else ""
    return (
        f'<section id="o{number}"><h3>{number}. {_kind(each)} {size_words(each["size_m"])}</h3>{shown}'
        f'<p class="soft">Photo left, scan right.{below} Last seen {escape(each["last_seen_at"])}.</p></section>'
    )


def _kind(each: dict[str, Any]) -> str:
    red, green, blue = color_of(each)
    return f'<span class="kind" style="background: rgb({red} {green} {blue})">{kind_words(each)}</span>'


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
