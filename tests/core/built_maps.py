"""Maps of painted boxes, each built once in a process whichever tests ask for it."""

from functools import cache

from panoloc.core.index.map_builder import build_map_index
from panoloc.core.index.map_index import MapIndex
from panoloc.core.options import IndexOptions
from tests.core.painted_box import PaintedBox

BOX = PaintedBox(seed=3)
OTHER_BOX = PaintedBox(seed=44, size_m=(4.2, 4.6, 2.5))
LABELLED = PaintedBox(seed=1, palette=((0, 0, 0), (255, 0, 0), (0, 128, 255), (90, 90, 90), (20, 200, 60)))
AS_LABELS = IndexOptions(color_kind="labels", spacing_m=0.8)
_PLAIN = IndexOptions()


@cache
def map_of(box: PaintedBox, options: IndexOptions = _PLAIN) -> MapIndex:
    """Return the map of a box, with which no test may tamper."""
    return build_map_index(box.scan(), options)
