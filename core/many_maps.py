"""Localize a rig in one of many maps: only those whose starts show most of what the rig shows are loaded and searched."""

import math
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import torch
from torch import Tensor

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.photo_window import shown_share
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.retrieval_vectors import RetrievalVectors, retrieval_vectors
from panoloc.core.options import MAX_SESSION_TILT_DEG, Hints, Method
from panoloc.core.query.map_query import PreparedRig
from panoloc.core.remarks import Remark
from panoloc.core.render.synthetic_view import render_views
from panoloc.core.results import Localization
from panoloc.core.search.retrieval import scores_of_maps


class MapShelf(Protocol):
    """Maps that a rig may be in, by their numbers. What is not in memory is loaded when it is asked for."""

    def __len__(self) -> int:
        """Return how many maps there are."""

    def vectors(self) -> Sequence[RetrievalVectors]:
        """Return the retrieval vectors of all maps."""

    def indexes(self, numbers: Sequence[int]) -> Sequence[MapIndex]:
        """Return the indexes of some maps."""


class LoadedMaps:
    """A `MapShelf` of maps that are all in memory."""

    def __init__(self, indexes: Sequence[MapIndex]) -> None:
        self._indexes = indexes

    def __len__(self) -> int:
        return len(self._indexes)

    @cached_property
    def _vectors(self) -> list[RetrievalVectors]:
        return [retrieval_vectors(index) for index in self._indexes]

    def vectors(self) -> Sequence[RetrievalVectors]:
        """Return the retrieval vectors of all maps, made when they are first asked for."""
        return self._vectors

    def indexes(self, numbers: Sequence[int]) -> Sequence[MapIndex]:
        """Return the indexes of some maps."""
        return [self._indexes[number] for number in numbers]


