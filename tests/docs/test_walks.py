"""The walks of docs/walks.md are those that the code takes."""

import io
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from PIL import Image

from core.geometry.pose import Pose
from core.index.map_builder import build_map_index
from core.index.map_codec import decode_map_index, encode_map_index
from core.index.map_diagnostics import map_diagnostics
from core.index.map_index import MapIndex
from core.localizer import Localizer
from core.options import IndexOptions
from core.panorama.reader import read_panorama
from core.pictures import draw_map_preview, draw_overlay, encode_png, view_scan
from core.scan.ply.writer import write_ply
from core.scan.reading import read_scan
from tests.core.painted_box import PaintedBox, rotation_of
from tests.docs.documentation import ROOT

WALKS = {
    path: re.findall(r"^\| `([\w/]+\.py)` \|", part, re.MULTILINE)
    for path, part in re.findall(
        r"^## `(POST /\w+)`\n(.*?)(?=^## |\Z)", (ROOT / "docs" / "walks.md").read_text(), re.M | re.S
    )
}


def entered(work: Callable[[], Any]) -> list[str]:
    """Return the files of `core` in the order in which their functions are first called."""
    found: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(f"{ROOT}/core/") and not code.co_name.startswith("<"):
            found.setdefault(str(Path(code.co_filename).relative_to(ROOT)))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return list(found)


@pytest.mark.parametrize("path", ["POST /localize", "POST /maps"])
def test_a_walk_names_files_that_exist_and_none_twice(path: str) -> None:
    files = WALKS[path]
    assert len(files) > 40
    assert len(set(files)) == len(files)
    assert [name for name in files if not (ROOT / name).exists()] == []


@pytest.mark.slow
def test_a_query_takes_the_walk(localizer: Localizer, box: PaintedBox, box_index: MapIndex) -> None:
    encoded, picture = encode_map_index(box_index), io.BytesIO()
    pose = Pose(rotation_of(130.0, 8.0, -5.0), np.array([1.7, 2.4, 1.5]))
    Image.fromarray(box.panorama(pose).color).save(picture, "JPEG")

    def query() -> None:
        index = decode_map_index(encoded)
        panorama = read_panorama(picture.getvalue())
        encode_png(draw_overlay(panorama, view_scan(index, localizer.localize(panorama, [index]))))

    assert entered(query) == [name for name in WALKS["POST /localize"] if name.startswith("core/")]


@pytest.mark.slow
def test_a_registration_takes_the_walk(box: PaintedBox, tmp_path: Path) -> None:
    scan = tmp_path / "scan.ply"
    write_ply(scan, box.scan())

    def register() -> None:
        cloud = read_scan(scan)
        index = build_map_index(cloud, IndexOptions(spacing_m=0.8))
        encode_map_index(index)
        map_diagnostics(index, IndexOptions(), len(cloud))
        encode_png(draw_map_preview(index))

    assert entered(register) == [name for name in WALKS["POST /maps"] if name.startswith("core/")]
