"""Which of many maps a rig may be in, without their indexes."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from panoloc.core.config import LocalizerConfig
from panoloc.core.errors import IndexFormatError
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_from_vector, rotations_of
from panoloc.core.map.retrieval_vectors import (
    ROWS,
    UNSEEN,
    RetrievalVectors,
    decode_retrieval_vectors,
    encode_retrieval_vectors,
    levels_of,
    retrieval_vectors,
)
from panoloc.core.query.map_query import PreparedRig
from panoloc.core.search.described_rig import DescribedRig
from panoloc.core.search.retrieval import scores_of_maps
from tests.core.built_maps import AS_LABELS, BOX, LABELLED, OTHER_BOX, POSE, map_of, rig_of
from tests.core.image.painted_photos import SIDEWAYS, photo_of
from tests.core.painted_box import PaintedBox, rotation_of

CONFIG = LocalizerConfig()
BOXES = (OTHER_BOX, BOX)


def scores(
    pose: Pose, *maps: RetrievalVectors, max_tilt: float | None = None, by_lines: bool = True, is_photo: bool = False
) -> list[float]:
    """Return the scores of maps for a panorama or a photo of BOX."""
    rig = PreparedRig(
        rig_of(photo_of(SIDEWAYS, pose) if is_photo else BOX.panorama(pose)), None, torch.device("cpu"), CONFIG
    )
    walls = rig.lines.best_axes(CONFIG.search.line_rotations, 0.0) if by_lines else None
    found: list[float] = scores_of_maps(rig.described, walls, maps, max_tilt, rig.is_wide, CONFIG.search).tolist()
    return found


def small_map(rng: np.random.Generator, starts: int) -> RetrievalVectors:
    """Return a map of noise, a third of which its starts do not see."""
    levels = rng.integers(-90, 90, (2 * ROWS * ROWS, 3, starts)).astype(np.int8)
    levels.swapaxes(1, 2)[rng.random((len(levels), starts)) < 1 / 3] = UNSEEN
    nothing = torch.zeros((starts, 1024), dtype=torch.int8), torch.zeros(starts)
    return RetrievalVectors(*nothing, torch.from_numpy(levels), torch.eye(3))


def score_of_pixels(
    directions: NDArray[np.float64], colors: NDArray[np.float64], one: RetrievalVectors, rotations: int
) -> float:
    """Return the score of a map for pixels that cover as much of the sphere each, under a sixteenth of so many rotations."""
    towards, shown = (torch.from_numpy(part).float() for part in (directions, colors))
    rig = cast(DescribedRig, SimpleNamespace(large_pixels=(towards, shown, torch.ones(len(towards)))))
    return float(scores_of_maps(rig, None, [one], None, False, replace(CONFIG.search, rotations=rotations))[0])


@pytest.mark.parametrize("by_lines", [True, False])
@pytest.mark.parametrize("rotation", [POSE.rotation, rotation_of(20.0, 70.0, 130.0)])
def test_the_map_of_what_a_panorama_shows_comes_first_however_it_is_turned(
    rotation: NDArray[np.float64], by_lines: bool
) -> None:
    shown = replace(POSE, rotation=rotation)
    found = scores(shown, *(retrieval_vectors(map_of(box)) for box in BOXES), by_lines=by_lines)
    assert found[1] == max(found)


def test_the_map_of_what_a_photo_shows_comes_first() -> None:
    boxes = (*BOXES, PaintedBox(seed=8))
    found = scores(POSE, *(retrieval_vectors(map_of(box)) for box in boxes), max_tilt=0.3, is_photo=True)
    assert found[1] == max(found)


@pytest.mark.parametrize("is_photo", [False, True])
def test_where_walls_stand_in_a_scan_changes_nothing(is_photo: bool) -> None:
    own = retrieval_vectors(map_of(BOX))
    # The views of a scan that is turned by three pixels of 15 degrees, or two patches of 22.5, are shifted by as many.
    turn = rotation_from_vector(torch.tensor([0.0, 0.0, torch.pi / 4]))
    steps = own.steps.view(len(own), 8, 16, -1).roll(-2, 2).flatten(1)
    levels = own.levels.view(ROWS, 2 * ROWS, 3, -1).roll(-3, 1).flatten(0, 1)
    turned = replace(own, steps=steps.contiguous(), levels=levels.contiguous(), axes=own.axes @ turn.T)
    before, after = scores(POSE, own, turned, is_photo=is_photo)
    assert before == pytest.approx(after, rel=0.02)


def test_a_score_is_the_share_of_levels_that_agree_once_the_light_is_taken_away() -> None:
    rng = np.random.default_rng(5)
    vectors, count = small_map(rng, 5), 40
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = rng.random((count, 3))
    found = score_of_pixels(directions, colors, vectors, 32)
    own = levels_of(torch.from_numpy(colors).float()).numpy()
    best = max(
        agreement(vectors.levels[:, :, start].numpy(), directions @ rotation.numpy().T, own)
        for rotation in rotations_of(2, "cpu")
        for start in range(5)
    )
    assert found == pytest.approx(best, abs=0.005)


def agreement(shown: NDArray[np.int8], directions: NDArray[np.float64], own: NDArray[np.int8]) -> float:
    """Return by how much one start, whose pixels show levels (P, 3), agrees with levels (S, 3) towards directions; slowly."""
    met = []
    for x, y, z in directions:
        column = int((math.pi - math.atan2(y, x)) / math.pi * ROWS) % (2 * ROWS)
        met.append(shown[min(ROWS - 1, int((math.pi / 2 - math.asin(z)) / math.pi * ROWS)) * 2 * ROWS + column])
    seen = [n for n, levels in enumerate(met) if levels[0] != UNSEEN]
    total = 0.0
    for channel in range(3):
        off = [float(met[n][channel]) - float(own[n][channel]) for n in seen]
        total += sum(max(0.0, 1 - abs(each - sum(off) / len(off)) / 20) for each in off)
    return total / (3 * len(own))


def test_cameras_that_are_level_are_not_looked_for_upside_down() -> None:
    vectors = retrieval_vectors(map_of(BOX))
    upside_down = replace(POSE, rotation=rotation_of(20.0, 178.0, 3.0))
    (free,), (level,) = scores(upside_down, vectors), scores(upside_down, vectors, max_tilt=0.3)
    assert level < 0.8 * free


@pytest.mark.parametrize("gains", [(0.5, 0.5, 0.5), (1.0, 0.8, 0.6)])
def test_exposure_and_white_balance_change_nothing(gains: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(7)
    directions = rng.normal(size=(100, 3))
    # So bright that noise in shadows, which is added before the logarithm, weighs little.
    colors = 0.3 + 0.6 * rng.random((100, 3))
    views = small_map(rng, 60)
    as_taken, dimmed = (score_of_pixels(directions, shown, views, 128) for shown in (colors, colors * gains))
    assert dimmed == pytest.approx(as_taken, abs=0.01)


def test_a_place_is_the_less_likely_the_less_its_scan_shows() -> None:
    vectors = retrieval_vectors(map_of(BOX))
    holes, nothing = vectors.levels.clone(), torch.full_like(vectors.levels, UNSEEN)
    holes[::2] = UNSEEN
    maps = (vectors, replace(vectors, levels=holes), replace(vectors, levels=nothing))
    known, incomplete, unknown = scores(POSE, *maps, is_photo=True)
    assert known > incomplete > unknown
    assert unknown == 0


def test_each_brightness_has_a_level_of_its_own() -> None:
    grey = levels_of(torch.tensor([0.0, 0.01, 0.1, 0.5, 1.0])[:, None].expand(-1, 3)).int()
    assert grey[:, 0].diff().min() > 0
    assert grey[[0, -1], 0].tolist() == [-127, 127]
    assert not grey[:, 1:].any()


def test_a_map_of_labels_is_like_no_panorama_in_colours() -> None:
    labels = retrieval_vectors(map_of(LABELLED, AS_LABELS))
    assert len(labels) == 0
    assert scores(POSE, labels, retrieval_vectors(map_of(BOX)))[0] == -torch.inf


def test_vectors_survive_as_bytes() -> None:
    vectors = retrieval_vectors(map_of(BOX))
    again = decode_retrieval_vectors(encode_retrieval_vectors(vectors))
    assert all(torch.equal(getattr(again, name), getattr(vectors, name)) for name in vars(vectors))
    assert len(again) == map_of(BOX).num_starts
    assert vectors.num_bytes / len(again) == pytest.approx(1024 + 864, abs=12)


@pytest.mark.parametrize("damage", ["", "PK", "cut", "steps", "levels", "type"])
def test_damaged_vectors_are_refused(damage: str) -> None:
    vectors = retrieval_vectors(map_of(BOX))
    if damage == "steps":
        data = encode_retrieval_vectors(replace(vectors, steps=vectors.steps[1:]))
    elif damage == "levels":
        data = encode_retrieval_vectors(replace(vectors, levels=vectors.levels[1:]))
    elif damage == "type":
        data = encode_retrieval_vectors(replace(vectors, steps=vectors.steps.int()))
    else:
        data = encode_retrieval_vectors(vectors)[:-100] if damage == "cut" else damage.encode()
    with pytest.raises(IndexFormatError, match="retrieval vectors: "):
        decode_retrieval_vectors(data)