def localize_among(
    localizer: Localizer,
    rig: Rig,
    maps: MapShelf,
    *,
    method: Method = "fast",
    hints: Hints | None = None,
    top_k: int = 1,
    timeout_s: float | None = None,
    num_maps: int | None = None,
    is_cancelled: Callable[[], bool] = lambda: False,
) -> Localization:
    """Find where the images of a rig were taken, and in which of many maps.

    maps: at least one. num_maps: where they are the likeliest of so many, best first. The other parameters and the errors are those of
    `Localizer.localize`; what `maps` raises is passed on.
    """
    search = localizer.config.search
    began, few, most = time.monotonic(), search.first_maps, search.most_maps
    ranked, portions, timings_s = list(range(len(maps))), [len(maps)], defaultdict[str, float](float)
    total, is_wide = num_maps or len(maps), True
    # To look for the likeliest takes as long as to search twelve more.
    if total > max(2 * few, most // 4):
        if num_maps is None:
            scores = torch.tensor(scores_among(localizer, rig, maps.vectors(), hints))
            ranked = scores.argsort(descending=True, stable=True).tolist()
            timings_s["retrieval"] += time.monotonic() - began
        is_wide, portions = shown_share(rig) >= search.wide_share, [few, most]

    loaded: dict[int, MapIndex] = {}

    def searched(numbers: Sequence[int], likeliest: int) -> Localization:
        """Return the answer among some of the maps, which are the likeliest so many, or look like one of these."""
        loading = time.monotonic()
        indexes = maps.indexes(numbers)
        loaded.update(zip(numbers, indexes, strict=True))
        timings_s["load"] += time.monotonic() - loading
        answer = localizer.localize(
            rig,
            indexes,
            method=method,
            hints=hints,
            top_k=top_k,
            timeout_s=None if timeout_s is None else timeout_s - (time.monotonic() - began),
            # About as often as the map of one photo was among the likeliest 8 and 64 of 180, 720 and 1,000 (docs/scale.md).
            prior=1.0 if is_wide else min(1.0, (likeliest / total) ** (1 / 6)),
            is_cancelled=is_cancelled,
        )
        for stage, seconds in answer.timings_s.items():
            timings_s[stage] += seconds
        return _numbered(answer, numbers, total)

    found: Localization | None = None
    for first, last in pairwise([0, *portions]):
        # What is found in other maps has to be better than what was.
        known = () if found is None else _places(found)
        found = _better(found, searched([*ranked[first:last], *known], last))
        if _is_sure(found, localizer.config.judge.sure):
            break
    assert found is not None, "there is at least one map"
    if found.best is not None and found.status == "localized" and num_maps is None and last < total:
        looking, number = time.monotonic(), found.best.map_position
        view = view_from(loaded[number], found.best.pose, 2 * localizer.config.descriptors.view_height)
        of_view = scores_among(localizer, view, maps.vectors(), None, along_walls=True)
        timings_s["retrieval"] += time.monotonic() - looking
        others = [each for each in search.look_alikes(of_view, number) if each not in ranked[:last]]
        if others:
            found = _better(found, searched([number, *others], last))
    if found.status == "not_localized" and total > portions[-1]:
        found = found.warned(_left_out(portions[-1], total))
    return replace(found, timings_s=dict(timings_s))


def view_from(index: MapIndex, pose: Pose, rows: int) -> Rig:
    """Return what a map shows all around a pose, as a panorama of so many rows that stands upright along the walls of the map."""
    position = torch.from_numpy(pose.position - index.origin_offset).to(index.positions)
    view = render_views(index.render_cloud, position[None], rows, with_points=False)
    x, y, _ = index.wall_axes[0].tolist()
    columns = round(math.atan2(y, x) / math.pi * rows)
    color, valid = (part[0].roll(columns, 1) for part in ((255 * view.color).round().byte(), view.valid))
    return Rig.of_panorama(Panorama(color.cpu().numpy(), valid.cpu().numpy()))


def scores_among(
    localizer: Localizer,
    rig: Rig,
    maps: Sequence[RetrievalVectors],
    hints: Hints | None,
    *,
    along_walls: bool = False,
) -> list[float]:
    """Return for each map how much its starts show of what a rig shows; comparable between any maps.

    along_walls: the rig stands upright along walls, as a view of `view_from` does.
    """
    config = localizer.config
    with torch.inference_mode():
        prepared = PreparedRig(rig, None, localizer.device, config)
        walls: Tensor | None = torch.eye(3, device=localizer.device)
        tilt: float | None = 0.0
        if not along_walls:
            walls = prepared.lines.best_axes(config.search.line_rotations, config.lines.least_contrast)
            tilt = _most_tilt(rig, hints, prepared.is_wide, config.search.level_tilt_deg)
        return scores_of_maps(prepared.described, walls, maps, tilt, prepared.is_wide, config.search).tolist()


def _most_tilt(rig: Rig, hints: Hints | None, is_wide: bool, level_tilt_deg: float) -> float | None:
    """Return how far a rig may be tilted, radians; None for any. Cameras that see little are looked for level, as people hold them."""
    held = None if is_wide else level_tilt_deg
    known = MAX_SESSION_TILT_DEG if rig.options.up_known else None
    hinted = None if hints is None else hints.most_tilt_deg
    tilts = [tilt for tilt in (held, known, hinted) if tilt is not None]
    return math.radians(min(tilts)) if tilts else None


def _numbered(found: Localization, numbers: Sequence[int], num_maps: int) -> Localization:
    """Return an answer about some of the maps, with their numbers among all."""
    found = found.with_each(lambda one: replace(one, map_position=numbers[one.map_position]))
    return replace(found, search=replace(found.search, num_maps=num_maps))


def _places(found: Localization) -> set[int]:
    """Return the numbers of the maps that an answer is about."""
    best = () if found.best is None else (found.best,)
    return {candidate.map_position for candidate in (*best, *found.alternatives)}


def _better(before: Localization | None, now: Localization) -> Localization:
    """Return the later of two answers, unless it is less sure and does not know of the place of the first: among the candidates of many
    maps it may have been left out."""
    if before is None or before.best is None or before.best.map_position in _places(now):
        return now
    return now if now.best is not None and now.best.confidence >= before.best.confidence else before


def _is_sure(found: Localization, sure: float) -> bool:
    """Return whether an answer is so sure, of one pose or of two that are equal, that nothing is gained by looking at less likely maps."""
    confidence = 0.0 if found.best is None else found.best.confidence
    return confidence >= {"localized": sure, "ambiguous": sure / 2}.get(found.status, math.inf)


def _left_out(searched: int, num_maps: int) -> Remark:
    return Remark(
        "name_fewer_maps",
        f"only the {searched} of {num_maps} maps were searched that look most like it; name fewer maps with map_id or tag, "
        "or send more images",
    )
