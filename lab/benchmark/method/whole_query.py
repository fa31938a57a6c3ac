"""One query from the bytes of a JPEG to the answer and its pictures, without a service, stage by stage."""

import io
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from core.geometry.pose import Pose, pose_error
from core.index.map_index import MapIndex
from core.localizer import Localizer
from core.panorama.panorama import Panorama
from core.results import Localization
from lab.benchmark.rooms import IndexedRoom
from lab.benchmark.timing import Spread, spread_of

JPEG_QUALITY = 92


@dataclass(frozen=True)
class QueryFigures:
    """What a query cost, and whether the answer was right: a fast answer that is wrong is no figure.

    stages: by name, `total` among them: the wall clock of the whole. The errors are None without a pose.
    """

    status: str
    position_error_m: float | None
    orientation_error_deg: float | None
    stages: Mapping[str, Spread]


class WholeQuery:
    """A panorama taken in `target` and the maps to search, `target` among them.

    Decoding and pictures need Pillow; without it they are left out.
    """

    def __init__(
        self, localizer: Localizer, target: IndexedRoom, width: int, others: tuple[MapIndex, ...] = ()
    ) -> None:
        self._localizer, self._maps = localizer, (target.index, *others)
        self._pose = target.room.pose()
        self._panorama = target.room.panorama(self._pose, width)
        self._jpeg = encode_jpeg(self._panorama) if can_decode() else None

    def repeated(self, repeats: int, warm_ups: int, *, pictures: bool = False) -> QueryFigures:
        """Run the query `repeats` times after `warm_ups` that do not count."""
        for _ in range(warm_ups):
            self.run(pictures=pictures)
        runs = [self.run(pictures=pictures) for _ in range(repeats)]
        stages = {name: spread_of([times[name] for times, _ in runs]) for name in runs[0][0]}
        return _figures(runs[-1][1], self._pose, stages)

    def run(self, *, pictures: bool = False) -> tuple[dict[str, float], Localization]:
        """Answer once; return milliseconds by stage, and the answer."""
        times: dict[str, float] = {}
        began = time.perf_counter()
        panorama = self._panorama
        if self._jpeg is not None:
            from core.panorama.reader import read_panorama

            panorama = read_panorama(self._jpeg)
            times["decode"] = _since(began)
        answer = self._localizer.localize(panorama, self._maps)
        times |= {name: seconds * 1000 for name, seconds in answer.timings_s.items()}
        if pictures and can_decode():
            times |= _picture_times(panorama, self._maps, answer)
        times["total"] = _since(began)
        return times, answer


def can_decode() -> bool:
    """Tell whether Pillow is installed."""
    return find_spec("PIL") is not None


def encode_jpeg(panorama: Panorama) -> bytes:
    """Return a panorama as the bytes of a JPEG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(panorama.color).save(buffer, "JPEG", quality=JPEG_QUALITY)
    return buffer.getvalue()


def _picture_times(panorama: Panorama, maps: tuple[MapIndex, ...], answer: Localization) -> dict[str, float]:
    """Draw and encode the three pictures of an answer; return milliseconds of both."""
    from core.pictures import draw_overlay, draw_score_map_2d, draw_score_map_3d, encode_png, view_scan

    index = maps[answer.best.map_position if answer.best else 0]
    began = time.perf_counter()
    drawn = (
        draw_score_map_2d(panorama, answer),
        draw_score_map_3d(view := view_scan(index, answer)),
        draw_overlay(panorama, view),
    )
    times = {"draw pictures": _since(began)}
    began = time.perf_counter()
    for picture in drawn:
        encode_png(picture)
    return {**times, "encode pictures": _since(began)}


def _figures(answer: Localization, truth: Pose, stages: Mapping[str, Spread]) -> QueryFigures:
    if answer.best is None:
        return QueryFigures(answer.status, None, None, stages)
    error = pose_error(answer.best.pose, truth)
    return QueryFigures(answer.status, error.position_m, error.orientation_deg, stages)


def _since(began: float) -> float:
    return (time.perf_counter() - began) * 1000
