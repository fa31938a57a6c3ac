"""What a report is made of, the same for every format."""

import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from panoloc.core.scan.from_above import Area, draw_from_above
from panoloc.core.scan.point_cloud import PointCloud

COLORS = {"came": (24, 128, 56), "went": (200, 40, 36), "moved": (26, 86, 196)}
_UNSURE = (110, 110, 110)
_PLAN_PX = 1400


@dataclass(frozen=True, eq=False)
class ChangeReport:
    """One report.

    title: the name of the map. num_photos: that were compared.
    period: theirs, in words. made_at: ISO 8601. objects: as in the HTTP contract, the surest first; with `grid` and
    `from_grid`, on the grid of the map, and `wgs84`, each as in `GET /maps/{id}/coordinates` or None. pictures: JPEGs by
    id of an object. plan: PNG.
    """

    title: str
    num_photos: int
    period: str
    made_at: str
    objects: Sequence[dict[str, Any]]
    pictures: dict[str, bytes]
    plan: bytes

    @property
    def summary(self) -> str:
        """Return what was found in which photos."""
        return f"{count_words(self.objects)}. {self.period}" if self.num_photos else self.period

    @property
    def frame(self) -> str:
        """Return what positions are in."""
        grid = next((each["grid"]["name"][:60] for each in self.objects if each["grid"]), None)
        return "Positions are metres in the map's own frame." + (f" Its grid is {grid}." if grid else "")

    @property
    def nothing(self) -> str:
        """Return what stands in place of an empty list."""
        return "No change was found." if self.num_photos else "Nothing was compared: there were no photos."


def read_report(document: dict[str, Any], cloud: PointCloud) -> ChangeReport:
    """Return the report of a document: title, num_photos, period, made_at, found (a zip of `panoloc.core.changes`) and objects."""
    with zipfile.ZipFile(document["found"]) as archive:
        pictures = {
            name.removesuffix(".jpg"): archive.read(name) for name in archive.namelist() if name.endswith(".jpg")
        }
    objects = document["objects"]
    shown = {each["id"]: pictures[each["id"]] for each in objects if each["id"] in pictures}
    return ChangeReport(
        document["title"],
        document["num_photos"],
        document["period"],
        document["made_at"],
        objects,
        shown,
        draw_plan(cloud, objects),
    )


def draw_plan(cloud: PointCloud, objects: Sequence[dict[str, Any]]) -> bytes:
    """Return a PNG of the scan from above with the numbered boxes of objects; of what moved an arrow from where it was."""
    positions = cloud.positions.astype(np.float64)
    lower, upper = np.quantile(positions, 0.001, axis=0), np.quantile(positions, 0.999, axis=0)
    top_m = float(lower[2] + 0.85 * (upper[2] - lower[2]))
    seen = draw_from_above(positions, cloud.colors, Area(lower[:2], upper[:2], top_m), _PLAN_PX)
    faded = Image.blend(Image.fromarray(seen.picture), Image.new("RGB", seen.picture.shape[1::-1], "white"), 0.45)
    pen = ImageDraw.Draw(faded)
    offset = np.asarray(cloud.origin_offset)
    for number, each in enumerate(objects, 1):
        center, half = np.array(each["center_m"]) - offset, np.array(each["size_m"]) / 2
        (x0, y1), (x1, y0) = seen.pixels_of(np.stack((center - half, center + half))).tolist()
        color = color_of(each)
        if each["from_m"] is not None:
            (u, v), (x, y) = seen.pixels_of(np.stack((np.array(each["from_m"]) - offset, center))).tolist()
            pen.line((u, v, x, y), fill=color, width=4)
            pen.ellipse((u - 7, v - 7, u + 7, v + 7), outline=color, width=3)
        pen.rectangle((x0, y0, max(x1, x0 + 3), max(y1, y0 + 3)), outline=color, width=4)
        at = (x0 + x1) / 2, (y0 + y1) / 2
        pen.ellipse((at[0] - 17, at[1] - 17, at[0] + 17, at[1] + 17), fill="white", outline=color, width=2)
        pen.text(at, str(number), fill=color, anchor="mm", font_size=22)
    buffer = io.BytesIO()
    faded.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def count_words(objects: Sequence[dict[str, Any]]) -> str:
    """Return how many objects changed for sure, and how many perhaps."""
    sure = [each["kind"] for each in objects if each["is_sure"]]
    counts = [f"{sure.count(kind)} {kind}" for kind in COLORS if kind in sure]
    unsure = len(objects) - len(sure)
    return (", ".join(counts) or "Nothing changed for sure") + (
        f"; {unsure} unsure: look at their pictures" if unsure else ""
    )


def kind_words(each: dict[str, Any]) -> str:
    """Return what happened to an object."""
    kind: str = each["kind"]
    return kind if each["is_sure"] else f"{kind}?"


def color_of(each: dict[str, Any]) -> tuple[int, int, int]:
    """Return the colour (RGB) of an object in plan and list; what is unsure is grey."""
    return COLORS[each["kind"]] if each["is_sure"] else _UNSURE


def place_words(each: dict[str, Any], between: str) -> str:
    """Return where an object is, and where it was before it moved. between: lines."""
    here = _position_words(each["center_m"], each["grid"])
    before = () if each["from_m"] is None else _position_words(each["from_m"], each["from_grid"])
    return between.join((*here, *(f"from {line}" for line in before)))


def _position_words(position_m: Sequence[float], grid: dict[str, Any] | None) -> list[str]:
    """Return a position in the map's own frame, and below it on the grid, unless the frame is the grid."""
    words = [", ".join(f"{value:.2f}" for value in position_m)]
    if grid is not None and [grid["east"], grid["north"], grid["height_m"]] != position_m:
        height = "" if grid["height_m"] is None else f", H {grid['height_m']:.2f} m"
        words.append(f"E {grid['east']:.2f}, N {grid['north']:.2f} {grid['unit']}{height}")
    return words


def size_words(size_m: Sequence[float]) -> str:
    """Return a size in words."""
    return " x ".join(f"{value:.2f}" for value in size_m) + " m"


def floor_words(each: dict[str, Any]) -> str:
    """Return the floor, counted from 1 for the lowest; empty if none is known."""
    return "" if each["floor"] is None else str(each["floor"] + 1)
