"""What edges of photos leave of the rotations, in a box whose walls are painted in rectangles."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Photo, Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.geometry.rotations import rotation_angle, rotation_from_vector, rotation_spacing
from panoloc.core.options import Hints
from panoloc.core.query.map_query import MapQuery
from panoloc.core.query.rounds import rounds_of
from panoloc.core.search.map_search import LineEvidence, search_maps
from tests.core.built_maps import POSE, map_of, rig_of, tensors_of
from tests.core.found_pose import known
from tests.core.image.painted_photos import SIDEWAYS, photo_of
from tests.core.painted_box import PaintedBox
from tests.core.search import found_candidates

pytestmark = pytest.mark.slow
CONFIG = LocalizerConfig()
BOX = PaintedBox(seed=5, palette=((200, 60, 60), (60, 90, 190), (220, 210, 160), (70, 150, 90)))
ROTATION, PLACE = (each[0] for each in tensors_of(POSE))


@cache
def query_of(hints: Hints | None = None, config: LocalizerConfig = CONFIG) -> MapQuery:
    """Return a photo as a lens draws it: each pixel the mean of nine."""
    large = photo_of(Camera.from_hfov("pinhole", 1440, 1080, 69.0), POSE, BOX).color
    color = large.reshape(360, 3, 480, 3, 3).mean((1, 3)).round().astype(np.uint8)
    photo = Rig.of_photo(Photo(color, np.ones((360, 480), bool), SIDEWAYS))
    return found_candidates.query_of(photo, hints, map_of(BOX), config)


def evidence_of(query: MapQuery) -> LineEvidence:
    return known(query.lines)


def nearest_deg(rotations: Tensor, wanted: Tensor) -> float:
    return math.degrees(float(rotation_angle(rotations, wanted).min()))


@pytest.mark.parametrize("hints", [None, Hints(upright=True)])
def test_few_rotations_are_left_and_the_right_one_is_among_them(hints: Hints | None) -> None:
    query = query_of(hints=hints)
    first = next(rounds_of([query], CONFIG.search))
    assert first.by_lines
    likely = evidence_of(query).likely_rotations(first.limits[0], 200)
    assert 1 < len(likely) < 200
    assert 0 < len(evidence_of(query).likely_rotations(first.limits[0], 25)) < len(likely)
    assert nearest_deg(likely, ROTATION) < 4.0
    assert bool(first.limits[0].allows_rotation(likely, rotation_spacing(CONFIG.search.line_rotations) / 2).all())


def test_the_more_a_rig_shows_the_fewer_rotations_lines_choose() -> None:
    of_share = [CONFIG.search.likely_rotations_of(share) for share in (0.0, 0.09, 0.3, 1.0)]
    assert of_share[0] == of_share[1] == CONFIG.search.likely_rotations
    assert of_share[1] > 2 * of_share[2] > 4 * of_share[3] > 0


def test_of_a_panorama_few_rotations_leave_the_right_one_and_its_pose_comes_first() -> None:
    panorama = found_candidates.query_of(rig_of(BOX.panorama(POSE)), None, map_of(BOX))
    _, level, _ = rounds_of([panorama], CONFIG.search)
    most = CONFIG.search.likely_rotations_of(panorama.rig.share)
    assert nearest_deg(evidence_of(panorama).likely_rotations(level.limits[0], most), ROTATION) < 4.0
    at = Hypothesis(0, 0, ROTATION, PLACE)
    assert "lines" not in panorama.judge([at])[0].measures
    (found,), _, num_poses = search_maps([panorama.search], level.limits, [panorama.lines], CONFIG.search)
    assert 0 < num_poses <= map_of(BOX).num_starts * most
    assert float((found.positions[0] - PLACE).norm()) < 0.3
    assert nearest_deg(found.rotations[:1], ROTATION) < 5.0


def test_the_score_falls_with_what_a_rotation_misses() -> None:
    query, right = query_of(), ROTATION
    around = rotation_from_vector(torch.tensor([0.3, 0.2, 0.3])) @ right
    start = int((map_of(BOX).starts - PLACE).norm(dim=1).argmin())
    asked = [Hypothesis(0, start, rotation, PLACE) for rotation in (right, around)]
    judged = [query.judge([h])[0] for h in asked]
    with_lines = [h.score for h in judged]
    plain = query_of(config=replace(CONFIG, judge=replace(CONFIG.judge, lines_share=0.0)))
    without = [plain.judge([h])[0].score for h in asked]
    missed = evidence_of(query).missed(torch.stack((right, around))).tolist()
    shares = [1 - CONFIG.judge.lines_share * m for m in missed]
    assert with_lines == pytest.approx([s * share for s, share in zip(without, shares, strict=True)], rel=1e-4)
    assert shares[0] > 0.95 > shares[1] + 0.1
    assert [h.measures["lines"] for h in judged] == pytest.approx([1 - m for m in missed], abs=1e-4)


def test_a_candidate_by_lines_is_nearer_than_the_starts() -> None:
    query, index = query_of(), map_of(BOX)
    limits = next(rounds_of([query], CONFIG.search)).limits
    (found,), *_ = search_maps([query.search], limits, [query.lines], CONFIG.search)
    off_m, starts = (found.positions - PLACE).norm(dim=-1), index.starts[found.starts]
    assert float(off_m[0]) < 0.2
    assert float((starts[0] - PLACE).norm()) > float(off_m[0])
    assert float((found.positions - starts).abs().max()) <= float(index.leaf_sizes.max()) / 2 + 1e-4
    assert nearest_deg(found.rotations[:1], ROTATION) < 5.0
