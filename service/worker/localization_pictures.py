"""The pictures that show a person whether a pose is right."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

from core.index.map_index import MapIndex
from core.panorama.panorama import Panorama
from core.pictures import draw_overlay, draw_score_map_2d, draw_score_map_3d, encode_png, view_scan
from core.results import Localization


def localization_pictures(
    panorama: Panorama, maps: Sequence[MapIndex], localization: Localization, wanted: Iterable[str]
) -> dict[str, bytes]:
    """Return PNGs by the names in `wanted`: "score_map_2d", "score_map_3d", "overlay".

    Without any pose there is nothing to draw, so the result is empty; the body says why.
    """
    if localization.best is None:
        return {}
    index = maps[localization.best.map_position]
    names = tuple(wanted)
    drawn = {}
    if "score_map_2d" in names:
        drawn["score_map_2d"] = draw_score_map_2d(panorama, localization)
    if "score_map_3d" in names or "overlay" in names:
        view = view_scan(index, localization, with_scores="score_map_3d" in names)
        drawn |= {"score_map_3d": draw_score_map_3d(view), "overlay": draw_overlay(panorama, view)}
    # Compressing takes a third of the time, and needs no interpreter.
    with ThreadPoolExecutor(len(names) or 1) as threads:
        return dict(zip(names, threads.map(encode_png, (drawn[name] for name in names)), strict=True))
