"""Times one query from the bytes of a JPEG to the answer and its pictures, without a service, stage by stage."""

import io
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.geometry.pose import pose_error
from panoloc.core.localizer import Localizer
from panoloc.core.many_maps import LoadedMaps, localize_among
from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Localization
from panoloc.lab.benchmark.painted_maps import IndexedRoom
from panoloc.lab.benchmark.timing import Spread, spread_of


@dataclass(frozen=True)
class QueryCost:
    """What a query cost, and whether the answer was right: a fast answer that is wrong is no figure.

    starts, points: over all maps. stages: by name, `total` among them: the wall clock of the whole. The errors are None without a pose.
    """

    maps: int
    starts: int
    rotations: int
    points: int
    pixels: int
    status: str
    position_error_m: float | None
    orientation_error_deg: float | None
    stages: Mapping[str, Spread]


def time_query(
    localizer: Localizer,
    rooms: Sequence[IndexedRoom],
    width: int,
    repeats: int,
    warm_ups: int,
    *,
    pictures: bool = False,
) -> QueryCost:
    """Time the query of a panorama taken in the first of `rooms` over the maps of all of them.

    Decoding and pictures need Pillow; without it they are left out.
    """
    room, maps = rooms[0].room, [each.index for each in rooms]
    pose = room.pose()
    panorama = room.panorama(pose, width)
    jpeg = encode_jpeg(panorama) if find_spec("PIL") else None
    loaded = LoadedMaps(maps)
    runs = [_run(localizer, loaded, panorama, jpeg, pictures=pictures) for _ in range(warm_ups + repeats)][warm_ups:]
    answer = runs[-1][1]
    error = None if answer.best is None else pose_error(answer.best.pose, pose)
    return QueryCost(
        maps=len(maps),
        starts=sum(index.num_starts for index in maps),
        rotations=localizer.config.search.rotations_with(1),
        points=sum(index.num_points for index in maps),
        pixels=width * width // 2,
        status=answer.status,
        position_error_m=None if error is None else error.position_m,
        orientation_error_deg=None if error is None else error.orientation_deg,
        stages={name: spread_of([times[name] for times, _ in runs]) for name in runs[0][0]},
    )


def encode_jpeg(panorama: Panorama) -> bytes:
    """Return a panorama as the bytes of a JPEG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(panorama.color).save(buffer, "JPEG", quality=92)
    return buffer.getvalue()


def _run(
    localizer: Localizer, maps: LoadedMaps, panorama: Panorama, jpeg: bytes | None, *, pictures: bool
) -> tuple[dict[str, float], Localization]:
    """Answer once; return milliseconds by stage, and the answer."""
    times: dict[str, float] = {}
    began = time.perf_counter()
    if jpeg is not None:
        from panoloc.core.image.reader import read_panorama

        panorama = read_panorama(jpeg)
        times["decode"] = _since(began)
    answer = localize_among(localizer, Rig.of_panorama(panorama), maps)
    times |= {name: seconds * 1000 for name, seconds in answer.timings_s.items()}
    if pictures and jpeg is not None:
        (index,) = maps.indexes([answer.best.map_position if answer.best else 0])
        times |= _picture_times(panorama, index, answer)
    times["total"] = _since(began)
    return times, answer


def _picture_times(panorama: Panorama, index: MapIndex, answer: Localization) -> dict[str, float]:
    """Draw and encode the three pictures of an answer; return milliseconds of both."""
    from panoloc.core.decide.pictures import draw_overlay, draw_score_map_2d, draw_score_map_3d, encode_png, view_scan

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


def _since(began: float) -> float:
    return (time.perf_counter() - began) * 1000
