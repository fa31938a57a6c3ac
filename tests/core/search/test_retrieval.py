"""Which of many maps a rig may be in, without their indexes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from panoloc.core.config import LocalizerConfig
from panoloc.core.errors import IndexFormatError
from panoloc.core.features.line_support import LineSupport
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.map.map_index import MapIndex
from panoloc.core.map.retrieval_vectors import (
    RetrievalVectors,
    decode_retrieval_vectors,
    encode_retrieval_vectors,
    retrieval_vectors,
)
from panoloc.core.query.map_query import PreparedRig
from panoloc.core.search.retrieval import scores_of_maps
from tests.core.built_maps import AS_LABELS, BOX, LABELLED, OTHER_BOX, POSE, map_of, rig_of
from tests.core.painted_box import rotation_of

CONFIG = LocalizerConfig()
BOXES = (OTHER_BOX, BOX)


def scores(pose: Pose, *maps: RetrievalVectors, max_tilt: float | None = None, by_lines: bool = True) -> list[float]:
    """Return the scores of maps for a panorama of BOX."""
    rig = PreparedRig(rig_of(BOX.panorama(pose)), None, torch.device("cpu"), CONFIG)
    lines: LineSupport | None = rig.lines if by_lines else None
    found: list[float] = scores_of_maps(rig.described, lines, maps, max_tilt, CONFIG.search).tolist()
    return found


@pytest.mark.parametrize("by_lines", [True, False])
@pytest.mark.parametrize("rotation", [POSE.rotation, rotation_of(20.0, 70.0, 130.0)])
def test_the_map_of_what_a_panorama_shows_comes_first_however_it_is_turned(
    rotation: NDArray[np.float64], by_lines: bool
) -> None:
    shown = replace(POSE, rotation=rotation)
    found = scores(shown, *(retrieval_vectors(map_of(box)) for box in BOXES), by_lines=by_lines)
    assert found[1] == max(found)


def test_where_walls_stand_in_a_scan_changes_nothing() -> None:
    own = turned = retrieval_vectors(map_of(BOX))
    # The views of a scan that is turned by a column of patches of 22.5 degrees are shifted by one.
    turn = rotation_from_vector(torch.tensor([0.0, 0.0, torch.pi / 8]))
    steps = turned.steps.view(len(turned), 8, 16, -1).roll(-1, 2).flatten(1)
    turned = RetrievalVectors(steps.contiguous(), turned.scale, turned.axes @ turn.T)
    before, after = scores(POSE, own, turned)
    assert before == pytest.approx(after, rel=0.02)


def test_cameras_that_are_level_are_not_looked_for_upside_down() -> None:
    vectors = retrieval_vectors(map_of(BOX))
    upside_down = replace(POSE, rotation=rotation_of(20.0, 178.0, 3.0))
    (free,), (level,) = scores(upside_down, vectors), scores(upside_down, vectors, max_tilt=0.3)
    assert level < 0.8 * free


def test_a_map_of_labels_is_like_no_panorama_in_colours() -> None:
    labels = retrieval_vectors(map_of(LABELLED, AS_LABELS))
    assert len(labels) == 0
    assert scores(POSE, labels, retrieval_vectors(map_of(BOX)))[0] == -torch.inf


def test_vectors_survive_as_bytes() -> None:
    vectors = retrieval_vectors(map_of(BOX))
    again = decode_retrieval_vectors(encode_retrieval_vectors(vectors))
    assert torch.equal(again.steps, vectors.steps)
    assert torch.equal(again.scale, vectors.scale)
    assert torch.equal(again.axes, vectors.axes)
    index: MapIndex = map_of(BOX)
    # A kilobyte for each start.
    assert vectors.num_bytes / index.num_starts == pytest.approx(1024, abs=12)


@pytest.mark.parametrize("damage", ["", "PK", "cut", "shape", "type"])
def test_damaged_vectors_are_refused(damage: str) -> None:
    vectors = retrieval_vectors(map_of(BOX))
    if damage == "shape":
        data = encode_retrieval_vectors(replace(vectors, scale=vectors.scale[1:]))
    elif damage == "type":
        data = encode_retrieval_vectors(replace(vectors, steps=vectors.steps.int()))
    else:
        data = encode_retrieval_vectors(vectors)[:-100] if damage == "cut" else damage.encode()
    with pytest.raises(IndexFormatError, match="retrieval vectors: "):
        decode_retrieval_vectors(data)
