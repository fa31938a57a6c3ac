"""Changes as a PDF of A4 pages: plan and list, then three changes a page with photo and scan side by side."""

import io
from typing import Any

from fpdf import FPDF
from fpdf.fonts import FontFace
from PIL import Image

from panoloc.core.changes.reports.report import ChangeReport, color_of, floor_words, kind_words, place_words, size_words

_MARGIN_MM = 15.0
_WIDTH_MM = 210.0 - 2 * _MARGIN_MM
_PLAN_MM = 120.0  # its height, at most
_PICTURE_MM = 120.0  # the width of photo and scan together
_BOTTOM_MM = 297.0 - _MARGIN_MM


def as_pdf(report: ChangeReport) -> bytes:
    """Return the document."""
    pdf = _Pages(format="A4")
    pdf.set_margin(_MARGIN_MM)
    pdf.set_auto_page_break(True, _MARGIN_MM)
    pdf.set_title(f"Changes in {report.title}")
    pdf.set_lang("en")
    pdf.add_page()
    _first_page(pdf, report)
    for number, each in enumerate(report.objects, 1):
        if each["id"] in report.pictures:
            _one(pdf, number, each, report.pictures[each["id"]])
    return bytes(pdf.output())


class _Pages(FPDF):
    def footer(self) -> None:
        """Number the page."""
        self.set_y(-12)
        self.set_font("helvetica", size=8)
        self.set_text_color(110)
        self.cell(0, 6, f"{self.page_no()} / {{nb}}", align="C")


def _first_page(pdf: FPDF, report: ChangeReport) -> None:
    pdf.set_font("helvetica", "B", 18)
    pdf.multi_cell(0, 9, _latin(f"Changes in {report.title}"), new_x="LMARGIN", new_y="NEXT")
    pdf.set_font("helvetica", size=10)
    pdf.multi_cell(0, 5.5, _latin(report.summary), new_x="LMARGIN", new_y="NEXT")
    pdf.set_text_color(110)
    pdf.multi_cell(0, 5.5, _latin(f"Made {report.made_at}. {report.frame}"), new_x="LMARGIN", new_y="NEXT")
    pdf.set_text_color(0)
    pdf.ln(3)
    with Image.open(io.BytesIO(report.plan)) as plan:
        width = min(_WIDTH_MM, _PLAN_MM * plan.width / plan.height)
        jpeg = io.BytesIO()
        plan.convert("RGB").save(jpeg, "JPEG", quality=88)
    pdf.image(jpeg, w=width, x=_MARGIN_MM + (_WIDTH_MM - width) / 2, alt_text="Plan with the numbered changes")
    pdf.ln(5)
    if not report.objects:
        pdf.cell(0, 6, report.nothing)
        return
    pdf.set_font("helvetica", size=9)
    widths = (8, 18, 50, 42, 12, 22, 16)
    with pdf.table(
        col_widths=widths,
        borders_layout="HORIZONTAL_LINES",
        headings_style=FontFace(emphasis="BOLD"),
        line_height=5,
        text_align="LEFT",
    ) as table:
        table.row(("#", "Change", "Place x, y, z (m)", "Size", "Floor", "Certainty", "Photos"))
        for number, each in enumerate(report.objects, 1):
            seen = f"{each['certainty']:.0%}", str(each["num_photos"])
            table.row(
                (
                    str(number),
                    kind_words(each),
                    place_words(each, "\n"),
                    size_words(each["size_m"]),
                    floor_words(each),
                    *seen,
                )
            )


def _one(pdf: FPDF, number: int, each: dict[str, Any], picture: bytes) -> None:
    with Image.open(io.BytesIO(picture)) as opened:
        height = _PICTURE_MM * opened.height / opened.width
    if pdf.get_y() + height + 22 > _BOTTOM_MM:
        pdf.add_page()
    pdf.ln(4)
    pdf.set_font("helvetica", "B", 11)
    pdf.set_text_color(*color_of(each))
    pdf.cell(0, 6, f"{number}. {kind_words(each)}, {size_words(each['size_m'])}", new_x="LMARGIN", new_y="NEXT")
    pdf.set_text_color(0)
    pdf.set_font("helvetica", size=9)
    pdf.image(io.BytesIO(picture), w=_PICTURE_MM, alt_text=f"Photo and scan of change {number}")
    below = " New place above, old place below." if each["kind"] == "moved" else ""
    words = f"Photo left, scan right.{below} At {place_words(each, '; ')}. Certainty {each['certainty']:.0%}."
    pdf.multi_cell(0, 6, _latin(words), new_x="LMARGIN", new_y="NEXT")


def _latin(text: str) -> str:
    """Return text as the fonts that every PDF reader has can show it."""
    return text.encode("latin-1", "replace").decode("latin-1")
